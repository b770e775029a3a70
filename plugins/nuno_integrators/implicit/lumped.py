"""The stiffness of forces that act on each vertex alone: measured by differences, made symmetric and positive."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_kernels import block_kernel, kernel
from nuno_schemas.fabric import Float

MOST_SWEEPS = 12
"""sweeps at most: Jacobi's method converges quadratically, and 3 x 3 matrices take four or five"""
EPSILON = float(np.finfo(float).eps)


@kernel
def rotate(a: Float, vectors: Float, p: int, q: int) -> None:
    """Apply one rotation of Jacobi's method, which makes a[p, q] zero (Golub & Van Loan, Matrix Computations, 8.5)."""
    if a[p, q] == 0.0:
        return
    tau = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
    t = (1.0 if tau >= 0.0 else -1.0) / (abs(tau) + np.sqrt(1.0 + tau * tau))
    c = 1.0 / np.sqrt(1.0 + t * t)
    s = t * c
    for k in range(3):
        a[k, p], a[k, q] = c * a[k, p] - s * a[k, q], s * a[k, p] + c * a[k, q]
    for k in range(3):
        a[p, k], a[q, k] = c * a[p, k] - s * a[q, k], s * a[p, k] + c * a[q, k]
    for k in range(3):
        vectors[k, p], vectors[k, q] = c * vectors[k, p] - s * vectors[k, q], s * vectors[k, p] + c * vectors[k, q]


@kernel
def keep_positive(a: Float, vectors: Float, values: Float) -> None:
    """Replace the symmetric a (3, 3) by its part with positive eigenvalues; the others are scratch."""
    minor = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
    rest = a[0, 1] * a[1, 2] - a[1, 1] * a[0, 2]
    determinant = a[2, 2] * minor + a[0, 2] * rest - a[1, 2] * (a[0, 0] * a[1, 2] - a[0, 1] * a[0, 2])
    if a[0, 0] > 0.0 and minor > 0.0 and determinant > 0.0:
        return
    # Entry by entry: array expressions take seconds more to compile, above all for the errors of shapes that differ.
    size = 0.0
    for i in range(3):
        for j in range(3):
            vectors[i, j] = 1.0 if i == j else 0.0
            if abs(a[i, j]) > size or np.isnan(a[i, j]):
                size = abs(a[i, j])
    for _ in range(MOST_SWEEPS):
        if max(abs(a[0, 1]), abs(a[0, 2]), abs(a[1, 2])) <= EPSILON * size:
            break
        rotate(a, vectors, 0, 1)
        rotate(a, vectors, 0, 2)
        rotate(a, vectors, 1, 2)
    for k in range(3):
        values[k] = max(a[k, k], 0.0)
    for i in range(3):
        for j in range(3):
            a[i, j] = 0.0
            for k in range(3):
                a[i, j] += vectors[i, k] * values[k] * vectors[j, k]


@block_kernel
def add_stiffness(base: Float, moved: Float, scale: Any, diagonal: Float) -> None:
    """Subtract from own (6, n) the change of the accelerations base (3, n) as all vertices move along each axis, (3, 3,
    n): scale (n,) times the differences, mass over the way.
    """
    a, vectors, values = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for p in range(base.shape[1]):
        for i in range(3):
            for j in range(3):
                a[i, j] = 0.5 * scale[p] * ((base[i, p] - moved[j, i, p]) + (base[j, p] - moved[i, j, p]))
        if not np.any(a):
            continue
        keep_positive(a, vectors, values)
        for i in range(3):
            diagonal[i, p] += a[i, i]
        diagonal[3, p] += a[0, 1]
        diagonal[4, p] += a[0, 2]
        diagonal[5, p] += a[1, 2]
