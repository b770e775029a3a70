"""The whole acceleration a(x, v, t) of the terms that a scene has.

`evaluate` is what every integrator's loop calls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_kernels import block_kernel
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.lanes import WIDTH, load, write
from nuno_kernels.step.blocks import BLOCK, PADDING, Long
from nuno_kernels.terms import Terms, each, over_blocks
from nuno_schemas.fabric import Bool, Float

add_blocks = each("block", "block, origin, x, v, force, t")
place = each("place", "x, v, s")
look_at = each("look", "x, v")
add_after = each("after", "x, v, s, a, threads")
settle_bodies = each("settle", "x, v, s, threads")
hold = each("hold", "x, v, s, threads")
slow = each("slow", "x, v, threads")
credit = each("credit", "change")
OF_BODIES = ("place", "look", "after", "settle", "hold", "slow", "credit")
"""roles in which steps call what carries vertices, meets them or holds them"""


@by_reference
class Packed(NamedTuple):
    """A system in the layout of the kernels.

    inverse_mass  (n,) [1/kg], 0 for pinned vertices
    gravity       (3,) [m/s^2]
    damping       [1/s], a -= damping v
    forces        terms that add to the forces block by block (nuno_kernels.terms), and (forces,) which of them act
    bodies        terms that carry vertices, meet them or hold them, and (bodies,) which of them act
    threads       None: compiled for one thread; else how many run
    late          None: all forces go by blocks, and a block is finished while it is in the core's
                  cache; True: bodies or forces in Python add to the forces afterwards
    velocity_matters  whether any force reads the velocity
    moved         whether bodies move vertices or friction's anchors after a step: an acceleration found before is
                  then not that of the next step's start
    frozen_damping    [1/s] of a method that takes it at the step's start (rk4_printed)
    time          (2,) [s] when the interval begins, and its length
    leave         (1,) not 0: what loops over steps is to return at once, wherever it is; another thread may write it
    """

    inverse_mass: Float
    gravity: Float
    damping: float
    forces: Terms = Terms()
    forces_on: Bool = np.ones(0, np.bool_)
    bodies: Terms = Terms()
    bodies_on: Bool = np.ones(0, np.bool_)
    threads: int | None = None
    late: bool | None = None
    velocity_matters: bool = True
    moved: bool = False
    frozen_damping: float = 0.0
    time: Float = np.zeros(2)
    leave: Long = np.zeros(1, np.int64)


@block_kernel
def finish_block(block: int, v: Float, a: Float, inverse_mass: Float, gravity: Float, damping: float) -> None:
    """Turn a block's forces into accelerations, in place; 0 for pinned vertices."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, a.shape[1])
    for row in range(3):
        g = gravity[row]
        for p in range(np.uint64(low), np.uint64(high)):
            w = inverse_mass[p]
            factor = g - damping * v[row, p]
            a[row, p] = w * a[row, p] + (factor if w > 0.0 else 0.0)


class Step(NamedTuple):
    """The length of a step [s], and the viscous damping in it [1/s]."""

    dt: float
    damping: float


@block_kernel
def step_block(
    block: int, x: Float, v: Float, force: Float, inverse_mass: Float, gravity: Float, step: Step, to_x: Float,
    to_v: Float,
) -> None:  # fmt: skip
    """Take a step of symplectic Euler from x, v (3, n) and a block's forces (3, w), with the bits of `finish_block` and
    `add_twice`, but in one pass.
    """
    low, high, dt, damping = block * BLOCK, min((block + 1) * BLOCK, x.shape[1]), step.dt, step.damping
    for row in range(3):
        g = gravity[row]
        for i in range(np.uint64(low), np.uint64(high)):
            w = inverse_mass[i]
            free = g - damping * v[row, i]
            a = w * force[row, i - np.uint64(low)] + (free if w > 0.0 else 0.0)
            moved = v[row, i] + dt * a
            to_v[row, i] = moved
            to_x[row, i] = x[row, i] + dt * moved


@block_kernel
def force_block(block: int, p: Packed, t: float, dt: float, x: Float, v: Float, to_x: Float, to_v: Float) -> None:
    """Compute forces on a block's vertices at the time t [s], summed in the core's cache: a step of symplectic Euler
    into to_x, to_v (3, n), or, if dt is 0, accelerations into to_x, newtons if p.late. One function for both: each kind
    would compile all forces anew.
    """
    origin = block * BLOCK
    width = min(BLOCK, x.shape[1] - origin)
    force = np.zeros((3, width + PADDING))
    add_blocks(p.forces, p.forces_on, block, origin, x, v, force, t)
    if dt != 0.0:
        step_block(block, x, v, force, p.inverse_mass, p.gravity, Step(dt, p.damping), to_x, to_v)
    else:
        for q in range(0, width, WIDTH):
            m = min(WIDTH, width - q)
            for row in range(3):
                write(to_x, row, origin + q, m, load(force, row, q))
        if p.late is None:
            finish_block(block, v, to_x, p.inverse_mass, p.gravity, p.damping)


finish_blocks = over_blocks(finish_block, "v, a, inverse_mass, gravity, damping")
force_blocks = over_blocks(force_block, "p, t, dt, x, v, to_x, to_v")


@block_kernel
def add_forces(x: Float, v: Float, s: float, to_x: Float, to_v: Float, dt: float, p: Packed) -> None:
    """Compute forces [N] at fraction s of the frame into to_x (3, n), or accelerations unless p.late, or, if dt is not
    0, a whole step into to_x and to_v. Places carried vertices first.
    """
    place(p.bodies, p.bodies_on, x, v, s)
    look_at(p.bodies, p.bodies_on, x, v)
    t = p.time[0] + s * p.time[1]
    force_blocks(p, t, dt, x, v, to_x, to_v, (x.shape[1] + BLOCK - 1) // BLOCK, p.threads)
    add_after(p.bodies, p.bodies_on, x, v, s, to_x, p.threads)


@block_kernel
def finish(v: Float, a: Float, inverse_mass: Float, gravity: Float, damping: float, threads: int | None) -> None:
    """Turn forces in a (3, n) into accelerations [m/s^2]. The system is no argument, or each kind of one would have its
    own version compiled.
    """
    finish_blocks(v, a, inverse_mass, gravity, damping, (a.shape[1] + BLOCK - 1) // BLOCK, threads)


@block_kernel
def evaluate(x: Float, v: Float, s: float, a: Float, p: Packed) -> None:
    """Compute a (3, n) = acceleration [m/s^2] at x, v (3, n) and fraction s of the frame."""
    add_forces(x, v, s, a, a, 0.0, p)
    if p.late is not None:
        finish(v, a, p.inverse_mass, p.gravity, p.damping, p.threads)


@block_kernel
def settle(x: Float, v: Float, s: float, bodies: Terms, on: Bool, threads: int | None) -> None:
    """After a whole step that ends at fraction s: place carried vertices, update friction anchors."""
    place(bodies, on, x, v, s)
    settle_bodies(bodies, on, x, v, s, threads)


@block_kernel
def commit(x: Float, v: Float, s: float, bodies: Terms, on: Bool, threads: int | None) -> None:
    """After a whole step that ends at fraction s: place carried vertices, hold vertices off the bodies that they slide
    on, and update friction anchors on the others by where that leaves them.
    """
    place(bodies, on, x, v, s)
    hold(bodies, on, x, v, s, threads)
    settle_bodies(bodies, on, x, v, s, threads)
