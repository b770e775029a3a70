"""From a garment on coarser triangles to the same on finer ones: by where vertices lie in their panels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from nuno_cloth.sewing.sew import Sewn
from nuno_schemas.fabric import Bool, Float, Int

NEXT = 8
"""Triangles next to a point of a panel that are looked at before all others."""


def refine(fine: Sewn, coarse: Sewn, places: Sequence[Float]) -> list[Float]:
    """Where the vertices (n, 3) of a finer garment are, for each of some `places` (m, 3) of a coarser one of the same
    panels: linear in its triangles, in the nearest of which go on what lies beside them, as along curves. Along a seam
    it is the mean of what its panels say.
    """
    found = [np.zeros((len(fine.flat), 3)) for _ in places]
    cut = np.zeros(len(fine.flat), np.bool_)
    cut[fine.faces] = True
    for panel in range(len(fine.names)):
        own, faces = np.unique(fine.faces[fine.panel == panel]), coarse.faces[coarse.panel == panel]
        of, weight = _locate(coarse.flat[faces], fine.flat[own])
        for place, on in zip(places, found, strict=True):
            on[own] = (weight[:, :, None] * place[coarse.merged[faces[of]]]).sum(axis=1)
    return [_mean(on, fine, cut) for on in found]


def _mean(x: Float, sewn: Sewn, cut: Bool) -> Float:
    """(n, 3) of sewn vertices, by x (m, 3) of those cut ones that triangles have."""
    own = sewn.merged[cut]
    share = np.bincount(own, minlength=sewn.number)
    return np.stack([np.bincount(own, along, sewn.number) / share for along in x[cut].T], axis=1)


def _locate(corners: Float, points: Float) -> tuple[Int, Float]:
    """Of each of the points (k, 2) the number of the triangle, of corners (f, 3, 2), that it lies in or least beside,
    and its barycentric coordinates (k, 3) there.
    """
    _, near = cKDTree(corners.mean(axis=1)).query(points, k=min(NEXT, len(corners)))
    of, weight = _innermost(corners, points, near.reshape(len(points), -1))
    beside = np.flatnonzero(weight.min(axis=1) < 0.0)
    every = np.broadcast_to(np.arange(len(corners), dtype=np.int32), (len(beside), len(corners)))
    of[beside], weight[beside] = _innermost(corners, points[beside], every)
    return of, weight


def _innermost(corners: Float, points: Float, near: Int) -> tuple[Int, Float]:
    """That of the triangles near (k, c) of each point whose least coordinate is highest."""
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
