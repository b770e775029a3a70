"""Yarns: tension that passes along them, its energy and symmetries, the matrix of an implicit step, locks."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nets import accelerations, make_fabric, make_system, random_net, run, start
from yarn_nets import balance, chains, line, locking, reference

from nuno_integrators.explicit.adaptive import Dop853, Dopri5
from nuno_integrators.explicit.fixed_step import Leapfrog, SymplecticEuler
from nuno_integrators.explicit.runge_kutta import RK4
from nuno_integrators.implicit import linear_solve as solver
from nuno_integrators.implicit.conjugate import multiply
from nuno_integrators.implicit.factor import factorise, make_factor, solve_factored
from nuno_integrators.implicit.matrix import Linear, fill, make_linear
from nuno_integrators.implicit.plan import make_plan
from nuno_integrators.implicit.plugin import TRBDF2, ImplicitEuler
from nuno_integrators.packing import pack, to_rows
from nuno_integrators.stability import measure_rates
from nuno_integrators.xpbd import XPBD
from nuno_kernels.forces.energy import measure_energy
from nuno_kernels.forces.yarns import YarnLists, pack_yarns
from nuno_kernels.step.acceleration import evaluate
from nuno_kernels.step.blocks import BLOCK
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Springs, Yarns
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


def stretched(points: int, seed: int, by: float = 2.0, uniform: bool = True, c: float = 0.0) -> tuple[Fabric, Float]:
    """Yarns of one stiffness whose links are all in tension, and their positions (3, n)."""
    fabric = chains(points, 40, seed, c=c, uniform=uniform)
    if c > 0.0:
        assert fabric.springs is not None
        fabric = replace(fabric, springs=replace(fabric.springs, c=np.full(fabric.springs.number, c)))
    return fabric, by * to_rows(fabric.position)


def derivative(fabric: Fabric, x: Float, u: Float, rate: float) -> Float:
    """-(dF/dx + rate dF/dv) u (3, n) by central differences, at v = 0."""
    packed, ahead, behind = pack(make_system(fabric)), np.empty_like(x), np.empty_like(x)
    v, e = np.zeros_like(x), 1e-6
    evaluate(x + e * u, v + e * rate * u, 0.0, ahead, packed)
    evaluate(x - e * u, v - e * rate * u, 0.0, behind, packed)
    return np.asarray(-fabric.mass * (ahead - behind) / (2.0 * e))


def dense(linear: Linear, n: int) -> Float:
    """The matrix A, column by column."""
    units = np.eye(3 * n).reshape(3 * n, 3, n)
    return np.array([multiply(linear, unit, None).ravel() for unit in units]).T


@pytest.mark.parametrize("c", [0.0, 0.4])
@pytest.mark.parametrize("points", [60, BLOCK + 300])
def test_matrix_of_one_stiffness_in_tension_is_the_derivative_of_the_forces(points: int, c: float) -> None:
    fabric, x = stretched(points, 1, c=c)
    linear, rate = make_linear(pack(make_system(fabric))), 30.0
    fill(x, rate, pack(make_system(fabric)), linear)
    u = np.random.default_rng(2).standard_normal(x.shape)
    expected = derivative(fabric, x, u, rate)
    np.testing.assert_allclose(multiply(linear, u, None), expected, atol=1e-7 * np.abs(expected).max())


def test_exact_matrix_is_the_derivative_in_compression_too() -> None:
    fabric, x = stretched(60, 3, by=0.7)
    packed = pack(make_system(fabric))
    linear, u = make_linear(packed), np.random.default_rng(4).standard_normal(x.shape)
    fill(x, 1.0, packed, linear, exact=True)
    expected = derivative(fabric, x, u, 0.0)
    np.testing.assert_allclose(multiply(linear, u, None), expected, atol=1e-7 * np.abs(expected).max())
    fill(x, 1.0, packed, linear)
    assert np.abs(multiply(linear, u, None) - expected).max() > 0.05 * np.abs(expected).max()


@pytest.mark.parametrize("seed", range(4))
def test_matrix_is_symmetric_and_positive_for_any_stiffnesses(seed: int) -> None:
    """k over four decades along one yarn, mu just below one half, links in tension and compression."""
    fabric = chains(40, 20, seed)
    assert fabric.springs is not None and fabric.yarns is not None
    rng = np.random.default_rng(seed)
    springs = replace(fabric.springs, k=10.0 ** rng.uniform(-2.0, 2.0, fabric.springs.number))
    fabric = replace(fabric, springs=springs, yarns=replace(fabric.yarns, mu=np.full(20, 0.499)))
    packed = pack(make_system(fabric))
    linear = make_linear(packed)
    fill(to_rows(fabric.position) + 0.2 * rng.standard_normal((3, 40)), 1.0, packed, linear)
    a = dense(linear, 40)
    np.testing.assert_allclose(a, a.T, atol=1e-12 * np.abs(a).max())
    assert np.linalg.eigvalsh(a).min() > -1e-12 * np.abs(a).max()


def test_the_factor_gives_the_dense_solution() -> None:
    fabric, x = stretched(200, 5, c=0.3)
    fabric = replace(fabric, pinned=np.arange(200) % 9 == 0)
    packed, rng = pack(make_system(fabric)), np.random.default_rng(6)
    linear = make_linear(packed)
    linear.own[:3] = fabric.mass
    fill(x, 10.0, packed, linear)
    free = np.tile(~fabric.pinned, 3)
    factor = make_factor(make_plan(fabric.position, linear), 200)
    assert factorise(factor, linear)
    r, found = rng.standard_normal((3, 200)) * ~fabric.pinned, np.empty((3, 200))
    solve_factored(factor, r, found)
    expected = np.linalg.solve(dense(linear, 200)[np.ix_(free, free)], r.ravel()[free])
    np.testing.assert_allclose(found.ravel()[free], expected, atol=1e-11 * np.abs(expected).max())


def newton_steps(residual: float, mu: float, k: float = 40.0) -> int:
    """Newton steps of one step of 100 s of the line, bent to begin with, whose second link has stiffness k."""
    system = line(mu=mu)
    fabric, springs = system.fabric, system.fabric.springs
    assert springs is not None
    position = fabric.position.copy()
    position[1:-1, 1] += [0.3, -0.2, 0.1]
    springs = replace(springs, k=np.where(np.arange(4) == 1, k, springs.k))
    system = replace(system, fabric=replace(fabric, position=position, springs=springs))
    plugin, state = ImplicitEuler(), start(system)
    memory = plugin.prepare(plugin.Config(residual=residual, most_iterations=400), system, state)
    report = plugin.advance(system, state, memory, None, 1, 100.0)
    assert report.status == "ok" and report.totals["halvings"] == 0
    return int(report.totals["newton_steps"])


def test_newtons_end_is_quadratic(monkeypatch: pytest.MonkeyPatch) -> None:
    """From 1e-4 to 1e-11 it takes two steps with exact solutions; without the pairs' part up to 2 mu of the error
    would be left by each.
    """
    monkeypatch.setattr(solver, "PATIENCE", 0.0)
    assert newton_steps(1e-11, 0.45) - newton_steps(1e-4, 0.45) <= 2


def test_it_converges_as_derived_where_no_energy_exists(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a link 20 times as stiff as its neighbours mu (s - 1) / sqrt(s) of the error stay, s the ratio's root."""
    monkeypatch.setattr(solver, "PATIENCE", 0.0)
    more = newton_steps(1e-11, 0.2, 800.0) - newton_steps(1e-4, 0.2, 800.0)
    s = 20.0**0.5
    assert 3 <= more <= np.log(1e-7) / np.log(0.2 * (s - 1.0) / s**0.5)


