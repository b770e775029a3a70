"""Yarns: tension that passes along them, its energy and symmetries, and every integrator with it."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nets import accelerations, make_fabric, make_system, random_net, run, start
from yarn_nets import balance, chains, line, reference

from nuno_integrators.explicit.adaptive import Dop853, Dopri5
from nuno_integrators.explicit.fixed_step import RK4, Leapfrog, SymplecticEuler
from nuno_integrators.implicit.plugin import TRBDF2, ImplicitEuler
from nuno_integrators.packing import pack, to_rows
from nuno_integrators.stability import measure_rates
from nuno_integrators.xpbd import XPBD
from nuno_kernels.forces.energy import measure_energy
from nuno_kernels.forces.yarns import YarnLists, pack_yarns
from nuno_kernels.step.blocks import BLOCK
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Springs, Yarns
from nuno_schemas.system import System


@pytest.mark.parametrize("c", [0.0, 0.4])
@pytest.mark.parametrize("points", [60, BLOCK + 300])
def test_forces_follow_the_formula(points: int, c: float) -> None:
    fabric = chains(points, 40, 1, c=c)
    v = np.random.default_rng(2).standard_normal((points, 3))
    expected = reference(fabric, fabric.position, v)
    system = make_system(fabric)
    assert pack(system).velocity_matters == (c > 0.0)
    found = accelerations(system, fabric.position, v)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("seed", range(4))
def test_forces_keep_momentum_and_angular_momentum(seed: int) -> None:
    fabric = chains(80, 40, seed, c=0.3)
    v = np.random.default_rng(seed).standard_normal((80, 3))
    force = accelerations(make_system(fabric), fabric.position, v)
    scale = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-14 * scale
    assert np.abs(np.cross(fabric.position, force).sum(axis=0)).max() < 1e-14 * scale


def test_force_is_minus_the_gradient_of_energy_for_one_stiffness() -> None:
    fabric = chains(30, 9, 3, uniform=True)
    packed, x0 = pack(make_system(fabric)), fabric.position
    force = accelerations(make_system(fabric), x0, 0 * x0)

    def energy(x: Float) -> float:
        return measure_energy(to_rows(x), to_rows(0 * x), fabric.mass, packed).total

    h = 1e-5
    for vertex in range(30):
        for axis in range(3):
            ahead, behind = x0.copy(), x0.copy()
            ahead[vertex, axis] += h
            behind[vertex, axis] -= h
            assert abs(force[vertex, axis] + (energy(ahead) - energy(behind)) / (2 * h)) < 1e-7 * np.abs(force).max()


def test_energy_is_positive_just_below_one_half() -> None:
    """The least of k e.(1 + mu A) e over alternating elongations turns negative past 1/2 as yarns grow long."""
    points = 400
    x = np.zeros((points, 3))
    x[:, 0] = np.cumsum(np.where(np.arange(points) % 2, 1.1, 0.9))
    one, index = np.ones(points - 1), np.arange(points - 1)
    springs = Springs.from_pairs(np.stack([index, index + 1], 1).astype(np.int32), one, one, 0 * one)
    values = []
    for mu in (0.499, 0.52):
        yarns = Yarns(index.astype(np.int32), np.array([0, points - 1], np.int32), np.array([mu]), np.zeros(1, np.int8))
        fabric = replace(make_fabric(x, springs, mass=1.0), yarns=yarns)
        rows = to_rows(x)
        values.append(measure_energy(rows, 0 * rows, fabric.mass, pack(make_system(fabric))).total)
    assert values[0] > 0.0 > values[1]


def test_without_sharing_the_bits_are_those_without_yarns() -> None:
    fabric = chains(50, 20, 4, c=0.2)
    assert fabric.yarns is not None
    states = []
    for yarns in (None, replace(fabric.yarns, mu=np.zeros(20))):
        system = make_system(replace(fabric, yarns=yarns), damping=0.3)
        assert not any(isinstance(term, YarnLists) for term in pack(system).forces)
        state = start(system)
        run(SymplecticEuler(), system, state, 30, 1e-3)
        states.append(state)
    assert states[0].x.tobytes() == states[1].x.tobytes()
    assert states[0].v.tobytes() == states[1].v.tobytes()


def test_links_of_no_length_neither_give_nor_take() -> None:
    x = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [3, 0, 0]])
    pairs, one = np.array([[0, 1], [1, 2], [2, 3]], np.int32), np.ones(3)
    yarns = Yarns(np.arange(3, dtype=np.int32), np.array([0, 3], np.int32), np.array([0.2]), np.zeros(1, np.int8))
    fabric = replace(make_fabric(x, Springs.from_pairs(pairs, one, 0.5 * one, one), mass=1.0), yarns=yarns)
    a = accelerations(make_system(fabric), x, 0 * x)
    assert np.array_equal(a[:, 0], [0.5, -0.5, 1.5, -1.5])


@pytest.mark.quick(plugin=["symplectic_euler"])
@pytest.mark.parametrize("plugin", [SymplecticEuler(), Leapfrog(), RK4(), Dopri5()], ids=lambda p: p.name)
def test_a_stretched_yarn_comes_to_the_closed_forms_rest(plugin: Any) -> None:
    system = line()
    state = start(system)
    run(plugin, system, state, 800, 0.01)
    assert np.abs(state.x[:, 0] - balance(system)).max() < 1e-9


def disturbed(c: float = 0.5) -> System:
    system = line(c=c)
    velocity = np.random.default_rng(7).standard_normal(system.fabric.position.shape)
    velocity[system.fabric.pinned] = 0.0
    return replace(system, fabric=replace(system.fabric, velocity=velocity), damping=0.4)


@pytest.mark.full
@pytest.mark.parametrize(
    "plugin", [SymplecticEuler(), Leapfrog(), RK4(), ImplicitEuler(), TRBDF2()], ids=lambda p: p.name
)
def test_order_of_convergence(plugin: Any) -> None:
    system, span = disturbed(), 1.0 if plugin.order > 1 else 0.2
    exact = start(system)
    best = Dop853()
    memory = best.prepare(best.Config(tolerance=1e-13), system, exact)
    best.advance(system, exact, memory, None, 1, span)
    counts = np.array([40, 80, 160, 320])
    errors = []
    for steps in counts.tolist():
        state = start(system)
        fields = {"residual": 1e-12, "most_iterations": 100} if not plugin.explicit else {}
        memory = plugin.prepare(plugin.Config(**fields), system, state)
        assert plugin.advance(system, state, memory, None, steps, span / steps).status == "ok"
        errors.append(np.abs(state.x - exact.x).max())
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert abs(order - plugin.order) < 0.1


def test_limit_counts_what_passes_along_the_yarn() -> None:
    """Of a long straight yarn omega^2 -> (1 + 2 mu cos q) 2 k / m (1 - cos q) at its largest, q along the yarn."""
    points, k, mass, mu = 80, 30.0, 0.1, 0.45
    x = np.zeros((points, 3))
    x[:, 0] = np.arange(points)
    index, one = np.arange(points - 1, dtype=np.int32), np.ones(points - 1)
    springs = Springs.from_pairs(np.stack([index, index + 1], 1), k * one, one, 0 * one)
    yarns = Yarns(index, np.array([0, points - 1], np.int32), np.array([mu]), np.zeros(1, np.int8))
    system = make_system(replace(make_fabric(x, springs, mass=mass), yarns=yarns))
    q = np.linspace(0.0, np.pi, 10001)
    expected = float(np.sqrt((2.0 * k / mass * (1.0 - np.cos(q)) * (1.0 + 2.0 * mu * np.cos(q))).max()))
    omega, _ = measure_rates(system, start(system))
    assert 0.995 * expected < omega < 1.03 * expected
    assert omega < 0.9 * measure_rates(make_system(make_fabric(x, springs, mass=mass)), start(system))[0]


def test_xpbd_refuses_yarns_by_name() -> None:
    system = line()
    with pytest.raises(BadInput, match="xpbd") as caught:
        XPBD().prepare(XPBD.Config(), system, start(system))
    assert caught.value.field == "solver.plugin"


def test_random_nets_without_yarns_have_no_part_of_them() -> None:
    position, springs = random_net(30, 60, 1)
    packed = pack(make_system(make_fabric(position, springs)))
    assert not any(isinstance(term, YarnLists) for term in packed.forces)


def test_packing_takes_little_more_than_what_it_makes() -> None:
    """Constants and temporaries of pairs would otherwise be most of a knit's memory: 740 bytes a point at the peak."""
    points = 20_000
    index = np.arange(points - 1, dtype=np.int32)
    one, x = np.ones(points - 1), np.zeros((points, 3))
    x[:, 0] = np.arange(points)
    springs = Springs.from_pairs(np.stack([index, index + 1], 1), one, one, 0 * one)
    yarns = Yarns(index, np.array([0, points - 1], np.int32), np.array([0.2]), np.zeros(1, np.int8))
    tracemalloc.start()
    packed = pack_yarns(yarns, springs, points)
    held, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert packed is not None
    # One pair a point here, two in a knit: six indices of 4 bytes and six constants of 8.
    assert 72 * points <= held < 75 * points
    assert peak < 2.3 * held
