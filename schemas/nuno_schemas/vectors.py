"""Products of vectors and small matrices, in the same bits on every processor.

numpy's `@` and `dot`, and its `linalg.norm` of a single vector, call BLAS, whose kernels differ by processor: in the
order in which they add, and in whether they fuse a product with a sum. What begins a run or moves its bodies goes
through here instead: a sum along an axis, and einsum without `optimize`, never call BLAS.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from nuno_schemas.fabric import Float, Int

CERTAIN = 3.4e-16
"""Share of its terms' sizes above which the sign of a turn in floating point is right (Shewchuk 1997, Adaptive
precision floating-point arithmetic and fast robust geometric predicates, 4.3)."""


def dot(a: Float, b: Float) -> Float:
    """(...) products of vectors a and b (..., k)."""
    return np.asarray((a * b).sum(axis=-1))


def norm(v: Float) -> Float:
    """(...) lengths of vectors (..., k)."""
    return np.asarray(np.sqrt(dot(v, v)))


def turn(matrices: Float, vectors: Float) -> Float:
    """(..., i) products of matrices (..., i, k) with vectors (..., k)."""
    return np.asarray(np.einsum("...ik,...k->...i", matrices, vectors))


def compose(first: Float, second: Float) -> Float:
    """(..., i, k) products of matrices (..., i, j) and (..., j, k): what turns by `second`, then by `first`."""
    return np.asarray(np.einsum("...ij,...jk->...ik", first, second))


def sides(a: Float, b: Float, c: Float) -> Int:
    """(...) 1 where points c (..., 2) lie to the left of the way from a to b (..., 2), -1 to the right, 0 on its line:
    exactly, where rounding leaves a doubt in fractions.
    """
    a, b, c = np.broadcast_arrays(a, b, c)
    (ux, uy), (vx, vy) = np.moveaxis(a - c, -1, 0), np.moveaxis(b - c, -1, 0)
    found = ux * vy - uy * vx
    sign: Int = np.sign(found).astype(np.int32)
    for at in zip(*np.nonzero(np.abs(found) < CERTAIN * (np.abs(ux * vy) + np.abs(uy * vx))), strict=True):
        (x, y), (u, v), (p, q) = ([Fraction(value) for value in point[at].tolist()] for point in (a, b, c))
        turn = (x - p) * (v - q) - (y - q) * (u - p)
        sign[at] = (turn > 0) - (turn < 0)
    return sign
