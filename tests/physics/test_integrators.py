"""Every explicit integrator: exact amplification, order, critical step, invariants."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from explicit_methods import ALL, METHODS, name
from nets import grid_springs, make_fabric, make_system, random_net, reference_forces, run, start
from scipy.integrate import solve_ivp

from nuno_integrators.explicit.fixed_step import RK4, Euler, Leapfrog, RK4Printed, SymplecticEuler
from nuno_schemas.fabric import Float, Springs
from nuno_schemas.system import System


def oscillator(omega: float, damping: float, x: Float, v: Float) -> System:
    """A particle on a spring of rest length 0 to a pinned one: x'' = -omega^2 x - damping x'."""
    springs = Springs.from_pairs(np.array([[0, 1]], np.int32), np.array([2.0 * omega**2]), np.zeros(1), np.zeros(1))
    pinned = np.array([True, False])
    fabric = make_fabric(np.stack([0 * x, x]), springs, mass=2.0, pinned=pinned, velocity=np.stack([0 * v, v]))
    return make_system(fabric, damping=damping)


@pytest.mark.parametrize("plugin", ALL, ids=name)
@pytest.mark.parametrize("damping", [0.0, 0.7])
def test_one_step_is_the_stated_matrix(plugin: Any, damping: float) -> None:
    omega, dt = 3.0, 0.21
    x, v = np.array([1.0, 0.0, 0.4]), np.array([0.0, 1.0, -0.9])
    system = oscillator(omega, damping, x, v)
    state = start(system)
    run(plugin, system, state, 1, dt)
    expected = plugin.amplification(omega, damping, dt) @ np.stack([x, v])
    assert np.abs(state.x[1] - expected[0]).max() < 4e-16 * 4
    assert np.abs(state.v[1] - expected[1]).max() < 4e-16 * 12
    assert not state.x[0].any()
    assert not state.v[0].any()


@pytest.mark.parametrize(
    ("plugin", "bound"),
    [
        (SymplecticEuler(), lambda h: (1 + h / 2) / (1 - h / 2)),
        (Leapfrog(), lambda h: 1 / (1 - h * h / 4)),
    ],
    ids=["symplectic_euler", "leapfrog"],
)
@pytest.mark.parametrize("h", [0.1, 1.1, 1.9])
def test_energy_of_an_oscillator_stays_within_its_band(plugin: Any, bound: Any, h: float) -> None:
    """The band is filled unless the period is a whole number of steps, as it is for h = 1."""
    system = oscillator(1.0, 0.0, np.array([1.0, 0.0, 0.0]), np.zeros(3))
    state, energies = start(system), []
    memory = plugin.prepare(plugin.Config(), system, state)
    for _ in range(3000):
        plugin.advance(system, state, memory, None, 1, h)
        energies.append(state.x[1, 0] ** 2 + state.v[1, 0] ** 2)
    ratio = max(energies) / min(energies)
    assert 1.0 + 0.9 * (bound(h) - 1.0) < ratio <= bound(h) * (1 + 1e-9)


def test_euler_gains_energy_by_a_known_factor() -> None:
    system = oscillator(2.0, 0.0, np.array([1.0, 0.0, 0.0]), np.zeros(3))
    state = start(system)
    run(Euler(), system, state, 200, 0.01)
    energy = (2.0 * state.x[1, 0]) ** 2 + state.v[1, 0] ** 2
    assert abs(energy / (4.0 * (1.0 + 0.02**2) ** 200) - 1.0) < 1e-12


def smooth_net() -> System:
    position, springs = random_net(12, 40, 11, c=0.3)
    pinned = np.zeros(12, bool)
    pinned[:2] = True
    velocity = np.random.default_rng(2).standard_normal((12, 3)) * ~pinned[:, None]
    fabric = make_fabric(position, springs, mass=1.0, pinned=pinned, velocity=velocity)
    return make_system(fabric, np.array([0.0, -9.81, 0.0]), 0.8)


@cache
def reference(duration: float) -> Float:
    system = smooth_net()
    fabric, free = system.fabric, ~system.fabric.pinned[:, None]
    assert fabric.springs is not None

    def slope(t: float, y: Float) -> Float:
        x, v = y.reshape(2, 12, 3)
        force = reference_forces(x, v, fabric.springs)  # type: ignore[arg-type]
        return np.stack([v, free * (force / fabric.mass[:, None] + system.gravity - system.damping * v)]).ravel()

    y = np.stack([fabric.position, fabric.velocity]).ravel()
    result = solve_ivp(slope, (0.0, duration), y, "DOP853", rtol=1e-13, atol=1e-13)
    return np.asarray(result.y[:, -1])


@pytest.mark.parametrize(
    ("plugin", "steps"),
    [
        (Euler(), (1600, 3200, 6400, 12800)),
        (SymplecticEuler(), (1600, 3200, 6400, 12800)),
        (Leapfrog(), (200, 400, 800, 1600)),
        (RK4(), (60, 120, 240, 480)),
    ],
    ids=["euler", "symplectic_euler", "leapfrog", "rk4"],
)
def test_order_of_convergence(plugin: Any, steps: tuple[int, ...]) -> None:
    """On a smooth net with damped springs, gravity and viscous damping."""
    duration, errors = 0.4, []
    for count in steps:
        system = smooth_net()
        state = start(system)
        run(plugin, system, state, count, duration / count)
        errors.append(np.abs(np.stack([state.x, state.v]).ravel() - reference(duration)).max())
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert abs(slope - plugin.order) < 0.1, errors


