"""Texture coordinates of a sewn garment, by cut vertex: on each panel a print runs as it is cut."""

from __future__ import annotations

import numpy as np

from nuno_cloth.sewing.sew import Sewn
from nuno_schemas.fabric import Float


def lay_out(sewn: Sewn) -> tuple[Float, float]:
    """(m, 2) of the cut vertices, u to the right and v upwards, in [0, 1]; and how long a unit of them is [m].

    Triangles into them are `sewn.faces`.

    Each panel lies with its outside up, turned so that its warp runs along v; panels stand side by side in their
    order, all on v = 0, and all at one scale: that of the longer side of the rectangle round them. So a stripe along v
    follows the warp on every panel. A seam's vertices are one in the cloth and differ here, as panels are cut apart.
    """
    points, start = np.empty_like(sewn.flat), 0.0
    for k, (x, y) in enumerate(sewn.warp):
        own = np.unique(sewn.faces[sewn.panel == k])
        flat = sewn.flat[own]
        # Sums of two products, and no matrix product: BLAS may round in another order.
        turned = np.stack([flat[:, 0] * y - flat[:, 1] * x, flat[:, 0] * x + flat[:, 1] * y], axis=1)
        turned -= turned.min(axis=0)
        turned[:, 0] += start
        points[own] = turned
        start = float(turned[:, 0].max())
    unit = float(points.max())
    return points / unit, unit
