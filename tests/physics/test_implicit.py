"""Implicit methods: the residual they promise, and steps that no explicit method can take."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from contact_world import G, contact_for, geometry, move, plane
from implicit_nets import DOWN, PLUGINS, sheet
from nets import make_fabric, make_system, start

import nuno_integrators.packing
from nuno_integrators.explicit.adaptive import Dop853
from nuno_integrators.implicit import newton
from nuno_integrators.implicit.plugin import ImplicitEuler
from nuno_integrators.packing import pack, to_rows
from nuno_kernels.step.acceleration import evaluate
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Springs
from nuno_schemas.system import Term


@pytest.mark.quick(plugin=["tr_bdf2"])
@PLUGINS
def test_converges_to_the_solution_of_another_method(plugin):
    """A sheet that swings and folds, with damping: the error falls at the stated order."""
    system = make_system(sheet(5, k=60.0, ratio=0.1), DOWN, 0.5)
    exact = start(system)
    memory = Dop853().prepare(Dop853.Config(tolerance=1e-11), system, exact)
    assert Dop853().advance(system, exact, memory, None, 1, 0.25).status == "ok"
    errors, counts = [], np.array([1600, 3200, 6400] if plugin.order == 1 else [100, 200, 400, 800])
    for count in counts:
        state = start(system)
        memory = plugin.prepare(plugin.Config(residual=1e-9), system, state)
        assert plugin.advance(system, state, memory, None, int(count), 0.25 / count).status == "ok"
        errors.append(np.abs(state.x - exact.x).max())
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert abs(order - plugin.order) < 0.1


@PLUGINS
@pytest.mark.parametrize("k", [1e2, 1e4, 1e6, 1e8])
def test_no_stiffness_is_too_much_for_a_frame_as_a_step(plugin, k):
    """The limit of an explicit step at k = 1e8 is 20,000 times smaller. Implicit Euler never gains energy."""
    system = make_system(sheet(12, k=k), DOWN)
    state = start(system)
    memory = plugin.prepare(plugin.Config(), system, state)
    energy = []
    for _ in range(30):
        report = plugin.advance(system, state, memory, None, 1, 1.0 / 60.0)
        assert report.status == "ok"
        assert report.steps >= 1
        energy.append(sum(report.energy.values()))
    gained = np.diff(energy).max() / (system.fabric.mass.sum() * G)
    assert gained < (1e-6 if plugin.order == 1 else 1e-2)
    assert state.x[:, 1].min() < -0.3, "it fell"
    assert report.stretch < max(0.02, 40.0 / k)


def test_the_residual_is_what_was_promised():
    """Recomputed here from Newton's second law: m (v' - v) / h - f(x', v')."""
    system, h = make_system(sheet(8), DOWN, 0.3), 0.01
    state, plugin = start(system), ImplicitEuler()
    memory = plugin.prepare(plugin.Config(residual=1e-6), system, state)
    for _ in range(10):
        v = state.v.copy()
        assert plugin.advance(system, state, memory, None, 1, h).status == "ok"
        a = np.empty((3, 64))
        evaluate(to_rows(state.x), to_rows(state.v), 0.0, a, pack(system), None)
        free = ~system.fabric.pinned
        missing = system.fabric.mass[:, None] * (a.T - (state.v - v) / h)
        springs = system.fabric.springs
        d = state.x[springs.pairs()[:, 0]] - state.x[springs.pairs()[:, 1]]
        largest = np.abs(springs.k * (np.linalg.norm(d, axis=1) - springs.rest)).max()
        assert np.linalg.norm(missing[free], axis=1).max() < 1.01e-6 * largest


def on_plane(alpha, mu, k=1e5, mass=1e-2):
    """A vertex on an incline that falls along +x, at its rest depth."""
    contact = contact_for(geometry(plane(), friction=mu), np.array([mass]), k)
    move(contact, 1.0)
    gravity = G * np.array([np.sin(alpha), -np.cos(alpha), 0.0])
    fabric = make_fabric(np.array([[0.0, -mass * G * np.cos(alpha) / k, 0.0]]), mass=mass)
    return make_system(fabric, gravity, terms=(Term("contact", (contact,)),))


STILL = Poses(0.0, np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3)))
POSES = STILL, replace(STILL, t=1.0)


@PLUGINS
@pytest.mark.full
@pytest.mark.parametrize("share", [0.9, 1.2])
def test_an_incline_holds_or_lets_go_as_coulomb_says(plugin, share):
    mu = 0.4
    alpha = np.arctan(share * mu)
    system = on_plane(alpha, mu)
    state = start(system)
    memory = plugin.prepare(plugin.Config(residual=1e-8), system, state)
    places = []
    for _ in range(2):
        assert plugin.advance(system, state, memory, POSES, 200, 1.0 / 400).status == "ok"
        places.append(state.x[0, 0])
    if share < 1.0:
        assert places[0] < 1e-4, "it gives way once, because it is let go at once"
        assert abs(places[1] - places[0]) < 1e-12
    else:
        # Implicit Euler falls h v / 2 further: its velocity is the one at the step's end.
        expected = 0.5 * G * (np.sin(alpha) - mu * np.cos(alpha))
        assert state.x[0, 0] == pytest.approx(expected, rel=0.01)
        assert state.v[0, 0] == pytest.approx(2.0 * expected, rel=0.005)
    assert state.x[0, 1] == pytest.approx(-1e-2 * G * np.cos(alpha) / 1e5, rel=1e-4)


@PLUGINS
@pytest.mark.full
def test_any_number_of_threads_gives_equal_bytes(plugin, monkeypatch):
    monkeypatch.setattr(nuno_integrators.packing, "PARALLEL_FROM", 0)
    ends = []
    for threads in (1, 2):
        system = make_system(sheet(50, bend=1e-5), DOWN, 0.1, threads=threads)
        state = start(system)
        memory = plugin.prepare(plugin.Config(), system, state)
        assert (memory.work.packed.threads is None) == (threads == 1)
        assert plugin.advance(system, state, memory, None, 3, 0.01).status == "ok"
        ends.append(state.x.tobytes() + state.v.tobytes())
    assert ends[0] == ends[1]


@PLUGINS
def test_a_force_in_python_is_part_of_the_solve(plugin):
    """A drag of 1e4 1/s over steps of 10 ms: the speed is the closed form's limit, gravity over drag."""

    def drag(x, v, t, out):
        out -= 1e4 * 1e-3 * v

    system = make_system(make_fabric(np.zeros((1, 3))), DOWN, terms=(Term("python", drag),))
    state = start(system)
    memory = plugin.prepare(plugin.Config(residual=1e-9), system, state)
    assert plugin.advance(system, state, memory, None, 20, 0.01).status == "ok"
    assert state.v[0, 1] == pytest.approx(-G / 1e4, rel=1e-6)


