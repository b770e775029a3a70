"""The whole acceleration a(x, v, t), compiled for just the terms that a scene has.

A term passed as None is pruned when numba compiles. `evaluate` is what every integrator's loop
calls: the same source runs compiled, and in plain Python where a force is written in Python.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba import prange

from nuno_kernels import kernel, parallel_kernel, shared_source
from nuno_kernels.blocks import BLOCK, PADDING
from nuno_kernels.hinges import HingeLists, HingeRuns, add_hinge_lists, add_hinge_runs
from nuno_kernels.simd import WIDTH, load, write
from nuno_kernels.springs import SpringLists, SpringRuns, add_lists, add_runs
from nuno_schemas.fabric import Float

if TYPE_CHECKING:
    from nuno_kernels.bindings import Bindings
    from nuno_kernels.contact import Contact
    from nuno_kernels.slides import Slides
    from nuno_kernels.wind import Air, ParticleWind, WindLists, WindRuns
    from nuno_kernels.yarns import YarnLists

# Kernels of terms that not every scene has. Their modules put them here, and are loaded only where a term
# brings them in: without it numba prunes the branches that name them.
place_bound: Any = None
add_contact: Any = None
add_contact_parallel: Any = None
commit_contact: Any = None
commit_contact_parallel: Any = None
commit_slides: Any = None
commit_slides_parallel: Any = None
slow_slides: Any = None
slow_slides_parallel: Any = None
add_particle_wind: Any = None
add_wind_lists: Any = None
add_wind_runs: Any = None
add_yarns: Any = None


def provide(**kernels: Any) -> None:
    """Make kernels known by the names that stand above."""
    unknown = kernels.keys() - globals().keys()
    assert not unknown, f"no place for {', '.join(sorted(unknown))}"
    globals().update(kernels)


class Packed(NamedTuple):
    """A system in the layout of the kernels; absent terms are None.

    inverse_mass  (n,) [1/kg], 0 for pinned vertices
    gravity       (3,) [m/s^2]
    damping       [1/s], a -= damping v
    threads       None: compiled for one thread; else how many run
    late          None: all forces go by blocks, and a block is finished while it is in the core's
                  cache; True: contact or Python adds to the forces afterwards
    velocity_matters  whether any force reads the velocity
    frozen_damping    [1/s] of a method that takes it at the step's start (rk4_printed)
    """

    inverse_mass: Float
    gravity: Float
    damping: float
    runs: SpringRuns | None = None
    lists: SpringLists | None = None
    hinge_runs: HingeRuns | None = None
    hinge_lists: HingeLists | None = None
    bindings: Bindings | None = None
    contact: Contact | None = None
    slides: Slides | None = None
    air: Air | None = None
    wind_runs: WindRuns | None = None
    wind_lists: WindLists | None = None
    particle_wind: ParticleWind | None = None
    yarns: YarnLists | None = None
    threads: int | None = None
    late: bool | None = None
    velocity_matters: bool = True
    frozen_damping: float = 0.0


@kernel
def finish_block(block: int, v: Any, a: Any, inverse_mass: Any, gravity: Any, damping: float) -> None:
    """Turn a block's forces into accelerations, in place; pinned vertices get none."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, a.shape[1])
    for row in range(3):
        g = gravity[row]
        for p in range(np.uint64(low), np.uint64(high)):
            w = inverse_mass[p]
            own = g - damping * v[row, p]
            a[row, p] = w * a[row, p] + (own if w > 0.0 else 0.0)


@kernel
def step_block(
    block: int, x: Any, v: Any, force: Any, dt: float, inverse_mass: Any, gravity: Any, damping: float,
    to_x: Any, to_v: Any,
) -> None:  # fmt: skip
    """A step of symplectic Euler from x, v (3, n) and a block's forces (3, w), with the bits of `finish_block`
    and `add_twice`, but in one pass.
    """
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    for row in range(3):
        g = gravity[row]
        for p in range(np.uint64(low), np.uint64(high)):
            w = inverse_mass[p]
            own = g - damping * v[row, p]
            a = w * force[row, p - np.uint64(low)] + (own if w > 0.0 else 0.0)
            moved = v[row, p] + dt * a
            to_v[row, p] = moved
            to_x[row, p] = x[row, p] + dt * moved


@kernel
def force_block(
    block: int, x: Any, v: Any, a: Any, inverse_mass: Any, gravity: Any, damping: float,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any,
    air: Any, wind_runs: Any, wind_lists: Any, particle_wind: Any, yarns: Any, late: Any,
    to_x: Any, to_v: Any, dt: float,
) -> None:  # fmt: skip
    """Forces [N] on a block's vertices, summed in the core's cache and written to a (3, n); or, where dt is not 0,
    a step of symplectic Euler into to_x and to_v. One function for both: each kind would compile all forces anew.
    """
    origin = block * BLOCK
    width = min(BLOCK, x.shape[1] - origin)
    force = np.zeros((3, width + PADDING))
    if particle_wind is not None:
        add_particle_wind(particle_wind, force)
    if runs is not None:
        r = runs
        add_runs(block, origin, x, v, force, r.start, r.task, r.constants, r.each, r.damped, r.locks)
    if lists is not None:
        s = lists
        add_lists(block, x, v, force, s.start, s.ends, s.constants, s.damped, s.locks)
    if hinge_runs is not None:
        h = hinge_runs
        add_hinge_runs(block, origin, x, force, h.start, h.task, h.constants, h.curved)
    if hinge_lists is not None:
        g = hinge_lists
        add_hinge_lists(block, x, force, g.start, g.corners, g.constants, g.curved)
    if wind_runs is not None:
        add_wind_runs(block, origin, x, v, force, wind_runs.start, wind_runs.task, air)
    if wind_lists is not None:
        add_wind_lists(block, x, v, force, wind_lists.start, wind_lists.corners, air)
    if yarns is not None:
        add_yarns(block, x, v, force, yarns)
    if dt != 0.0:
        step_block(block, x, v, force, dt, inverse_mass, gravity, damping, to_x, to_v)
    else:
        for q in range(0, width, WIDTH):
            m = min(WIDTH, width - q)
            for row in range(3):
                write(a, row, origin + q, m, load(force, row, q))
        if late is None:
            finish_block(block, v, a, inverse_mass, gravity, damping)


