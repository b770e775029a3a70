"""Other triangles for a sewn garment: finer ones, and short sides collapsed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from nuno_cloth.models.triangles import find_edges
from nuno_cloth.sewing.sew import Sewn
from nuno_schemas.fabric import Bool, Float, Int

# Collapse of short sides of a sewn garment's triangles: the two vertices of a side become one.
#
# Patterns that programs draw have edges of a millimetre, where two cuts miss each other. The triangle on such an edge
# shortens all steps of a simulation with its size, and is thinner than cloth. It is left out; all others keep their cut
# shapes, and are strained by the side's length.


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


# Interpolation of a garment from coarser to finer triangles, by the places of vertices in their panels.

NEXT = 8
"""Triangles nearest to a point of a panel that are tested before all others."""


def refine(fine: Sewn, coarse: Sewn, places: Sequence[Float]) -> list[Float]:
    """Return the places (n, 3) of a finer garment's vertices for each of some `places` (m, 3) of a coarser one of the
    same panels: linear in its triangles, extrapolated from the nearest outside of them, as along curves. Along a seam
    they are the mean over its panels.
    """
    refined = [np.zeros((len(fine.flat), 3)) for _ in places]
    cut = np.zeros(len(fine.flat), np.bool_)
    cut[fine.faces] = True
    for panel in range(len(fine.names)):
        indices, faces = np.unique(fine.faces[fine.panel == panel]), coarse.faces[coarse.panel == panel]
        triangle, weight = _locate(coarse.flat[faces], fine.flat[indices])
        for place, moved in zip(places, refined, strict=True):
            moved[indices] = (weight[:, :, None] * place[coarse.merged[faces[triangle]]]).sum(axis=1)
    return [_mean(moved, fine, cut) for moved in refined]


def _mean(x: Float, sewn: Sewn, cut: Bool) -> Float:
    """Return the means (n, 3) at sewn vertices of x (m, 3) at cut ones that triangles use."""
    sewn_index = sewn.merged[cut]
    share = np.bincount(sewn_index, minlength=sewn.number)
    return np.stack([np.bincount(sewn_index, along, sewn.number) / share for along in x[cut].T], axis=1)


def _locate(corners: Float, points: Float) -> tuple[Int, Float]:
    """Return for points (k, 2) the triangle, of corners (f, 3, 2), that each lies in or nearest to, and its barycentric
    coordinates (k, 3) there.
    """
    _, near = cKDTree(corners.mean(axis=1)).query(points, k=min(NEXT, len(corners)))
    triangle, weight = _innermost(corners, points, near.reshape(len(points), -1))
    outside = np.flatnonzero(weight.min(axis=1) < 0.0)
    every = np.broadcast_to(np.arange(len(corners), dtype=np.int32), (len(outside), len(corners)))
    triangle[outside], weight[outside] = _innermost(corners, points[outside], every)
    return triangle, weight


def _innermost(corners: Float, points: Float, near: Int) -> tuple[Int, Float]:
    """Return the triangle, of those `near` (k, c) each point, whose least barycentric coordinate is highest."""
    a, b, c = (corners[near, i] for i in range(3))
    u, v, w = b - a, c - a, points[:, None] - a
    area = _cross(u, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = _cross(w, v) / area, _cross(u, w) / area
        weight = np.stack([1.0 - one - other, one, other], axis=2)
    # No point lies in a triangle without area.
    best = np.where(area > 0.0, weight.min(axis=2), -np.inf).argmax(axis=1)[:, None]
    return np.take_along_axis(near, best, 1)[:, 0], np.take_along_axis(weight, best[:, :, None], 1)[:, 0]


def _cross(a: Float, b: Float) -> Float:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
