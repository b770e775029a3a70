"""How stiffly cloth answers at each vertex: what contact is measured by."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Fabric, Float


def elastic_stiffness(fabric: Fabric) -> Float:
    """(n,) sum of the stiffness of each vertex' springs and triangles [N/m], infinite where it has none."""
    found = np.zeros(fabric.number)
    if fabric.springs is not None:
        pairs, k = fabric.springs.pairs(), fabric.springs.per_spring(fabric.springs.k)
        for end in (0, 1):
            np.add.at(found, pairs[:, end], k)
    if fabric.membrane is not None:
        np.add.at(found, fabric.membrane.faces, fabric.membrane.stiffness())
    found[found == 0.0] = np.inf
    return found
