"""Products of vectors and small matrices, in the same bits on every processor.

numpy's `@` and `dot`, and its `linalg.norm` of a single vector, call BLAS, whose kernels differ by processor: in the
order in which they add, and in whether they fuse a product with a sum. What begins a run or moves its bodies goes
through here instead: a sum along an axis, and einsum without `optimize`, never call BLAS.
"""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Float


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
