"""What every installed integrator promises, third-party ones too: found by entry point."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from nuno_schemas.fabric import Fabric, Float, Springs, State
from nuno_schemas.system import System

PLUGINS = [point.load()() for point in sorted(entry_points(group="nuno.integrators"), key=lambda p: p.name)]
OMEGA, DAMPING = 3.0, 0.6


def name(plugin: Any) -> str:
    return str(plugin.name)


def oscillator() -> System:
    """Two free particles on springs of rest length 0 to a pinned one: x'' = -omega^2 x - damping x'."""
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.2, -0.3], [-0.5, 0.4, 0.9]])
    pairs = np.array([[0, 1], [0, 2]], np.int32)
    springs = Springs.from_pairs(pairs, np.full(2, 2.0 * OMEGA**2), np.zeros(2), np.zeros(2))
    pinned = np.array([True, False, False])
    faces = np.zeros((0, 3), np.int32)
    velocity = np.array([[0.0, 0.0, 0.0], [0.1, -1.0, 0.5], [0.7, 0.0, -0.2]])
    fabric = Fabric("oscillator", x, velocity, np.full(3, 2.0), pinned, faces, springs)
    return System(fabric, np.zeros(3), DAMPING)


def solution(system: System, t: float) -> tuple[Float, Float]:
    """x(t) and v(t) of the damped oscillator in closed form."""
    x, v = system.fabric.position, system.fabric.velocity
    half, rate = 0.5 * DAMPING, np.sqrt(OMEGA**2 - 0.25 * DAMPING**2)
    amplitude = (v + half * x) / rate
    c, s, decay = np.cos(rate * t), np.sin(rate * t), np.exp(-half * t)
    now = decay * (x * c + amplitude * s)
    return now, -half * now + decay * rate * (amplitude * c - x * s)


def config(plugin: Any) -> Any:
    """A configuration under which every step has the given length and is solved to rounding."""
    exact = {"tolerance": 1.0, "residual": 1e-12}
    return plugin.Config(**{name: value for name, value in exact.items() if name in plugin.Config.model_fields})


def run(plugin: Any, system: System, steps: int, dt: float) -> State:
    state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
    memory = plugin.prepare(config(plugin), system, state)
    report = plugin.advance(system, state, memory, None, steps, dt)
    assert report.status == "ok"
    return state


@pytest.mark.parametrize("plugin", PLUGINS, ids=name)
def test_one_step_is_the_stated_matrix(plugin: Any) -> None:
    system, dt = oscillator(), 0.13
    state = run(plugin, system, 1, dt)
    expected = np.tensordot(
        plugin.amplification(OMEGA, DAMPING, dt), np.stack([system.fabric.position, system.fabric.velocity]), 1
    )
    assert np.abs(state.x - expected[0]).max() < 1e-14
    assert np.abs(state.v - expected[1]).max() < 1e-13


@pytest.mark.parametrize("plugin", PLUGINS, ids=name)
def test_error_falls_with_the_stated_order(plugin: Any) -> None:
    system, duration = oscillator(), 1.0
    counts = np.array([8, 11, 16, 22] if plugin.order > 5 else [40, 80, 160, 320]) * (40 if plugin.order == 1 else 1)
    exact, _ = solution(system, duration)
    errors = [np.abs(run(plugin, system, int(n), duration / n).x - exact).max() for n in counts]
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert abs(order - plugin.order) < (0.1 if plugin.order < 5 else 0.3)


@pytest.mark.parametrize("plugin", PLUGINS, ids=name)
def test_equal_runs_give_equal_bytes_and_leave_the_fabric_alone(plugin: Any) -> None:
    system = oscillator()
    fabric = system.fabric
    before = [array.tobytes() for array in (fabric.position, fabric.velocity, fabric.mass, fabric.pinned)]
    first, second = (run(plugin, system, 100, 0.01) for _ in range(2))
    assert first.x.tobytes() == second.x.tobytes()
    assert first.v.tobytes() == second.v.tobytes()
    after = [array.tobytes() for array in (fabric.position, fabric.velocity, fabric.mass, fabric.pinned)]
    assert before == after
    assert first.x[0].tobytes() == fabric.position[0].tobytes()


@pytest.mark.parametrize("plugin", PLUGINS, ids=name)
def test_a_net_of_one_vertex_that_nothing_acts_on_stays_where_it_is(plugin: Any) -> None:
    """Off the origin. By vertices or by axes, one vertex is the same in memory: no layout of it may be a view."""
    place, one = np.array([[1.0, 2.0, 3.0]]), np.ones(1)
    fabric = Fabric("one", place.copy(), np.zeros((1, 3)), one, one == 0.0, np.zeros((0, 3), np.int32), None)
    system, state = System(fabric, np.zeros(3)), State(place.copy(), np.zeros((1, 3)))
    plugin.limit(config(plugin), system, state)
    memory = plugin.prepare(config(plugin), system, state)
    plugin.limit(config(plugin), system, state)
    assert plugin.advance(system, state, memory, None, 2, 0.1).status == "ok"
    assert state.x.tolist() == place.tolist()
    assert fabric.position.tolist() == place.tolist()


@pytest.mark.parametrize("plugin", PLUGINS, ids=name)
def test_frames_cut_anywhere_end_in_the_same_bytes(plugin: Any) -> None:
    system = oscillator()
    whole = run(plugin, system, 12, 0.01)
    state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
    for steps in (5, 0, 7):
        memory = plugin.prepare(config(plugin), system, state)
        plugin.advance(system, state, memory, None, steps, 0.01)
    assert state.x.tobytes() == whole.x.tobytes()
    assert state.v.tobytes() == whole.v.tobytes()


@pytest.mark.parametrize("plugin", PLUGINS, ids=name)
def test_unknown_configuration_is_refused_by_name(plugin: Any) -> None:
    with pytest.raises(ValidationError, match="tolerence"):
        plugin.Config.model_validate({"tolerence": 1})
