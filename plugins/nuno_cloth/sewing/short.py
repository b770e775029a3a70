"""Collapse of short sides of a sewn garment's triangles: the two vertices of a side become one.

Patterns that programs draw have edges of a millimetre, where two cuts miss each other. The triangle on such an edge
shortens all steps of a simulation with its size, and is thinner than cloth. It is left out; all others keep their cut
shapes, and are strained by the side's length.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nuno_cloth.models.triangles import find_edges
from nuno_cloth.sewing.sew import Sewn
from nuno_schemas.fabric import Int


def close_short(sewn: Sewn, least: float) -> Sewn:
    """Return a garment without sides that are cut shorter than `least` [m], collapsed from the shortest, except those
    whose collapse would not leave one surface.
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
            if _can_collapse(faces, one, other, on_rim):
                sewn = _collapse(sewn, one, other)
                break
        else:
            return sewn


def _can_collapse(faces: Int, one: int, other: int, on_rim: set[int]) -> bool:
    """Return whether a collapse leaves one surface: the vertices share no neighbours but those across the side, which
    does not divide the surface from rim to rim (the link condition: Dey et al. 1999, Publ. Inst. Math. 66, 23-45).
    """
    near_one, near_other = [set(faces[(faces == vertex).any(axis=1)].ravel().tolist()) for vertex in (one, other)]
    triangles = int(((faces == one).any(axis=1) & (faces == other).any(axis=1)).sum())
    return len((near_one & near_other) - {one, other}) == triangles and not (triangles == 2 and {one, other} <= on_rim)


def _collapse(sewn: Sewn, one: int, other: int) -> Sewn:
    """Merge the higher of two sewn vertices into the lower, without triangles on the side between them."""
    merged = np.where(sewn.merged == other, one, sewn.merged)
    merged = np.unique(merged, return_inverse=True)[1].reshape(-1).astype(np.int32)
    corners = merged[sewn.faces]
    kept = (corners != np.roll(corners, -1, axis=1)).all(axis=1)
    return replace(sewn, faces=sewn.faces[kept], panel=sewn.panel[kept], merged=merged)