@pytest.mark.quick(plugin=["implicit_euler"])
@pytest.mark.parametrize("plugin", [ImplicitEuler(), TRBDF2()], ids=lambda p: p.name)
@pytest.mark.parametrize("mu", [0.2, 0.45])
def test_large_implicit_steps_come_to_rest_too(plugin: Any, mu: float) -> None:
    system = line(mu=mu)
    state = start(system)
    memory = plugin.prepare(plugin.Config(residual=1e-11, most_iterations=20), system, state)
    report = plugin.advance(system, state, memory, None, 60, 0.5)
    assert report.status == "ok"
    assert np.abs(state.x[:, 0] - balance(system, mu)).max() < 1e-9


K, K_LOCK, LOCK, REST, MASS, G = 5.0, 80.0, 0.3, 0.4, 0.2, 10.0


def hanging(load: float = G, damping: float = 10.0) -> System:
    """A mass on one link that locks."""
    pairs, one = np.array([[0, 1]], np.int32), np.ones(1)
    springs = Springs.from_pairs(pairs, K * one, REST * one, 0.0 * one, lock=LOCK * one, k_lock=K_LOCK * one)
    x = np.array([[0.0, 0.0, 0.0], [0.0, -REST, 0.0]])
    fabric = make_fabric(x, springs, mass=MASS, pinned=np.array([True, False]))
    return make_system(fabric, gravity=np.array([0.0, -load, 0.0]), damping=damping)


