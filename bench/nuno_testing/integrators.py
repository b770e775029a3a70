"""The contract of integrators, tested on an oscillator against its closed form."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

from nuno.plugin_contract import registry
from nuno.runtime.stepper import check_kept
from nuno_schemas.bodies import BOX, Geometry, Poses, no_rows
from nuno_schemas.fabric import Fabric, Float, Springs, State
from nuno_schemas.system import Carried, System
from nuno_testing.subject import Subject, made_twice

OMEGA, DAMPING = 3.0, 0.6


def oscillator() -> System:
    """Return two free particles on springs of rest length 0 to a pinned one: x'' = -omega^2 x - damping x'."""
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.2, -0.3], [-0.5, 0.4, 0.9]])
    pairs = np.array([[0, 1], [0, 2]], np.int32)
    springs = Springs.from_pairs(pairs, np.full(2, 2.0 * OMEGA**2), np.zeros(2), np.zeros(2))
    velocity = np.array([[0.0, 0.0, 0.0], [0.1, -1.0, 0.5], [0.7, 0.0, -0.2]])
    faces = np.zeros((0, 3), np.int32)
    pinned = np.array([True, False, False])
    return System(Fabric("oscillator", x, velocity, np.full(3, 2.0), pinned, faces, springs), np.zeros(3), DAMPING)


def solution(system: System, t: float) -> Float:
    """Return x(t) of the damped oscillator in closed form."""
    x, v = system.fabric.position, system.fabric.velocity
    half, rate = 0.5 * DAMPING, np.sqrt(OMEGA**2 - 0.25 * DAMPING**2)
    return np.asarray(np.exp(-half * t) * (x * np.cos(rate * t) + (v + half * x) / rate * np.sin(rate * t)))


def exact_config(subject: Subject) -> Any:
    """Return a configuration with which every step has the given length and is solved to rounding."""
    exact = {"tolerance": 1.0, "residual": 1e-12}
    return subject.config.model_copy(update={n: x for n, x in exact.items() if n in type(subject.config).model_fields})


def run(subject: Subject, system: System, dt: float, *frames: int) -> State:
    """Return the state after frames of these numbers of steps, with new memory for each frame."""
    state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
    for steps in frames:
        memory = subject.plugin.prepare(exact_config(subject), system, state)
        assert subject.plugin.advance(system, state, memory, None, steps, dt).status == "ok"
        check_kept(memory, memory.arrays)
    return state


def a_step_of_the_stated_limit_lets_nothing_grow(subject: Subject) -> None:
    """The matrix of one step on the oscillator, as long as the limit says or 1 s, has no eigenvalue beyond 1."""
    system = oscillator()
    x, v = system.fabric.position, system.fabric.velocity
    limit = subject.plugin.limit(exact_config(subject), system, State(x.copy(), v.copy()))
    end = run(subject, system, min(float(limit.dt), 1.0), 1)
    before, after = (np.stack([one[1:].ravel() for one in pair]) for pair in ((x, v), (end.x, end.v)))
    matrix = after @ np.linalg.pinv(before)
    assert np.abs(matrix @ before - after).max() < 1e-12, "a step is no linear function of the state"
    assert np.abs(np.linalg.eigvals(matrix)).max() <= 1.0 + 1e-9, f"what the stated limit, {limit.dt:g} s, lets grow"


def the_error_falls_with_the_stated_order(subject: Subject) -> None:
    """The error against the closed form falls with the step by the integrator's `order`."""
    system, order = oscillator(), subject.plugin.order
    counts = np.array([8, 11, 16, 22] if order > 5 else [40, 80, 160, 320]) * (40 if order == 1 else 1)
    errors = [np.abs(run(subject, system, 1.0 / n, int(n)).x - solution(system, 1.0)).max() for n in counts]
    measured = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    message = f"order {measured:.2f}, and not {order}, on x'' = -{OMEGA:g}^2 x - {DAMPING:g} x': its damping included"
    assert abs(measured - order) < (0.1 if order < 5 else 0.3), message


