"""Every explicit integrator: exact amplification, order, critical step, invariants."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from nets import grid_springs, make_fabric, make_system, run, start

from nuno_integrators.explicit.leapfrog import Leapfrog
from nuno_integrators.explicit.rk4 import RK4, RK4Printed
from nuno_integrators.explicit.symplectic_euler import SymplecticEuler
from nuno_schemas.fabric import Float, Springs
from nuno_schemas.system import System


def oscillator(omega: float, damping: float, x: Float, v: Float) -> System:
    """A particle on a spring of rest length 0 to a pinned one: x'' = -omega^2 x - damping x'."""
    springs = Springs.from_pairs(np.array([[0, 1]], np.int32), np.array([2.0 * omega**2]), np.zeros(1), np.zeros(1))
    pinned = np.array([True, False])
    fabric = make_fabric(np.stack([0 * x, x]), springs, mass=2.0, pinned=pinned, velocity=np.stack([0 * v, v]))
    return make_system(fabric, damping=damping)


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
