"""Short sides of a sewn garment's triangles are closed: the two vertices of one become one.

Patterns that programs draw have edges of a millimetre, where two cuts miss each other. The triangle on such an edge
makes all steps of a simulation as short as it is small, and is thinner than cloth. It is left out; all others keep the
shapes that they are cut to, and are strained by what the side was long.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nuno_cloth.models.triangles import find_edges
from nuno_cloth.sewing.sew import Sewn
from nuno_schemas.fabric import Int


def close_short(sewn: Sewn, least: float) -> Sewn:
    """A garment without sides shorter than `least` [m] as they are cut, the shortest of all that they are cut to first;
    but for those whose closing would join what is not one surface.
    """
    while True:
        faces = sewn.sewn_faces
        edges = find_edges(faces)
        length = np.full(len(edges.pairs), np.inf)
        np.minimum.at(length, edges.of_face.reshape(-1), sewn.sides.reshape(-1))
        on_rim = set(edges.pairs[edges.count == 1].ravel().tolist())
        for k in np.argsort(length, kind="stable"):
            if length[k] >= least:
                return sewn
            one, other = (int(vertex) for vertex in edges.pairs[k])
            if _can_close(faces, one, other, on_rim):
                sewn = _close(sewn, one, other)
                break
        else:
            return sewn


def _can_close(faces: Int, one: int, other: int, on_rim: set[int]) -> bool:
    """Whether what is left is one surface: both vertices have no neighbour in common but those across the side, and it
    does not part the surface from rim to rim (the link condition: Dey et al. 1999, Publ. Inst. Math. 66, 23-45).
    """
    beside, across = [set(faces[(faces == vertex).any(axis=1)].ravel().tolist()) for vertex in (one, other)]
    triangles = int(((faces == one).any(axis=1) & (faces == other).any(axis=1)).sum())
    return len((beside & across) - {one, other}) == triangles and not (triangles == 2 and {one, other} <= on_rim)


def _close(sewn: Sewn, one: int, other: int) -> Sewn:
    """The higher of two sewn vertices becomes the lower; triangles on the side between them are left out."""
    merged = np.where(sewn.merged == other, one, sewn.merged)
    merged = np.unique(merged, return_inverse=True)[1].reshape(-1).astype(np.int32)
    corners = merged[sewn.faces]
    kept = (corners != np.roll(corners, -1, axis=1)).all(axis=1)
    return replace(sewn, faces=sewn.faces[kept], panel=sewn.panel[kept], merged=merged)
