"""Energy over 100,000 steps of an undamped net: kept, lost or gained as each method has it."""

from __future__ import annotations

import numpy as np
import pytest
from nets import make_fabric, make_system, start

from nuno.plugin_contract import registry
from nuno_schemas.fabric import Float, Springs

CHUNK, CHUNKS = 1000, 100
SHARE = 0.5
"""omega dt of the fastest mode: a quarter of leapfrog's limit."""


def energy_over_steps(solver: str) -> Float:
    """Energy of a free net of twelve vertices over that at the start, minus 1, after each thousand steps; fewer where
    it diverges.
    """
    rng = np.random.default_rng(11)
    x = rng.uniform(-0.5, 0.5, (12, 3))
    pairs = np.array([(i, j) for i in range(12) for j in range(i)], np.int32)
    pairs = pairs[rng.permutation(len(pairs))[:40]]
    rest = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    springs = Springs.from_pairs(pairs, rng.uniform(50.0, 200.0, 40), rest, np.zeros(40))
    system = make_system(make_fabric(x, springs, mass=1.0, velocity=0.2 * rng.standard_normal((12, 3))))
    plugin, state = registry.load("nuno.integrators", solver), start(system)
    config = plugin.Config()
    memory, dt = plugin.prepare(config, system, state), SHARE / plugin.limit(config, system, state).omega
    energies = [sum(plugin.advance(system, state, memory, None, 0, dt).energy.values())]
    with np.errstate(all="ignore"):
        while len(energies) <= CHUNKS and np.isfinite(energies[-1]) and energies[-1] < 1e6 * energies[0]:
            energies.append(sum(plugin.advance(system, state, memory, None, CHUNK, dt).energy.values()))
    return np.array(energies[1:]) / energies[0] - 1.0


def test_leapfrog_keeps_it_within_its_band_for_ever() -> None:
    """Its energy wavers within h^2 / 4 of the elastic part."""
    change = energy_over_steps("leapfrog")
    assert len(change) == CHUNKS and np.abs(change).max() < SHARE**2 / 4.0
    assert np.abs(change[-10:].mean() - change[:10].mean()) < 0.01


def test_rk4_loses_it() -> None:
    """By h^6 / 72 a step of the fastest mode alone."""
    assert -1.0 < energy_over_steps("rk4")[-1] < -0.05


@pytest.mark.parametrize("solver", ["euler"])
def test_explicit_euler_gains_it_without_bound(solver: str) -> None:
    change = energy_over_steps(solver)
    assert len(change) < CHUNKS and not change[-1] < 1e3
