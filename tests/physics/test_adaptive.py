"""Adaptive methods: the error follows the tolerance, and a resume goes on inside of a step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from nuno_integrators.explicit.adaptive import AT, BEFORE, NEXT, PENDING, Dop853, Dopri5, take
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Springs, State
from nuno_schemas.system import System, Term

FRAME = 0.1
BOTH = pytest.mark.parametrize("plugin", [Dopri5(), Dop853()], ids=lambda p: p.name)


def with_both(test: Callable[..., None]) -> Callable[..., None]:
    """Both pairs go through one loop, which is compiled for each."""
    return pytest.mark.quick(plugin=["dop853"])(BOTH(test))


def pendulums(damping=0.0, far=0.0) -> System:
    """Three masses on stiff springs, swinging from a pinned vertex: no closed form, several frequencies."""
    x = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.9, 0.3, 0.1], [2.4, -0.4, 0.5]]) + far
    pairs = np.array([[0, 1], [1, 2], [2, 3]], np.int32)
    springs = Springs.from_pairs(pairs, np.array([400.0, 900.0, 100.0]), np.full(3, 0.9), np.full(3, 0.2))
    pinned = np.array([True, False, False, False])
    fabric = Fabric(
        "chain", x, np.zeros((4, 3)), np.array([1.0, 1.0, 0.5, 2.0]), pinned, np.zeros((0, 3), np.int32), springs
    )
    return System(fabric, np.array([0.0, -9.81, 0.0]), damping)


def start(plugin, system, tolerance):
    state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
    return state, plugin.prepare(plugin.Config(tolerance=tolerance), system, state)


def frames(plugin, system, state, memory, count):
    path, totals = [], {"steps": 0, "rejected_steps": 0}
    for _ in range(count):
        report = plugin.advance(system, state, memory, None, 1, FRAME)
        assert report.status == "ok"
        totals = {name: totals[name] + report.totals[name] for name in totals}
        path.append(state.x.copy())
    return np.array(path), totals


@with_both
def test_error_at_frames_follows_the_tolerance(plugin):
    system = pendulums(0.3)
    exact, _ = frames(Dop853(), system, *start(Dop853(), system, 1e-13), 20)
    tolerances = np.array([1e-5, 1e-6, 1e-7, 1e-8, 1e-9])
    errors = []
    for tolerance in tolerances:
        path, totals = frames(plugin, system, *start(plugin, system, tolerance), 20)
        errors.append(np.abs(path - exact).max())
        assert totals["steps"] > 40, "frames would all end a step, and no output inside of one be seen"
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert 0.85 < slope < 1.15
    assert np.all(np.array(errors) < 300 * tolerances)


@with_both
def test_frames_do_not_shorten_steps(plugin):
    system = pendulums()
    whole = start(plugin, system, 1e-8)
    report = plugin.advance(system, *whole, None, 1, 2.0)
    _, totals = frames(plugin, system, *start(plugin, system, 1e-8), 20)
    assert totals["steps"] <= report.steps + 1


@with_both
@pytest.mark.parametrize("at", [1, 7, 12])
def test_a_resume_inside_of_a_step_ends_in_the_same_bytes(plugin, at):
    system = pendulums(0.1)
    state, memory = start(plugin, system, 1e-7)
    frames(plugin, system, state, memory, at)
    kept = State(state.x.copy(), state.v.copy(), state.t), {k: a.copy() for k, a in memory.arrays.items()}
    frames(plugin, system, state, memory, 6)
    again, fresh = kept[0], plugin.prepare(plugin.Config(tolerance=1e-7), system, kept[0])
    for name, array in kept[1].items():
        np.copyto(fresh.arrays[name], array)
    assert fresh.arrays["control"][1] > 0.0, "no step was pending"
    frames(plugin, system, again, fresh, 6)
    assert again.x.tobytes() == state.x.tobytes()
    assert again.v.tobytes() == state.v.tobytes()


@with_both
def test_a_step_pending_under_other_forces_is_dropped(plugin):
    system = pendulums()
    state, memory = start(plugin, system, 1e-9)
    frames(plugin, system, state, memory, 3)
    lighter = replace(system, gravity=np.array([0.0, -1.6, 0.0]))
    kept, again = memory.arrays, state.copy()
    fresh = plugin.prepare(plugin.Config(tolerance=1e-9), lighter, state)
    for name, array in kept.items():
        np.copyto(fresh.arrays[name], array)
    clean = plugin.prepare(plugin.Config(tolerance=1e-9), lighter, again)
    frames(plugin, lighter, state, fresh, 3)
    frames(plugin, lighter, again, clean, 3)
    assert np.abs(state.x - again.x).max() < 1e-7


@with_both
def test_a_force_in_python_is_met_at_its_own_times(plugin):
    """x'' = cos(3 t): steps end with the frames, and the closed form comes out."""

    def push(x, v, t, out):
        out[:, 0] += np.cos(3.0 * t)

    fabric = Fabric(
        "mass", np.zeros((1, 3)), np.zeros((1, 3)), np.ones(1), np.zeros(1, bool), np.zeros((0, 3), np.int32)
    )
    system = System(fabric, np.zeros(3), 0.0, (Term("python", push),))
    state, memory = start(plugin, system, 1e-10)
    frames(plugin, system, state, memory, 13)
    assert abs(state.x[0, 0] - (1.0 - np.cos(3.0 * 1.3)) / 9.0) < 1e-8


@with_both
def test_a_tolerance_below_rounding_is_refused(plugin):
    with pytest.raises(BadInput, match="rounded more"):
        start(plugin, pendulums(far=1e6), 1e-10)


@with_both
def test_steps_without_end_are_given_up_by_name(plugin):
    def wall(x, v, t, out):
        out[:, 0] += np.where(x[:, 0] > 0.0, np.nan, 1.0)

    fabric = Fabric(
        "mass", -np.ones((1, 3)), np.zeros((1, 3)), np.ones(1), np.zeros(1, bool), np.zeros((0, 3), np.int32)
    )
    system = System(fabric, np.zeros(3), 0.0, (Term("python", wall),))
    state, memory = start(plugin, system, 1e-6)
    report = plugin.advance(system, state, memory, None, 1, 10.0)
    assert report.status == "unconverged"
    assert "no step above" in report.message
    assert np.isfinite(state.x).all()
    assert state.x[0, 0] < 1e-6


def test_a_step_after_one_that_was_refused_is_no_longer_than_it() -> None:
    """Hairer, Norsett & Wanner 1993, section II.4: else it would be refused again; without a refusal it grows."""
    control = np.zeros(4)
    lengths = {}
    for again in (False, True):
        control[AT], control[PENDING], control[NEXT], control[BEFORE] = 0.0, 0.0, 1e-3, 0.5
        take(control, 1e-3, 1e-3, 0.17, again)
        lengths[again] = control[NEXT]
        assert control[PENDING] == 1e-3
    assert lengths[True] == 1e-3 < lengths[False]
