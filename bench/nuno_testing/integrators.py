"""The contract of integrators, tested on an oscillator against its closed form."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno.runtime.stepper import check_kept
from nuno_schemas.fabric import Fabric, Float, Springs, State
from nuno_schemas.system import System
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
    position: Float = np.exp(-half * t) * (x * np.cos(rate * t) + (v + half * x) / rate * np.sin(rate * t))
    return position


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


def one_step_is_the_stated_matrix(subject: Subject) -> None:
    """One step equals `amplification`, the matrix that gives the largest stable step."""
    system, dt = oscillator(), 0.13
    state = run(subject, system, dt, 1)
    start = np.stack([system.fabric.position, system.fabric.velocity])
    expected = np.tensordot(subject.plugin.amplification(OMEGA, DAMPING, dt), start, 1)
    assert np.abs(state.x - expected[0]).max() < 1e-14
    assert np.abs(state.v - expected[1]).max() < 1e-13


def the_error_falls_with_the_stated_order(subject: Subject) -> None:
    """The error against the closed form falls with the step by the integrator's `order`."""
    system, order = oscillator(), subject.plugin.order
    counts = np.array([8, 11, 16, 22] if order > 5 else [40, 80, 160, 320]) * (40 if order == 1 else 1)
    errors = [np.abs(run(subject, system, 1.0 / n, int(n)).x - solution(system, 1.0)).max() for n in counts]
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - order) < (0.1 if order < 5 else 0.3)


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
    one_step_is_the_stated_matrix,
    the_error_falls_with_the_stated_order,
    equal_runs_give_equal_bytes,
    frames_cut_anywhere_end_in_the_same_bytes,
    a_vertex_that_nothing_acts_on_stays_where_it_is,
)