@PLUGINS
def test_what_does_not_converge_is_said_with_its_residual(plugin):
    """A force that points away from where it would have to be has no solution at any step."""

    def jump(x, v, t, out):
        out[:, 0] += np.where(v[:, 0] > 0.0, -1e9, 1e9)

    system = make_system(make_fabric(np.zeros((1, 3))), terms=(Term("python", jump),))
    state = start(system)
    memory = plugin.prepare(plugin.Config(most_iterations=5), system, state)
    report = plugin.advance(system, state, memory, None, 1, 0.01)
    assert report.status == "unconverged"
    assert "residual of" in report.message
    assert np.isfinite(state.x).all()


def line(n, k, ends):
    """n vertices of 1 g along x, 0.1 m apart at rest, squeezed to two thirds; the first, or both ends, are pinned."""
    x = np.zeros((n, 3))
    x[:, 0] = np.arange(n) * 0.1 * 2.0 / 3.0
    at, one = np.arange(n, dtype=np.int32), np.ones(n - 1)
    springs = Springs.from_pairs(np.stack([at[:-1], at[1:]], 1), k * one, 0.1 * one, 0.0 * one)
    return make_fabric(x, springs, mass=1e-3, pinned=(at == 0) | (ends & (at == n - 1)))


def squeezed_sheet(k):
    """Squeezed to two thirds along x, undamped, springs in any order."""
    fabric = sheet(6, k=k, ratio=0.0, shuffle=True)
    return replace(fabric, position=fabric.position * [2.0 / 3.0, 1.0, 1.0])


SQUEEZED = {
    "5, one end": line(5, 4e6, False),
    "5, both ends": line(5, 4e6, True),
    "31, one end": line(31, 4e6, False),
    "31, both ends": line(31, 4e6, True),
    "sheet": squeezed_sheet(4e6),
}


@pytest.mark.quick(residual=[1e-9])
@PLUGINS
@pytest.mark.parametrize("net", SQUEEZED)
@pytest.mark.parametrize("residual", [1e-6, 1e-9])
def test_stiff_springs_pressed_together_straight_give_way(plugin, net, residual):
    """An unstable balance, which weight alone disturbs: a spring pushes with 133 kN, a vertex weighs 10 mN.

    What was stored is gone in ten frames as steps: what swings that fast is damped, and no implicit step gains energy.
    """
    system = make_system(SQUEEZED[net], DOWN)
    state = start(system)
    memory = plugin.prepare(plugin.Config(residual=residual), system, state)
    stored = plugin.advance(system, state, memory, None, 0, 1.0).energy["springs"]
    for _ in range(10):
        report = plugin.advance(system, state, memory, None, 1, 1.0 / 60.0)
        assert report.status == "ok", report.message
    pairs, rest = system.fabric.springs.pairs(), system.fabric.springs.rest
    strain = np.linalg.norm(state.x[pairs[:, 1]] - state.x[pairs[:, 0]], axis=1) / rest - 1.0
    if "both ends" in net and residual > 1e-7:
        assert strain.max() < -0.3, "the weight is less than may be missing: balanced it stays"
    else:
        assert sum(report.energy.values()) < 2e-3 * stored
        assert np.abs(strain).max() < 1e-3


@PLUGINS
def test_a_force_that_is_no_number_does_not_converge(plugin):
    def spoil(x, v, t, out):
        out += np.nan if t > 0.015 else 0.0

    system = make_system(make_fabric(np.zeros((2, 3))), DOWN, terms=(Term("python", spoil),))
    state = start(system)
    memory = plugin.prepare(plugin.Config(), system, state)
    reports = [plugin.advance(system, state, memory, None, 1, 0.01) for _ in range(2)]
    assert [report.status for report in reports] == ["ok", "unconverged"]
    assert "residual of nan N" in reports[1].message


def test_a_search_along_which_nothing_changes_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """A way too short to change the residual, which points uphill by rounding, has no secant: it is gone less far."""
    d, uphill = np.full((3, 2), 1e-30), np.full((3, 2), -1.0)
    linear = SimpleNamespace(linear=SimpleNamespace(x=d), direct=False)
    stage: Any = SimpleNamespace(solver=linear, residual=uphill, x=np.ones((3, 2)), v=np.zeros((3, 2)))
    monkeypatch.setattr(newton, "_evaluate", lambda *_: 1.0)
    assert newton._search(stage, cast(Any, None), cast(Any, None), stage.v, 1.0, 0.0) == 1.0
    assert (stage.x == 1.0).all() and 0.0 < stage.v.max() < 1e-30
