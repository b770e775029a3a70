"""The steps of XPBD: where a vertex would go alone, sweeps over constraints and contact, where it went."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange

from nuno_integrators.xpbd.constraints import clear, forget, sweep
from nuno_kernels import kernel, parallel_kernel
from nuno_kernels.step.acceleration import commit, evaluate
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import each

carry = each("carry", "x, u, y, w, s")
project = each("project", "x, u, y, w, s, inverse_step, mobility, held, threads")


@kernel
def predict_block(
    block: int, v: Any, u: Any, a: Any, dt: float, inverse_mass: Any, gravity: Any, damping: float, mobility: Any
) -> None:
    """Displacement u without constraints, and mobility h^2 / (m (1 + h damping)), on a block's vertices.

    `a` (3, n) holds gravity and explicit forces, or is None. Pinned vertices move at their velocity.
    """
    low, high = block * BLOCK, min((block + 1) * BLOCK, u.shape[1])
    kept = 1.0 / (1.0 + dt * damping)
    for i in range(np.uint64(low), np.uint64(high)):
        mobility[0, i] = dt * dt * kept * inverse_mass[i]
    for row in range(3):
        g = gravity[row]
        for i in range(np.uint64(low), np.uint64(high)):
            pull = g if a is None else a[row, i]
            own = kept * (dt * v[row, i] + dt * dt * pull)
            u[row, i] = own if inverse_mass[i] > 0.0 else dt * v[row, i]


@kernel
def arrive_block(block: int, x: Any, v: Any, u: Any, inverse_step: float) -> None:
    """x += u and v = u / h on a block's vertices."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, u.shape[1])
    for row in range(3):
        for i in range(np.uint64(low), np.uint64(high)):
            x[row, i] += u[row, i]
            v[row, i] = u[row, i] * inverse_step


@parallel_kernel
def predict_parallel(
    v: Any, u: Any, a: Any, dt: float, inverse_mass: Any, gravity: Any, damping: float, mobility: Any
) -> None:
    """All blocks on several threads."""
    for block in prange((u.shape[1] + BLOCK - 1) // BLOCK):
        predict_block(block, v, u, a, dt, inverse_mass, gravity, damping, mobility)


@parallel_kernel
def arrive_parallel(x: Any, v: Any, u: Any, inverse_step: float) -> None:
    """All blocks on several threads."""
    for block in prange((u.shape[1] + BLOCK - 1) // BLOCK):
        arrive_block(block, x, v, u, inverse_step)


@kernel
def predict(
    v: Any, u: Any, a: Any, dt: float, inverse_mass: Any, gravity: Any, damping: float, mobility: Any, threads: Any
) -> None:
    """Fill u (3, n) and mobility (1, n)."""
    if threads is None:
        for block in range((u.shape[1] + BLOCK - 1) // BLOCK):
            predict_block(block, v, u, a, dt, inverse_mass, gravity, damping, mobility)
    else:
        predict_parallel(v, u, a, dt, inverse_mass, gravity, damping, mobility)


@kernel
def arrive(x: Any, v: Any, u: Any, inverse_step: float, threads: Any) -> None:
    """Move x, v (3, n) by u."""
    if threads is None:
        for block in range((u.shape[1] + BLOCK - 1) // BLOCK):
            arrive_block(block, x, v, u, inverse_step)
    else:
        arrive_parallel(x, v, u, inverse_step)


@kernel
def advance_xpbd(
    x: Any, v: Any, stages: Any, steps: int, dt: float, p: Any, extra: Any, others: Any, c: Any, mobility: Any,
    held: Any, iterations: int,
) -> None:  # fmt: skip
    """`steps` steps of x, v (3, n); stages (4, 3, n).

    `others` (Packed, or None) are the forces without constraint, c the Constraints, mobility (1, n) and
    held (3, n, or None) scratch.
    """
    u, y, w = stages[0], stages[1], stages[2]
    a = None if others is None else stages[3]
    inverse_step = 1.0 / dt
    for step in range(steps):
        if others is not None:
            evaluate(x, v, step / steps, stages[3], others, extra)
        predict(v, u, a, dt, p.inverse_mass, p.gravity, p.damping, mobility, p.threads)
        end = (step + 1) / steps
        carry(p.bodies, p.bodies_on, x, u, y, w, end)
        forget(c.kinds, c.on)
        clear(held)
        for _ in range(iterations):
            sweep(x, u, mobility, inverse_step, c.colour, c.kinds, c.on, p.threads)
            project(p.bodies, p.bodies_on, x, u, y, w, end, inverse_step, mobility, held, p.threads)
        arrive(x, v, u, inverse_step, p.threads)
        commit(x, v, end, p.bodies, p.bodies_on, p.threads)