def test_printed_slips_of_rk4_cost_three_orders_and_double_gravity() -> None:
    plugin, errors, counts = RK4Printed(), [], (50, 100, 200, 400)
    for count in counts:
        system = oscillator(2.0, 0.8, np.array([1.0, 0.0, 0.0]), np.zeros(3))
        state = start(system)
        run(plugin, system, state, count, 1.0 / count)
        rate = np.sqrt(4.0 - 0.16)
        exact = np.exp(-0.4) * (np.cos(rate) + 0.4 / rate * np.sin(rate))
        errors.append(abs(state.x[1, 0] - exact))
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - 1.0) < 0.1
    falling = make_system(make_fabric(np.zeros((1, 3))), np.array([0.0, -9.81, 0.0]))
    state = start(falling)
    run(plugin, falling, state, 100, 0.01)
    assert abs(state.v[0, 1] + 2 * 9.81) < 1e-12


def pinned_net(n: int) -> tuple[System, float]:
    """n x n free vertices inside a pinned frame, springs of rest length 0 to the 4 neighbours.

    Linear, with modes sin(p pi i/(n + 1)) sin(q pi j/(n + 1)) and squared frequencies
    4 k/m (sin^2(p pi/(2 n + 2)) + sin^2(q pi/(2 n + 2))), in each coordinate alike. Returns the
    system displaced along its fastest mode, and that frequency.
    """
    k, m, side = 3.0, 0.01, n + 2
    position, springs = grid_springs(side, side, 1.0, k)
    near = springs.kind == 0
    pairs = Springs(
        springs.first[near], springs.count[near], springs.stride[near], springs.k[near],
        0.0 * springs.rest[near], springs.c[near], springs.kind[near],
    )  # fmt: skip
    row, column = np.divmod(np.arange(side * side), side)
    pinned = (row == 0) | (row == side - 1) | (column == 0) | (column == side - 1)
    mode = np.sin(n * np.pi * row / (n + 1)) * np.sin(n * np.pi * column / (n + 1)) * ~pinned
    position[:, 2] = 1e-3 * mode
    omega = np.sqrt(8.0 * k / m) * np.sin(n * np.pi / (2 * n + 2))
    return make_system(make_fabric(position, pairs, mass=m, pinned=pinned)), float(omega)


@pytest.mark.parametrize(
    ("plugin", "limit"),
    [(SymplecticEuler(), 2.0), (Leapfrog(), 2.0), (RK4(), 2.0 * np.sqrt(2.0))],
    ids=["symplectic_euler", "leapfrog", "rk4"],
)
def test_normal_modes_are_bounded_below_the_critical_step_and_grow_above(plugin: Any, limit: float) -> None:
    for share, grows in ((0.999, False), (1.001, True)):
        system, omega = pinned_net(7)
        state = start(system)
        run(plugin, system, state, 500, share * limit / omega, frames=4)
        amplitude = np.abs(state.x[:, 2]).max() / 1e-3
        assert amplitude > 1e3 if grows else amplitude < 30.0
        measured = plugin.limit(plugin.Config(), system, start(system))
        assert omega <= measured.omega <= 1.05 * omega
        assert 0.95 * limit / omega <= measured.dt <= limit / omega


@pytest.mark.quick(plugin=["symplectic_euler", "leapfrog"])
@pytest.mark.parametrize("plugin", METHODS, ids=name)
def test_projectile(plugin: Any) -> None:
    """Exact from order 2 on; Euler's forms are off by g t dt/2 to either side. No sideways drift."""
    g, count, dt = 9.81, 100, 0.01
    system = make_system(make_fabric(np.zeros((3, 3)), velocity=np.tile([1.0, 2.0, 0.0], (3, 1))), np.array([0, -g, 0]))
    state = start(system)
    run(plugin, system, state, count, dt)
    lag = {"euler": 0.5, "symplectic_euler": -0.5}.get(plugin.name, 0.0)
    assert np.abs(state.x[:, 1] - (2.0 - 0.5 * g + lag * g * dt)).max() < 1e-13
    assert np.abs(state.x[:, 0] - 1.0).max() < 1e-14
    assert not state.x[:, 2].any()
    assert abs(state.t - 1.0) < 1e-12


@pytest.mark.parametrize("plugin", METHODS, ids=name)
def test_free_net_keeps_momentum_and_angular_momentum(plugin: Any) -> None:
    """All keep momentum to rounding. Symplectic Euler keeps angular momentum too, and leapfrog
    where no force depends on velocity: kicks and drifts by central forces. Others to their order.
    """
    position, springs = random_net(30, 150, 3)
    velocity = np.random.default_rng(1).standard_normal((30, 3))
    mass = np.random.default_rng(2).uniform(0.5, 2.0, 30)
    system = make_system(make_fabric(position, springs, mass=mass, velocity=velocity))
    state, weight = start(system), mass[:, None]
    run(plugin, system, state, 400, 1e-4)
    drift = np.abs((weight * (state.v - velocity)).sum(axis=0)).max()
    assert drift < 1e-12
    turn = (weight * (np.cross(state.x, state.v) - np.cross(position, velocity))).sum(axis=0)
    allowed = {"euler": 2.0, "symplectic_euler": 1e-12, "leapfrog": 1e-12, "rk4": 1e-9}[plugin.name]
    assert np.abs(turn).max() < allowed


@pytest.mark.parametrize("plugin", METHODS, ids=name)
def test_motion_turns_with_the_net(plugin: Any) -> None:
    position, springs = random_net(30, 150, 3, c=0.2)
    q, _ = np.linalg.qr(np.random.default_rng(8).standard_normal((3, 3)))
    states = []
    for turn in (np.eye(3), q):
        system = make_system(make_fabric(position @ turn.T, springs, mass=1.0), turn @ np.array([0.0, -9.81, 0.0]), 0.3)
        state = start(system)
        run(plugin, system, state, 100, 1e-3)
        states.append(state.x @ turn)
    assert np.abs(states[0] - states[1]).max() < 1e-11
