"""The estimated frequency and damping bound the true ones from above, and not by much."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from nets import (
    NO_GRAVITY,
    find_hinges,
    grid_springs,
    make_fabric,
    make_hinges,
    make_system,
    random_net,
    start,
    triangulate,
)

from nuno_bench.speed.timing import watch_compiler
from nuno_bench.validation.oscillator import TEXTBOOK
from nuno_integrators.explicit.adaptive import Dopri5
from nuno_integrators.explicit.fixed_step import Euler, Leapfrog, SymplecticEuler
from nuno_integrators.explicit.runge_kutta import RK4
from nuno_integrators.stability import critical_step, measure_rates, spectral_radius
from nuno_schemas.fabric import Float, Springs
from nuno_schemas.system import System, Term

PLUGINS = [Euler(), SymplecticEuler(), Leapfrog(), RK4()]


def dense_stiffness(x: Float, springs: Springs) -> Float:
    """(3n, 3n) second derivative of the springs' energy."""
    n = x.shape[0]
    out = np.zeros((n, 3, n, 3))
    k, rest = springs.per_spring(springs.k), springs.per_spring(springs.rest)
    for s, (i, j) in enumerate(springs.pairs()):
        d = x[j] - x[i]
        length = np.linalg.norm(d)
        u = np.outer(d, d) / length**2
        block = k[s] * (u + (1.0 - rest[s] / length) * (np.eye(3) - u))
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            out[p, :, q, :] += sign * block
    return out.reshape(3 * n, 3 * n)


def true_omega(system: System) -> float:
    fabric = system.fabric
    assert fabric.springs is not None
    free = np.repeat(~fabric.pinned, 3)
    root = np.repeat(1.0 / np.sqrt(fabric.mass), 3)
    matrix = root[:, None] * dense_stiffness(fabric.position, fabric.springs) * root
    return float(np.sqrt(np.linalg.eigvalsh(matrix[np.ix_(free, free)])[-1]))


def bounded(system: System) -> float:
    omega, _ = measure_rates(system, start(system))
    return omega / true_omega(system)


@pytest.mark.quick(seed=range(3))
@pytest.mark.parametrize("seed", range(8))
def test_frequency_of_random_nets(seed: int) -> None:
    rng = np.random.default_rng(seed)
    position, springs = random_net(120, 700, seed)
    pinned = rng.random(120) < 0.1
    mass = np.exp(rng.uniform(0.0, np.log(10.0), 120))
    assert 1.0 <= bounded(make_system(make_fabric(position, springs, mass=mass, pinned=pinned))) <= 1.05


@pytest.mark.quick(seed=range(2))
@pytest.mark.parametrize("seed", range(4))
def test_frequency_of_stiff_and_heavy_mixes(seed: int) -> None:
    """Mass ratio 10^6 and stiffness from 1 to 10^8."""
    rng = np.random.default_rng(100 + seed)
    position, springs = random_net(100, 500, seed)
    k = 10.0 ** rng.uniform(0.0, 8.0, springs.number)
    mixed = Springs.from_pairs(springs.pairs(), k, springs.rest, springs.c)
    mass = 10.0 ** rng.uniform(-3.0, 3.0, 100)
    assert 1.0 <= bounded(make_system(make_fabric(position, mixed, mass=mass))) <= 1.05


@pytest.mark.quick(away=[1e6], stretch=[1.02])
@pytest.mark.parametrize("away", [0.0, 1e6])
@pytest.mark.parametrize("stretch", [1.0, 1.02])
def test_frequency_of_a_grid(stretch: float, away: float) -> None:
    position, springs = grid_springs(18, 18, 0.01, k=80.0)
    x = position * stretch + away
    assert 1.0 <= bounded(make_system(make_fabric(x, springs))) <= 1.05


