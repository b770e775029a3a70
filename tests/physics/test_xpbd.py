"""XPBD: backward Euler's step in the limit of many sweeps, its order and its softness with one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_world import G
from nets import make_system, start
from xpbd_nets import DOWN, advance, chain, sheet

from nuno_integrators.explicit.adaptive import Dop853
from nuno_integrators.implicit.plugin import ImplicitEuler
from nuno_integrators.xpbd import XPBD
from nuno_schemas.system import Term


@pytest.mark.full
@pytest.mark.parametrize("shuffle", [False, True])
def test_many_sweeps_solve_the_step_of_backward_euler(shuffle, monkeypatch):
    """Springs of all kinds in runs and lists, their damping, hinges, viscous damping."""
    monkeypatch.setattr("nuno_kernels.step.blocks.SMALL", 0)
    system = make_system(sheet(12, shuffle=shuffle), DOWN, 0.7)
    ours = advance(system, 5, 5e-3, iterations=200)
    exact = advance(system, 5, 5e-3, plugin=ImplicitEuler(), residual=1e-12)
    assert np.abs(ours.x - exact.x).max() < 1e-10
    assert np.abs(ours.v - exact.v).max() < 1e-8


def test_more_sweeps_change_nothing_once_they_reach():
    system = make_system(sheet(8), DOWN, 0.7)
    ends = [advance(system, 5, 5e-3, iterations=count).x for count in (1, 3, 100, 200)]
    apart = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert apart[0] > 3.0 * apart[1]
    assert apart[2] < 1e-11


@pytest.mark.parametrize("iterations", [1, 3])
def test_converges_at_first_order_with_its_sweeps_fixed(iterations):
    system = make_system(sheet(6), DOWN, 0.5)
    exact = advance(system, 1, 0.1, plugin=Dop853(), tolerance=1e-11)
    counts = np.array([200, 400, 800, 1600])
    errors = [np.abs(advance(system, n, 0.1 / n, iterations=iterations).x - exact.x).max() for n in counts.tolist()]
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - 1.0) < 0.1


@pytest.mark.parametrize("iterations", [1, 4])
def test_no_sweep_adds_momentum(iterations):
    """Nor angular momentum about where the vertices are when they are moved: only u x v of the step's path remains."""
    fabric = sheet(10, k=1e5)
    rng = np.random.default_rng(1)
    fabric = replace(
        fabric,
        position=fabric.position + 3e-3 * rng.standard_normal((100, 3)),
        velocity=rng.standard_normal((100, 3)),
        mass=rng.uniform(1e-3, 1e-2, 100),
        pinned=np.zeros(100, bool),
    )
    end = advance(make_system(fabric), 20, 1e-3, iterations=iterations)
    momentum = fabric.mass @ (end.v - fabric.velocity)
    assert np.abs(momentum).max() < 1e-12 * (fabric.mass @ np.abs(fabric.velocity)).max()
    assert np.abs(end.v - fabric.velocity).max() > 0.1


def test_a_tense_chain_is_softer_by_what_one_sweep_cannot_reach():
    """Under equal tension T the stretch is T / k, and z T / k more for each vertex between two springs, z = h^2 k / m'.

    Springs follow each other in an even and an odd round: at rest the first round has to bring T from a stretch
    s by k s / (1 + 2 z), the second from s + 2 z T / k, so that s k / T is 1 + 2 z and 1 in turns.
    """
    n, k, pull = 20, 100.0, 2.0
    for z in (0.01, 0.25, 4.0):
        mass = np.full(n + 1, 1e-2)
        fabric = replace(chain(n, k, 1e-2), mass=mass)

        def hold(x, v, t, out):
            out[-1, 1] -= pull

        system = make_system(fabric, damping=5.0, terms=(Term("python", hold),))
        h = np.sqrt(z * 1e-2 / k)
        state = advance(system, max(600, int(12.0 / h)), h)
        stretch = -state.x[-1, 1] / n - 0.1
        assert stretch * k / pull == pytest.approx(1.0 + z / (1.0 + 5.0 * h) * (n - 1) / n, rel=1e-5)


@pytest.mark.parametrize("residual", [0.1, 0.01])
@pytest.mark.parametrize("iterations", [1, 5])
def test_a_hanging_chain_stretches_as_far_as_the_stated_residual_lets_it(residual, iterations):
    n, k, mass = 10, 200.0, 0.01
    system = make_system(chain(n, k, mass), DOWN, 15.0)
    config = {"residual": residual, "iterations": iterations}
    dt = XPBD().limit(XPBD.Config(**config), system, start(system)).resolved
    state = advance(system, int(4.0 / dt), dt, **config)
    stretch = -state.x[-1, 1] - 0.1 * n
    exact = mass * G / k * n * (n + 1) / 2.0
    assert exact * (1.0 - 1e-3) < stretch < exact / (1.0 - residual)


def test_the_error_of_a_hanging_chain_falls_with_the_squared_step_and_with_sweeps():
    n, k, mass = 10, 200.0, 0.01
    system = make_system(chain(n, k, mass), DOWN, 15.0)
    exact = mass * G / k * n * (n + 1) / 2.0

    def error(dt, iterations):
        state = advance(system, int(4.0 / dt), dt, iterations=iterations)
        return (-state.x[-1, 1] - 0.1 * n) / exact - 1.0

    errors = [error(dt, 1) for dt in (4e-3, 2e-3, 1e-3)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)
    assert abs(error(4e-3, 60)) < 1e-6


@pytest.mark.parametrize("k", [1e2, 1e5, 1e8])
def test_no_stiffness_and_no_step_is_too_much(k):
    """Steps of a frame: it stretches, as much whatever the stiffness, but is never faster than what falls freely."""
    system = make_system(sheet(12, k=k), DOWN)
    state, plugin = start(system), XPBD()
    memory = plugin.prepare(plugin.Config(), system, state)
    assert plugin.limit(plugin.Config(), system, state).dt == np.inf
    for frame in range(1, 121):
        report = plugin.advance(system, state, memory, None, 1, 1.0 / 60.0)
        assert report.status == "ok"
        assert report.energy["kinetic"] < 0.5 * system.fabric.mass.sum() * (G * frame / 60.0) ** 2
    assert -0.7 < state.x[:, 1].min() < -0.2
