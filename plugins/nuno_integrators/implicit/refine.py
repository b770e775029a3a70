"""Conjugate gradients with a factorisation as preconditioner: for terms of the matrix that are not in the factor."""

from __future__ import annotations

import numpy as np

from nuno_integrators.implicit.conjugate import along, turn_and_multiply
from nuno_integrators.implicit.factor import Factor, solve_factored
from nuno_integrators.implicit.matrix import Linear
from nuno_schemas.fabric import Float

MOST = 200


def refine(a: Linear, factor: Factor, b: Float, tolerance: float, threads: int | None) -> int:
    """Bring a.x, the factor's solution for b (3, n), to A^-1 b, until sqrt(r.z) is `tolerance` of sqrt(b.x). Return the
    iterations; 0, with a.x unchanged, if the factor lacks nothing.
    """
    target = tolerance * tolerance * along(b, a.x)
    x, turn, before = a.x.copy(), 0.0, 1.0
    a.p[...], a.z[...] = 0.0, x
    turn_and_multiply(0.0, a, threads)
    np.subtract(b, a.q, out=a.r)
    for iteration in range(MOST):
        solve_factored(factor, a.r, a.z)
        rz = along(a.r, a.z)
        if not rz > target:
            break
        turn = rz / before if iteration else 0.0
        curvature = turn_and_multiply(turn, a, threads)
        if not curvature > 0.0:
            break
        step = rz / curvature
        x += step * a.p
        np.subtract(a.r, step * a.q, out=a.r)
        before = rz
    a.x[...] = x
    return iteration
