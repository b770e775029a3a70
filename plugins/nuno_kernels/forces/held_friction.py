"""Bending friction that is held over several steps, for methods of many small steps.

Friction is far softer than tension, which sets their step. Its force is found where the cloth will be in the middle of
the time T for which it is then held, x + v T / 2. An element that holds, x'' = -omega^2 x, goes over T by

    x' = x + v T - (omega T)^2 (x + v T / 2) / 2,    v' = v - omega^2 T (x + v T / 2),

whose determinant is 1: it neither grows nor fades for omega T < 2. Found at x, the force would lag and feed the swing.
Leapfrog begins a step with the force of the last: looked for a step h further ahead, the swing fades a little with
every method, by about omega^2 h / 2 at most, and is stable for (omega T)^2 (1 / 2 + h / T) < 2: with two steps at
least, for omega T < sqrt(2).
"""

from __future__ import annotations

import numpy as np

from nuno_kernels import block_kernel, kernel
from nuno_kernels.forces.bending_friction import (
    PARTS,
    FrictionLists,
    HeldFriction,
    add_friction,
    measure_friction,
    settle_block,
    settle_each,
)
from nuno_kernels.lanes.simd import WIDTH, read, write
from nuno_kernels.step.blocks import BLOCK, PADDING
from nuno_kernels.terms import over_blocks, register
from nuno_schemas.fabric import Float

NOT_HELD = -1.0
"""stands for the time for which the force is still held"""
LONGEST = 1.4
"""limit of T times omega"""


@kernel
def add_held(held: HeldFriction, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add the held force to a block's forces (3, w), or that at x if none is held."""
    if held.clock[0] < 0.0:
        add_friction(held, block, origin, x, v, force)
        return
    end = min(origin + BLOCK, x.shape[1])
    for row in range(3):
        for i in range(origin, end, WIDTH):
            m = min(WIDTH, end - i)
            write(force, row, i - origin, m, read(force, row, i - origin, m) + read(held.force, row, i, m))


@block_kernel
def find_block(block: int, held: HeldFriction, x: Float, ahead: Float) -> None:
    """Move k' of a block's patches that slip at x (3, n), and compute their force at `ahead` (3, n)."""
    origin, end = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    force = np.zeros((3, end - origin + PADDING))
    settle_block(block, x, held)
    add_friction(held, block, origin, ahead, ahead, force)
    for row in range(3):
        for i in range(origin, end):
            held.force[row, i] = force[row, i - origin]


find_each = over_blocks(find_block, "held, x, ahead")


@kernel
def settle_held(held: HeldFriction, x: Float, v: Float, s: float, threads: int | None) -> None:
    """Compute the force anew if it has been held for its time, for as many steps like the last as that has; if those
    are fewer than two, move k' of what slips, and hold nothing.
    """
    clock, blocks = held.clock, held.start.shape[0] - 1
    now = s * clock[2]
    step = now - clock[1]
    clock[1] = now
    if 2.0 * step > clock[3]:
        clock[0] = NOT_HELD
        settle_each(x, held, blocks, threads)
        return
    clock[0] = max(clock[0], 0.0) - step
    if clock[0] < 0.5 * step:
        clock[0] = step * np.floor(clock[3] / step)
        find_each(held, x, x + (0.5 * clock[0] + step) * v, blocks, threads)


def hold(lists: FrictionLists, inverse_mass: Float) -> HeldFriction:
    """Return patches whose force is held for LONGEST over omega, omega^2 bounding how fast vertices of these masses
    (n,) may oscillate, by the sums of the rows of the matrix if all stick (Gershgorin).
    """
    shares = lists.shares.reshape(-1, PARTS, lists.shares.shape[1])[:, 2:]
    shares = np.abs(np.concatenate([-shares.sum(axis=0, keepdims=True), shares]))
    rows = (shares * shares.sum(axis=0) * (lists.constants[:3] * lists.constants[3])).sum(axis=1)
    squared, corners = np.zeros(len(inverse_mass)), lists.corners[: len(rows)]
    np.add.at(squared, corners, rows * inverse_mass[corners])
    clock = np.array([NOT_HELD, 0.0, 0.0, LONGEST / np.sqrt(squared.max(initial=0.0) or 1.0)])
    return HeldFriction(*lists, np.zeros((3, len(inverse_mass))), clock)


def begin(held: HeldFriction, x: Float, span: float, threads: int | None) -> None:
    """Begin an interval of `span` [s], 0 if the state is only examined."""
    if span > 0.0:
        held.clock[1], held.clock[2] = 0.0, span


register(
    HeldFriction,
    name="bending_friction",
    memory=("rested", "force", "clock"),
    block=add_held,
    settle=settle_held,
    begin=begin,
    energy=measure_friction,
)