def equal_runs_give_equal_bytes(subject: Subject) -> None:
    """A repeated run ends in the same bytes, without changing the fabric or moving pinned vertices."""
    system = oscillator()
    state = made_twice(lambda: run(subject, system, 0.01, 100), system.fabric)
    assert state.x[0].tobytes() == system.fabric.position[0].tobytes()


def frames_cut_anywhere_end_in_the_same_bytes(subject: Subject) -> None:
    """The state and the memory's arrays hold everything that a step needs from earlier steps."""
    system = oscillator()
    whole, cut = run(subject, system, 0.01, 12), run(subject, system, 0.01, 5, 0, 7)
    assert (whole.x.tobytes(), whole.v.tobytes()) == (cut.x.tobytes(), cut.v.tobytes())


def a_vertex_that_nothing_acts_on_stays_where_it_is(subject: Subject) -> None:
    """A free vertex off the origin does not move. Its layouts by vertex and axis are equal: none may be a view."""
    place, one = np.array([[1.0, 2.0, 3.0]]), np.ones(1)
    fabric = Fabric("one", place.copy(), np.zeros((1, 3)), one, one == 0.0, np.zeros((0, 3), np.int32))
    system, state = System(fabric, np.zeros(3)), State(place.copy(), np.zeros((1, 3)))
    subject.plugin.limit(exact_config(subject), system, state)
    memory = subject.plugin.prepare(exact_config(subject), system, state)
    assert subject.plugin.advance(system, state, memory, None, 2, 0.1).status == "ok"
    assert state.x.tolist() == fabric.position.tolist() == place.tolist()


INTEGRATORS = (
    a_step_of_the_stated_limit_lets_nothing_grow,
    the_error_falls_with_the_stated_order,
    equal_runs_give_equal_bytes,
    frames_cut_anywhere_end_in_the_same_bytes,
    a_vertex_that_nothing_acts_on_stays_where_it_is,
)


# The contract of integrators for cloth on a moving body, tested on a tray by laws that hold for any method.

SLOPE, WEIGHT, FRICTION = 3.0, 10.0, 0.5
"""Gravity along the tray and onto it [m/s^2], and the friction coefficient, which is larger than their ratio."""
STIFF, DEPTH = 100.0, 1e-3
"""Largest angular frequency of contact [1/s], and depth of the cloth at rest [m]."""
FEW, MANY = 3, 66
"""Vertices along a side of the cloth; with MANY a solver uses several threads."""
FRAME = 0.05
"""Length of a frame [s]."""


def tray(side: int, threads: int = 1) -> System:
    """Return cloth of side x side vertices, 1 m wide, on the sloping top of a box at height 0, and next to it a vertex
    that the box carries.
    """
    gravity = np.array([SLOPE, 0.0, -WEIGHT])
    axis = np.linspace(0.0, 1.0, side)
    x = np.stack([*np.meshgrid(axis, axis, indexing="ij"), np.full((side, side), -DEPTH)], axis=-1).reshape(-1, 3)
    x, number = np.concatenate([x, [[1.5, 0.5, 0.2]]]), np.arange(side * side, dtype=np.int32).reshape(side, side)
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], 1) for a, b in
                            ((number[1:], number[:-1]), (number[:, 1:], number[:, :-1]))])  # fmt: skip
    one, mass, pinned = np.ones(len(pairs)), np.full(len(x), 1e-3), np.arange(len(x)) == side * side
    springs = Springs.from_pairs(pairs, 2.0 * one, one / (side - 1), 0.01 * one)
    fabric = Fabric("cloth", x, np.zeros_like(x), mass, pinned, no_rows(np.int32, 3), springs)
    zero, one = np.zeros(1, np.int32), np.ones(1)
    box = Geometry(
        ("tray",), ("tray/world",), np.array([BOX], np.int8), zero, zero, np.array([[0.0, 0.0, -0.5]]),
        np.array([[3.0, 3.0, 0.5]]), 0.0 * one, 1e-3 * STIFF**2 * one, 0.5 * one, FRICTION * one,
    )  # fmt: skip
    penalty = registry.load("nuno.contacts", "penalty")
    carried = Carried(np.flatnonzero(pinned).astype(np.int32), x[pinned], zero)
    return System(fabric, gravity, 0.0, (penalty.prepare(penalty.Config(), fabric, box, gravity),), threads, (carried,))


