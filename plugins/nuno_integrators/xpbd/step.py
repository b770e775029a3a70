"""The steps of XPBD: where a vertex would go alone, sweeps over constraints and contact, where it went."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import block_kernel, kernel, shared_source
from nuno_kernels.forces.constraints import Constraints, clear, sweep
from nuno_kernels.forces.constraints import forget as forget_each
from nuno_kernels.step.acceleration import Extra, Packed, commit, evaluate
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import Displaced, each, over_blocks
from nuno_schemas.fabric import Bool, Float

carry_each = each("carry", "moved, s")
project_each = each("project", "moved, s, held, threads")


@kernel
def carry(bodies: tuple[Any, ...], on: Bool, moved: Displaced, s: float) -> None:
    """Move carried vertices to where they are at fraction s."""
    carry_each(bodies, on, moved, s)


@kernel
def forget(kinds: tuple[Any, ...], on: Bool) -> None:
    """Let constraints keep no force of the step before."""
    forget_each(kinds, on)


@kernel
def project(
    bodies: tuple[Any, ...], on: Bool, moved: Displaced, s: float, held: Float | None, threads: int | None
) -> None:
    """Move vertices off bodies, and cloth off cloth."""
    project_each(bodies, on, moved, s, held, threads)


@block_kernel
def predict_block(
    block: int, v: Float, u: Float, a: Float | None, mobility: Float, inverse_mass: Float, gravity: Float,
    damping: float, dt: float,
) -> None:  # fmt: skip
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
            free = kept * (dt * v[row, i] + dt * dt * pull)
            u[row, i] = free if inverse_mass[i] > 0.0 else dt * v[row, i]


@block_kernel
def arrive_block(block: int, x: Float, v: Float, u: Float, inverse_step: float) -> None:
    """x += u and v = u / h on a block's vertices."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, u.shape[1])
    for row in range(3):
        for i in range(np.uint64(low), np.uint64(high)):
            x[row, i] += u[row, i]
            v[row, i] = u[row, i] * inverse_step


predict_blocks = over_blocks(predict_block, "v, u, a, mobility, inverse_mass, gravity, damping, dt")
arrive_blocks = over_blocks(arrive_block, "x, v, u, inverse_step")


@kernel
def predict(
    v: Float, u: Float, a: Float | None, mobility: Float, inverse_mass: Float, gravity: Float, damping: float,
    dt: float, threads: int | None,
) -> None:  # fmt: skip
    """Fill u (3, n) and mobility (1, n)."""
    blocks = (u.shape[1] + BLOCK - 1) // BLOCK
    predict_blocks(v, u, a, mobility, inverse_mass, gravity, damping, dt, blocks, threads)


@kernel
def arrive(x: Float, v: Float, u: Float, inverse_step: float, threads: int | None) -> None:
    """Move x, v (3, n) by u."""
    arrive_blocks(x, v, u, inverse_step, (u.shape[1] + BLOCK - 1) // BLOCK, threads)


@shared_source
def evaluate_others(x: Float, v: Float, s: float, a: Float, others: Packed | None, extra: Extra) -> None:
    """Acceleration [m/s^2] of the forces without constraint, where there are any."""
    if others is not None:
        evaluate(x, v, s, a, others, extra)


@shared_source
def felt(a: Float, others: Packed | None) -> Float | None:
    """What `evaluate_others` has found, None where it found nothing."""
    return None if others is None else a


class Swept(NamedTuple):
    """What an XPBD step works on beside a system."""

    others: Packed | None
    """The forces without constraint, None where there are none."""
    constraints: Constraints
    mobility: Float
    """(1, n) scratch"""
    held: Float | None
    """(3, n) scratch, or None: see nuno_contact.penalty.projection"""
    iterations: int


@kernel
def advance_xpbd(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, extra: Extra, own: Swept) -> None:
    """`steps` steps of x, v (3, n); stages (4, 3, n) is scratch."""
    c, inverse_step = own.constraints, 1.0 / dt
    moved = Displaced(x, stages[0], stages[1], stages[2], own.mobility, inverse_step)
    for step in range(steps):
        if p.leave[0] != 0:
            break
        evaluate_others(x, v, step / steps, stages[3], own.others, extra)
        force = felt(stages[3], own.others)
        predict(v, moved.u, force, own.mobility, p.inverse_mass, p.gravity, p.damping, dt, p.threads)
        end = (step + 1) / steps
        carry(p.bodies, p.bodies_on, moved, end)
        forget(c.kinds, c.on)
        clear(own.held)
        for _ in range(own.iterations):
            sweep(moved, c, p.threads)
            project(p.bodies, p.bodies_on, moved, end, own.held, p.threads)
        arrive(x, v, moved.u, inverse_step, p.threads)
        commit(x, v, end, p.bodies, p.bodies_on, p.threads)
