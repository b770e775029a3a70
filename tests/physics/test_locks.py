"""Springs and yarns that lock: T = k e up to the strain `lock`, growing by k_lock from there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nets import accelerations, make_fabric, make_system, random_net, start
from yarn_nets import chains, locking, reference

from nuno_integrators.explicit.adaptive import Dop853
from nuno_integrators.explicit.fixed_step import SymplecticEuler
from nuno_integrators.implicit.conjugate import multiply
from nuno_integrators.implicit.matrix import fill, make_linear
from nuno_integrators.implicit.plugin import TRBDF2, ImplicitEuler
from nuno_integrators.packing import pack, to_rows
from nuno_integrators.stability import measure_rates
from nuno_integrators.xpbd import XPBD
from nuno_kernels.forces.energy import measure_energy
from nuno_kernels.step.acceleration import evaluate
from nuno_kernels.step.blocks import BLOCK
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Springs
from nuno_schemas.system import System

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
    evaluate(x + e * u, 0 * x, 0.0, ahead, packed, None)
    evaluate(x - e * u, 0 * x, 0.0, behind, packed, None)
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