@parallel_kernel
def force_parallel(
    x: Any, v: Any, a: Any, inverse_mass: Any, gravity: Any, damping: float,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any,
    air: Any, wind_runs: Any, wind_lists: Any, particle_wind: Any, yarns: Any, late: Any,
    to_x: Any, to_v: Any, dt: float,
) -> None:  # fmt: skip
    """All blocks on several threads: see `force_block`."""
    for block in prange((x.shape[1] + BLOCK - 1) // BLOCK):
        force_block(
            block, x, v, a, inverse_mass, gravity, damping, runs, lists, hinge_runs, hinge_lists,
            air, wind_runs, wind_lists, particle_wind, yarns, late, to_x, to_v, dt,
        )  # fmt: skip


@parallel_kernel
def finish_parallel(v: Any, a: Any, inverse_mass: Any, gravity: Any, damping: float) -> None:
    """Forces in a (3, n) become accelerations [m/s^2], on several threads."""
    for block in prange((a.shape[1] + BLOCK - 1) // BLOCK):
        finish_block(block, v, a, inverse_mass, gravity, damping)


@kernel
def add_forces(
    x: Any, v: Any, s: float, a: Any, inverse_mass: Any, gravity: Any, damping: float,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any, bindings: Any, contact: Any,
    air: Any, wind_runs: Any, wind_lists: Any, particle_wind: Any, yarns: Any, threads: Any, late: Any,
    to_x: Any, to_v: Any, dt: float,
) -> None:  # fmt: skip
    """Forces [N] at fraction s of the frame into a (3, n), or accelerations unless `late`, or a whole step.

    Puts bound vertices in their place first. Loops over blocks stand here, not in functions of
    their own: every level of calls is optimised once more with all that it calls.
    """
    if bindings is not None:
        place_bound(x, v, s, bindings)
    if threads is None:
        for block in range((x.shape[1] + BLOCK - 1) // BLOCK):
            force_block(
                block, x, v, a, inverse_mass, gravity, damping, runs, lists, hinge_runs, hinge_lists,
                air, wind_runs, wind_lists, particle_wind, yarns, late, to_x, to_v, dt,
            )  # fmt: skip
    else:
        force_parallel(
            x, v, a, inverse_mass, gravity, damping, runs, lists, hinge_runs, hinge_lists,
            air, wind_runs, wind_lists, particle_wind, yarns, late, to_x, to_v, dt,
        )  # fmt: skip
    if contact is not None:
        if threads is None:
            add_contact(x, v, s, contact, a)
        else:
            add_contact_parallel(x, v, s, contact, a)


@kernel
def finish(v: Any, a: Any, inverse_mass: Any, gravity: Any, damping: float, late: Any, threads: Any) -> None:
    """Forces in a (3, n) become accelerations [m/s^2] where they did not at once."""
    if late is not None:
        if threads is None:
            for block in range((a.shape[1] + BLOCK - 1) // BLOCK):
                finish_block(block, v, a, inverse_mass, gravity, damping)
        else:
            finish_parallel(v, a, inverse_mass, gravity, damping)


@shared_source
def evaluate(x: Any, v: Any, s: float, a: Any, p: Any, extra: Any) -> None:
    """a (3, n) = acceleration [m/s^2] at x, v (3, n) and fraction s of the frame.

    `extra(x, v, s, a)` adds newtons to a; it needs plain Python, None does not.
    """
    add_forces(
        x, v, s, a, p.inverse_mass, p.gravity, p.damping, p.runs, p.lists, p.hinge_runs, p.hinge_lists,
        p.bindings, p.contact, p.air, p.wind_runs, p.wind_lists, p.particle_wind, p.yarns, p.threads, p.late, a, a, 0.0,
    )  # fmt: skip
    if extra is not None:
        extra(x, v, s, a)
    finish(v, a, p.inverse_mass, p.gravity, p.damping, p.late, p.threads)


@kernel
def commit(x: Any, v: Any, s: float, bindings: Any, contact: Any, slides: Any, threads: Any) -> None:
    """After a whole step that ends at fraction s: place bound vertices, hold vertices off the bodies that they slide
    on, and update friction anchors on the others by where that leaves them.
    """
    if bindings is not None:
        place_bound(x, v, s, bindings)
    if slides is not None:
        if threads is None:
            commit_slides(x, v, s, slides)
        else:
            commit_slides_parallel(x, v, s, slides)
    if contact is not None:
        if threads is None:
            commit_contact(x, v, s, contact)
        else:
            commit_contact_parallel(x, v, s, contact)


@kernel
def hold(x: Any, v: Any, s: float, slides: Any, threads: Any) -> None:
    """Hold vertices that have moved up to fraction s of the frame off the bodies that they slide on."""
    if slides is not None:
        commit(x, v, s, None, None, slides, threads)


@kernel
def slow(x: Any, v: Any, slides: Any, threads: Any) -> None:
    """Hold velocities off the planes that hold the vertices since they were last held off."""
    if slides is not None:
        if threads is None:
            slow_slides(x, v, slides)
        else:
            slow_slides_parallel(x, v, slides)
