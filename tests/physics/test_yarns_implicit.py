"""The matrix of an implicit step with yarns: derivative of their forces, positive, and what Newton's method gains."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nets import make_system, start
from yarn_nets import balance, chains, line

from nuno_integrators.implicit import linear_solve as solver
from nuno_integrators.implicit.conjugate import multiply
from nuno_integrators.implicit.factor import factorise, make_factor, solve_factored
from nuno_integrators.implicit.matrix import Linear, fill, make_linear
from nuno_integrators.implicit.plan import make_plan
from nuno_integrators.implicit.plugin import TRBDF2, ImplicitEuler
from nuno_integrators.packing import pack, to_rows
from nuno_kernels.step.acceleration import evaluate
from nuno_kernels.step.blocks import BLOCK
from nuno_schemas.fabric import Fabric, Float


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
    evaluate(x + e * u, v + e * rate * u, 0.0, ahead, packed, None)
    evaluate(x - e * u, v - e * rate * u, 0.0, behind, packed, None)
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