@pytest.mark.parametrize("load", [1.0, 2.99, 3.01, 10.0], ids=["slack", "just below", "just above", "locked"])
def test_the_force_is_the_two_lines(load: float) -> None:
    """Where the weight is below K LOCK REST the link is slack: k e = m g; above, k lock L + k_lock (e - lock L)."""
    system = hanging(load)
    weight, knee = MASS * load, K * LOCK * REST
    e = weight / K if weight < knee else LOCK * REST + (weight - knee) / K_LOCK
    x = np.array([[0.0, 0.0, 0.0], [0.0, -REST - e, 0.0]])
    assert np.abs(accelerations(system, x, 0.0 * x)).max() < 1e-13 * load


@pytest.mark.quick(plugin=["symplectic_euler"])
@pytest.mark.parametrize("plugin", [SymplecticEuler(), ImplicitEuler(), TRBDF2()], ids=lambda p: p.name)
def test_a_loaded_yarn_comes_to_the_closed_forms_rest(plugin: Any) -> None:
    system = hanging()
    state = start(system)
    fields = {} if plugin.explicit else {"residual": 1e-11}
    memory = plugin.prepare(plugin.Config(**fields), system, state)
    assert plugin.advance(system, state, memory, None, 800, 0.01).status == "ok"
    e = LOCK * REST + (MASS * G - K * LOCK * REST) / K_LOCK
    assert abs(state.x[1, 1] + REST + e) < 1e-9


def test_a_swing_across_the_lock_takes_the_closed_forms_time() -> None:
    """Without weight, from the rest length at speed u: a slow sine up to the knee, then a fast one."""
    system = hanging(0.0, 0.0)
    slow, fast, u = np.sqrt(K / MASS), np.sqrt(K_LOCK / MASS), 2.0
    knee = LOCK * REST
    first = np.arcsin(slow * knee / u) / slow
    speed = u * np.cos(slow * first)
    # From the knee on, e = knee + y: m y'' = -K knee - K_LOCK y, about y = -K knee / K_LOCK.
    offset = K * knee / K_LOCK
    second = (0.5 * np.pi - np.arctan2(fast * offset, speed)) / fast
    turning = knee - offset + np.hypot(offset, speed / fast)
    system = replace(system, fabric=replace(system.fabric, velocity=np.array([[0.0, 0.0, 0.0], [0.0, -u, 0.0]])))
    state, plugin = start(system), Dop853()
    memory = plugin.prepare(plugin.Config(tolerance=1e-12), system, state)
    assert plugin.advance(system, state, memory, None, 1, first + second).status == "ok"
    assert abs(state.x[1, 1] + REST + turning) < 1e-9
    assert abs(state.v[1, 1]) < 1e-7


def flat(n: int, seed: int) -> Fabric:
    position, springs = random_net(n, 3 * n, seed)
    return locking(make_fabric(1.2 * position, springs, mass=1.0), seed)


def rows_of_runs() -> Fabric:
    """A line of 40 springs in two runs, constants per run."""
    x = np.zeros((41, 3))
    x[:, 0] = 1.3 * np.arange(41)
    first, count = np.array([[0, 1], [20, 21]], np.int32), np.array([20, 20], np.int32)
    one = np.ones(2)
    springs = Springs(
        first, count, np.ones(2, np.int32), 4 * one, one, 0 * one, np.zeros(2, np.int8), np.array([0.1, 0.5]), 9 * one
    )
    return make_fabric(x, springs, mass=1.0)


BUILDS = {"lists": lambda: flat(50, 1), "runs": rows_of_runs}


