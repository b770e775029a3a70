"""The stiffness of cloth at each vertex, by which contact is measured."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Fabric, Float


def elastic_stiffness(fabric: Fabric) -> Float:
    """Return the sum of the stiffness of each vertex' springs and triangles (n,) [N/m], infinite if it has none."""
    total = np.zeros(fabric.number)
    if fabric.springs is not None:
        pairs, k = fabric.springs.pairs(), fabric.springs.per_spring(fabric.springs.k)
        for end in (0, 1):
            np.add.at(total, pairs[:, end], k)
    if fabric.membrane is not None:
        np.add.at(total, fabric.membrane.faces, fabric.membrane.stiffness())
    total[total == 0.0] = np.inf
    return total
