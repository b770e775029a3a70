"""Squares of triangles, measured cloth on them, and their bending as a matrix."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.bending import build_bending
from nuno_cloth.models.delaunay import triangulate
from nuno_cloth.models.triangles import yarn_axes
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.vectors import face_areas

KINDS = ("diagonal", "alternating", "irregular")


def square(kind: str, n: int) -> tuple[Float, Int]:
    """Points (v, 2) and triangles of 1 m x 1 m with n vertices a side: cells all cut alike, cut to and fro, or points
    thrown by up to a third of their distance and joined after Delaunay.
    """
    ticks = np.linspace(0.0, 1.0, n)
    points = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    if kind == "irregular":
        inside = ((points > 0.0) & (points < 1.0)).all(axis=1)
        thrown = np.random.default_rng(n).uniform(-1.0, 1.0, points.shape) / (3.0 * (n - 1))
        points = points + np.where(inside[:, None], thrown, 0.0)
        faces = triangulate(points)
        return points, faces[face_areas(np.column_stack([points, 0.0 * points[:, 0]])[faces]) > 1e-9]
    row, column = (each.reshape(-1) for each in np.mgrid[: n - 1, : n - 1])
    a = row * n + column
    b, c, d = a + 1, a + n + 1, a + n
    other = (kind == "alternating") & ((row + column) % 2 == 1)
    one = np.where(other[:, None], np.column_stack([a, b, d]), np.column_stack([a, b, c]))
    two = np.where(other[:, None], np.column_stack([b, c, d]), np.column_stack([a, c, d]))
    return points, np.concatenate([one, two]).astype(np.int32)


def plate(points: Float, faces: Int, material: Material, angle: float = 90.0) -> Fabric:
    """A flat piece whose warp makes an angle [degrees] with x."""
    x = np.column_stack([points, np.zeros(len(points))]) if points.shape[1] == 2 else points
    turn = np.radians(angle)
    axes = yarn_axes(x[faces], np.array([np.cos(turn), np.sin(turn), 0.0]))
    share = np.repeat(face_areas(x[faces]) * material.density / 3, 3)
    mass = np.bincount(faces.reshape(-1), share, len(x)).astype(np.float64)
    bending = build_bending(material, x[faces], faces, *axes, np.zeros(len(x), bool))
    return Fabric("plate", x, 0.0 * x, mass, np.zeros(len(x), bool), faces, bending=bending)


def matrix(fabric: Fabric) -> scipy.sparse.csc_matrix:
    """(n, n) second derivatives of the energy along any axis."""
    assert fabric.bending is not None
    (i, j), w = fabric.bending.pairs.T, fabric.bending.weight
    entries = np.concatenate([w, w, -w, -w]), (np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i]))
    return scipy.sparse.coo_matrix(entries, (fabric.number, fabric.number)).tocsc()