def ride(subject: Subject, system: System, v: Float, along: Float, steps: int, frames: int = 2) -> State:
    """Return the state after some frames of `steps` steps on a tray that moves at constant velocity `along` (3,) [m/s];
    v (n, 3) [m/s] are the initial velocities relative to it.
    """
    state = State(system.fabric.position.copy(), v + along)
    memory = subject.plugin.prepare(exact_config(subject), system, state)
    for frame in range(frames):
        state.t = frame * FRAME
        poses = tuple(Poses(t, np.eye(4)[:1], along[None] * t) for t in (state.t, state.t + FRAME))
        report = subject.plugin.advance(system, state, memory, poses, steps, FRAME / steps)
        assert report.status == "ok", report.message
    return state


def random_velocities(system: System) -> Float:
    """Return random velocities (n, 3) [m/s], downwards in the mean, 0 for carried vertices."""
    v = 0.3 * np.random.default_rng(2).standard_normal(system.fabric.position.shape) - [0.0, 0.0, 0.1]
    v[system.fabric.pinned] = 0.0
    return v


def all_is_the_same_on_a_body_that_moves_evenly(subject: Subject) -> None:
    """Galilei's law: cloth moves on a body at constant velocity as on a still one. It fails unless each evaluation and
    each commit uses the bodies' poses at its time, and carried vertices end a frame with their bodies.
    """
    system, along = tray(FEW), np.array([0.7, -0.4, 1.1])
    still, moved = (ride(subject, system, random_velocities(system), v, 50) for v in (0.0 * along, along))
    shift, carried = 2.0 * FRAME * along, system.fabric.pinned
    assert np.abs(still.x[~carried] - system.fabric.position[~carried]).max() > 1e-3
    assert np.abs(moved.x - still.x - shift).max() < 1e-9
    assert np.abs(moved.v - still.v - along).max() < 1e-7
    assert np.abs(moved.x - system.fabric.position - shift)[carried].max() < 1e-12


def friction_slows_what_slides_and_holds_what_stands(subject: Subject) -> None:
    """Coulomb's law: cloth that slides down a slope at v stops within v^2 / (2 (mu g_n - g_t)), and then does not
    creep. It fails unless steps commit the friction anchor of each vertex.
    """
    system, speed = tray(FEW), 0.2
    free, distance = ~system.fabric.pinned, speed**2 / (2.0 * (FRICTION * WEIGHT - SLOPE))
    state = ride(subject, system, np.where(free[:, None], [speed, 0.0, 0.0], 0.0), np.zeros(3), 100, 4)
    shift = (state.x - system.fabric.position)[free]
    assert shift[:, 0].min() > 0.0 and shift[:, 0].max() < 1.1 * distance  # rk4_printed stops after half of it
    assert np.abs(shift[:, 1:]).max() < 2.0 * DEPTH
    assert np.abs(state.v[free]).max() < 0.05 * speed


def any_number_of_threads_gives_the_same_bits(subject: Subject) -> None:
    """One and two threads, and a repeated run, give the same bits for cloth large enough for two on a moving body."""
    one, two = tray(MANY), tray(MANY, threads=2)
    memory = subject.plugin.prepare(subject.config, two, State(two.fabric.position, two.fabric.velocity))
    if not memory.about.startswith("2 threads"):
        pytest.skip("one thread is all there is")
    v, along = random_velocities(one), np.array([0.7, -0.4, 1.1])
    first, second = (made_twice(partial(ride, subject, s, v, along, 10, 1), s.fabric) for s in (one, two))
    assert (first.x.tobytes(), first.v.tobytes()) == (second.x.tobytes(), second.v.tobytes())


RIDES = (
    all_is_the_same_on_a_body_that_moves_evenly,
    friction_slows_what_slides_and_holds_what_stands,
    any_number_of_threads_gives_the_same_bits,
)
