"""Products of vectors and small matrices, in the same bits on every processor.

numpy's `@` and `dot`, and its `linalg.norm` of a single vector, call BLAS, whose kernels differ by processor: in the
order of additions, and in whether they fuse a product with a sum. Code that computes the start of a run or moves its
bodies uses these functions instead: a sum along an axis, and einsum without `optimize`, never call BLAS.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Float, Int

CERTAIN = 3.4e-16
"""The sign of an orientation in floating point is right above this share of the terms' magnitudes (Shewchuk 1997,
Adaptive precision floating-point arithmetic and fast robust geometric predicates, 4.3)."""


def dot(a: Float, b: Float) -> Float:
    """Return the dot products (...) of vectors a and b (..., k)."""
    return np.asarray((a * b).sum(axis=-1))


def norm(v: Float) -> Float:
    """Return the lengths (...) of vectors (..., k)."""
    return np.asarray(np.sqrt(dot(v, v)))


def unit_rows(vectors: NDArray[Any]) -> Float:
    """Return vectors (..., k) of length 1; 0 stays 0."""
    length = norm(vectors)[..., None]
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors, length.dtype), where=length > 0.0))


def face_areas(corners: Float) -> Float:
    """Return the areas (f,) of triangles with corners (f, 3, 3) [m^2]."""
    return 0.5 * norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def vertex_areas(x: Float, faces: Int) -> Float:
    """Return the areas (n,) of vertices x (n, 3), a third of their triangles' (f, 3) each [m^2]."""
    return np.bincount(faces.ravel(), np.repeat(face_areas(x[faces]) / 3.0, 3), len(x)).astype(np.float64)


def turn(matrices: Float, vectors: Float) -> Float:
    """Return the products (..., i) of matrices (..., i, k) with vectors (..., k)."""
    return np.asarray(np.einsum("...ik,...k->...i", matrices, vectors))


def compose(first: Float, second: Float) -> Float:
    """Return the products (..., i, k) of matrices (..., i, j) and (..., j, k): rotation by `second`, then `first`."""
    return np.asarray(np.einsum("...ij,...jk->...ik", first, second))


def sides(a: Float, b: Float, c: Float) -> Int:
    """Return 1 for points c (..., 2) to the left of the line from a to b (..., 2), -1 to the right, 0 on the line,
    shape (...). The sign is exact: if rounding could change it, it is computed in fractions.
    """
    a, b, c = np.broadcast_arrays(a, b, c)
    (ux, uy), (vx, vy) = np.moveaxis(a - c, -1, 0), np.moveaxis(b - c, -1, 0)
    cross = ux * vy - uy * vx
    sign: Int = np.sign(cross).astype(np.int32)
    for index in zip(*np.nonzero(np.abs(cross) < CERTAIN * (np.abs(ux * vy) + np.abs(uy * vx))), strict=True):
        (x, y), (u, v), (p, q) = ([Fraction(value) for value in point[index].tolist()] for point in (a, b, c))
        exact = (x - p) * (v - q) - (y - q) * (u - p)
        sign[index] = (exact > 0) - (exact < 0)
    return sign