def test_frequency_of_one_stiff_spring_in_a_large_net() -> None:
    """A single mode among 30,000 is not missed."""
    position, springs = grid_springs(100, 100, 0.01, k=10.0)
    k = springs.per_spring(springs.k).copy()
    k[springs.number // 2] = 40.0
    pairs = springs.pairs()
    single = Springs.from_pairs(pairs, k, springs.per_spring(springs.rest), 0 * k)
    soft = make_system(make_fabric(position, springs))
    omega = measure_rates(make_system(make_fabric(position, single)), start(soft))[0]
    near = np.unique(pairs[np.isin(pairs, pairs[springs.number // 2]).any(axis=1)])
    part = np.isin(pairs, near).all(axis=1)
    place = np.searchsorted(near, pairs[part]).astype(np.int32)
    cut = Springs.from_pairs(place, k[part], single.rest[part], 0 * k[part])
    assert omega >= true_omega(make_system(make_fabric(position[near], cut)))


def test_frequency_is_the_same_every_time() -> None:
    position, springs = random_net(80, 400, 3)
    system = make_system(make_fabric(position, springs))
    assert measure_rates(system, start(system)) == measure_rates(system, start(system))


def test_hinges_count() -> None:
    """A cantilevered flap: dense differences of the hinge force against the estimate."""
    from nets import accelerations

    rows, columns = 5, 6
    row, column = np.divmod(np.arange(rows * columns), columns)
    position = np.stack([column * 0.1, row * 0.1, 0.0 * row], axis=1)
    quads = find_hinges(triangulate(rows, columns))
    system = make_system(make_fabric(position, hinges=make_hinges(quads, np.ones(len(quads)), np.zeros(len(quads)))))
    n, h = position.shape[0], 1e-6
    jacobian = np.zeros((3 * n, 3 * n))
    for c in range(3 * n):
        d = np.zeros(3 * n)
        d[c] = h
        ahead = accelerations(system, position + d.reshape(n, 3), 0 * position)
        behind = accelerations(system, position - d.reshape(n, 3), 0 * position)
        jacobian[:, c] = ((behind - ahead) / (2 * h)).ravel()
    true = np.sqrt(np.linalg.eigvalsh(0.5 * (jacobian + jacobian.T))[-1])
    assert 1.0 <= measure_rates(system, start(system))[0] / true <= 1.05


def test_damping_rate_of_springs_and_air() -> None:
    position, springs = random_net(60, 300, 5, c=2.0)
    system = make_system(make_fabric(position, springs, mass=0.7), damping=0.3)
    n = 60
    matrix = np.zeros((n, 3, n, 3))
    for s, (i, j) in enumerate(springs.pairs()):
        d = position[j] - position[i]
        block = springs.c[s] * np.outer(d, d) / (d @ d)
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            matrix[p, :, q, :] += sign * block
    true = np.linalg.eigvalsh(matrix.reshape(3 * n, 3 * n))[-1] / 0.7 + 0.3
    assert 1.0 <= measure_rates(system, start(system))[1] / true <= 1.05


def test_uniform_damping_is_exact_and_terms_add() -> None:
    position, springs = random_net(30, 100, 5)
    plain = make_system(make_fabric(position, springs), damping=0.3)
    silent = Term("python", lambda x, v, t, out: None, omega_squared=1e9, damping_rate=7.0)
    loaded = make_system(make_fabric(position, springs), damping=0.3, terms=(silent,))
    omega, rate = measure_rates(plain, start(plain))
    assert rate == 0.3
    more, faster = measure_rates(loaded, start(loaded))
    assert abs(more**2 - omega**2 - 1e9) < 1e-3 * omega**2
    assert 7.3 <= faster <= 7.31


@pytest.mark.parametrize("n", [0, 1, 3])
def test_nothing_to_oscillate(n: int) -> None:
    system = make_system(make_fabric(np.zeros((n, 3))), np.array([0.0, -9.81, 0.0]))
    for plugin in PLUGINS:
        limit = plugin.limit(plugin.Config(), system, start(system))
        assert limit.omega == 0.0
        assert limit.damping == 0.0
        assert limit.dt == np.inf


def test_springs_of_zero_length_count_with_their_stiffness() -> None:
    position = np.zeros((2, 3))
    springs = Springs.from_pairs(np.array([[0, 1]], np.int32), np.array([8.0]), np.array([1.0]), np.zeros(1))
    omega, _ = measure_rates(
        make_system(make_fabric(position, springs, mass=1.0)), start(make_system(make_fabric(position)))
    )
    assert 4.0 <= omega <= 4.2


def test_critical_steps_are_the_known_ones() -> None:
    omega, none = np.array([1e-3, 1.0, 1e6]), np.zeros(3)
    assert not critical_step(Euler().amplification, omega, none).any()
    for plugin, limit in ((SymplecticEuler(), 2.0), (Leapfrog(), 2.0), (RK4(), 2.0 * np.sqrt(2.0))):
        assert np.abs(critical_step(plugin.amplification, omega, none) * omega / limit - 1.0).max() < 1e-9
    assert abs(critical_step(Euler().amplification, np.array([10.0]), np.array([0.5]))[0] - 0.005) < 1e-9
    damping = np.array([0.1, 1.0, 5.0, 50.0])
    step = critical_step(SymplecticEuler().amplification, np.full(4, 10.0), damping)
    assert np.abs(damping * step + 0.5 * 100.0 * step**2 - 2.0).max() < 1e-9


@pytest.mark.parametrize("plugin", [*PLUGINS, Dopri5()], ids=lambda p: p.name)
def test_matrices_of_a_step_are_the_textbooks(plugin: Any) -> None:
    """Those that follow from a tableau, and from the source of a loop, which compiles nothing."""
    rng = np.random.default_rng(4)
    omega, damping, dt = rng.uniform(0.1, 30.0, 50), rng.uniform(0.0, 20.0, 50), rng.uniform(1e-3, 0.05, 50)
    with watch_compiler() as compiler:
        found = plugin.amplification(omega, damping, dt)
    expected = np.stack([TEXTBOOK[plugin.name](*one) for one in zip(omega, damping, dt, strict=True)], axis=-1)
    assert np.abs(found - expected).max() < 1e-12
    assert compiler.number == 0
    assert np.array_equal(plugin.amplification(omega[0], damping[0], dt[0]), found[:, :, 0])


@pytest.mark.parametrize("plugin", PLUGINS[1:], ids=lambda p: p.name)
def test_limit_holds_for_every_slower_or_less_damped_mode(plugin: SymplecticEuler) -> None:
    position, springs = random_net(40, 200, 1, c=0.05)
    system = make_system(make_fabric(position, springs), NO_GRAVITY, 0.2)
    limit = plugin.limit(plugin.Config(), system, start(system))
    omega, damping = np.meshgrid(np.linspace(0.0, limit.omega, 41), np.linspace(0.2, limit.damping, 41))
    radius = spectral_radius(plugin.amplification(omega, damping, np.full_like(omega, 0.999 * limit.dt)))
    assert radius.max() <= 1.0 + 1e-12