@pytest.mark.quick(build=[rows_of_runs])
@pytest.mark.parametrize("build", BUILDS.values(), ids=BUILDS)
def test_force_is_minus_the_gradient_of_energy(build: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nuno_kernels.step.blocks.SMALL", 0)
    fabric = build()
    packed, x0 = pack(make_system(fabric)), fabric.position
    part = packed.forces[0]
    assert part is not None and part.locks
    force = accelerations(make_system(fabric), x0, 0 * x0)

    def energy(x: Float) -> float:
        return measure_energy(to_rows(x), to_rows(0 * x), fabric.mass, packed).total

    h, rng = 1e-6, np.random.default_rng(4)
    for _ in range(20):
        u = rng.standard_normal(x0.shape)
        slope = (energy(x0 + h * u) - energy(x0 - h * u)) / (2 * h)
        assert abs((force * u).sum() + slope) < 1e-6 * np.abs(force).max()


@pytest.mark.parametrize("c", [0.0, 0.4])
@pytest.mark.parametrize("points", [60, BLOCK + 300])
def test_forces_along_yarns_follow_the_formula_and_keep_momentum(points: int, c: float) -> None:
    fabric = locking(chains(points, 40, 1, c=c))
    v = np.random.default_rng(2).standard_normal((points, 3))
    force = accelerations(make_system(fabric), fabric.position, v)
    assert np.abs(force - reference(fabric, fabric.position, v)).max() < 1e-12 * np.abs(force).max()
    scale = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-14 * scale
    assert np.abs(np.cross(fabric.position, force).sum(axis=0)).max() < 1e-14 * scale


@pytest.mark.parametrize("by", [1.15, 3.0], ids=["slack", "locked"])
def test_matrix_is_the_derivative_of_the_forces(by: float) -> None:
    """Of yarns of one stiffness, all of whose links are below the lock, or all beyond."""
    fabric = chains(80, 40, 3, uniform=True)
    assert fabric.springs is not None
    n, pairs = fabric.springs.number, fabric.springs.pairs()
    rest = np.linalg.norm(fabric.position[pairs[:, 1]] - fabric.position[pairs[:, 0]], axis=1)
    springs = replace(fabric.springs, rest=rest, lock=np.full(n, 0.3), k_lock=np.full(n, 40.0))
    fabric = replace(fabric, springs=springs)
    packed, x = pack(make_system(fabric)), by * to_rows(fabric.position)
    linear, u, e = make_linear(packed), np.random.default_rng(5).standard_normal(x.shape), 1e-7
    fill(x, 1.0, packed, linear)
    ahead, behind = np.empty_like(x), np.empty_like(x)
    evaluate(x + e * u, 0 * x, 0.0, ahead, packed)
    evaluate(x - e * u, 0 * x, 0.0, behind, packed)
    expected = -(ahead - behind) / (2.0 * e)
    np.testing.assert_allclose(multiply(linear, u, None), expected, atol=1e-7 * np.abs(expected).max())


def test_the_limit_counts_the_stiffer_slope() -> None:
    """A slack link's step is that of a link of k_lock: it may lock within any step."""
    omega, _ = measure_rates(hanging(), start(hanging()))
    assert 0.999 * np.sqrt(K_LOCK / MASS) <= omega < 1.02 * np.sqrt(K_LOCK / MASS)


def test_joined_springs_keep_their_locks() -> None:
    position, plain = random_net(20, 40, 1)
    first, second = make_fabric(position, plain, mass=1.0), flat(20, 2)
    assert second.springs is not None
    joined = Springs.join([plain, replace(second.springs, first=second.springs.first + np.int32(20))])
    x = np.concatenate([position, second.position])
    expected = [accelerations(make_system(f), f.position, 0 * f.position) for f in (first, second)]
    found = accelerations(make_system(make_fabric(x, joined, mass=1.0)), x, 0 * x)
    assert np.abs(found - np.concatenate(expected)).max() < 1e-12 * np.abs(found).max()


def test_xpbd_refuses_locks_by_name() -> None:
    with pytest.raises(BadInput, match="lock") as caught:
        XPBD().prepare(XPBD.Config(), hanging(), start(hanging()))
    assert caught.value.field == "solver.plugin"
