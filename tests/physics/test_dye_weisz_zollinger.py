"""Diffusion that falls with dye: closed forms, order, dye kept and in its bounds, D0 cap below the bend."""

from __future__ import annotations

from dataclasses import replace
from math import fsum
from typing import Any

import numpy as np
import pytest
from dye_reference import LAWS, dyed, face_flows, kept, random_cells, resisted, start
from dye_runs import SOLVERS, limit, run
from pydantic import ValidationError

from nuno_dye.laws.diffusivity import Curve, amount, curve_of, potential, potentials
from nuno_dye.laws.power import log
from nuno_kernels import kernel
from nuno_kernels.lanes import WIDTH, load, store
from nuno_schemas.dye import Cells, Dye, DyeSystem, Tortuosity
from nuno_schemas.dyeing import WeiszZollinger
from nuno_schemas.fabric import Float

LAW = WeiszZollinger(phi0=0.1, cap=20.0)


def falling(system: DyeSystem, law: WeiszZollinger = LAW) -> DyeSystem:
    return replace(system, dyes=tuple(replace(one, weisz_zollinger=law) for one in system.dyes))


def chain(n: int, law: WeiszZollinger) -> DyeSystem:
    """Two yarns of n cells, apart."""
    ones, apart = np.ones((2, 1, n)), Tortuosity(0.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    cells = Cells(ones > 0, ones > 0, ones, ones, 0 * ones, 1.0, apart, v_max=10.0)
    return DyeSystem(cells, (Dye("blue", 1.0, weisz_zollinger=law),))


def sources(n: int, mean: float, theta: float) -> Float:
    """Mean over each of n cells of mean sinh(theta) / (cosh(theta) - cos(pi x / n)), as the law of dye has it."""
    half = 0.5 * np.pi * np.arange(n + 1) / n
    whole = 2.0 * mean * n / np.pi * np.arctan2(np.sin(half), np.cos(half) * np.tanh(0.5 * theta))
    return np.broadcast_to(np.diff(whole), (2, 1, n))


@kernel
def find_logs(values: Float, out: Float) -> None:
    for c in range(0, values.shape[1], WIDTH):
        store(out, 0, c, log(load(values, 0, c)))


def test_logarithms_are_within_two_units_in_the_last_place() -> None:
    for decades in ((-307.0, 308.0), (-0.2, 0.2), (-1e-9, 1e-9)):
        values = 10.0 ** np.random.default_rng(1).uniform(*decades, (1, 80_000))
        out, exact = np.empty_like(values), np.log(values.astype(np.longdouble))
        find_logs(values, out)
        error = np.abs(out - exact) / np.spacing(np.abs(exact.astype(np.float64)))
        assert float(error.max()) <= (2.0 if np.finfo(np.longdouble).nmant > 52 else 3.0)


@kernel
def find_potentials(values: Float, curve: Any, out: Float) -> None:
    for c in range(0, values.shape[1], WIDTH):
        store(out, 0, c, potentials(load(values, 0, c), curve))


def test_the_potential_is_the_integral_of_the_factor() -> None:
    curve = curve_of(chain(2, LAW).dyes[0])
    assert curve == Curve(0.1, 20.0, 0.005)
    phi = np.concatenate([[-1e-3, 0.0, 0.005], np.linspace(0.0, 0.8, 8001)[1:], np.full(5, np.nan)])
    levels, vectors = np.array([potential(one, curve) for one in phi]), np.empty((1, phi.size))
    find_potentials(phi[None], curve, vectors)
    assert vectors[0] == pytest.approx(levels, rel=1e-15, nan_ok=True)
    assert [amount(one, curve) for one in levels] == pytest.approx(phi, rel=1e-14, nan_ok=True)
    middle, rise = 0.5 * (phi[3:-6] + phi[4:-5]), np.diff(levels[3:-5]) / np.diff(phi[3:-5])
    assert rise == pytest.approx(np.minimum(20.0, 0.1 / middle), rel=2e-3)


def test_explicit_steps_equal_a_plain_loop() -> None:
    cells = replace(random_cells(9, 11), v_max=1e3)
    phi = np.random.default_rng(2).random(cells.fibre.shape) * (cells.porosity > 0.0)
    system = falling(dyed(cells, None))
    ours, _ = run("explicit", system, phi, 0 * phi, 3 * 0.9 * limit(system), 3)
    scale = 0.9 * limit(system) * system.dyes[0].D0 / cells.size**2
    for _ in range(3):
        levels = np.where(phi > 0.005, 0.1 * (1.0 + np.log(np.maximum(phi, 0.005) / 0.005)), 20.0 * phi)
        for (donor, receiver), flow in face_flows(levels, cells, scale).items():
            phi[donor] -= flow
            phi[receiver] += flow
    assert np.abs(ours.phi[0] - phi).max() < 1e-12


@pytest.mark.quick(name=["explicit"])
@pytest.mark.parametrize("name", SOLVERS)
def test_it_is_of_the_solvers_order(name: str) -> None:
    """Against classical Runge-Kutta steps, on the same cells."""
    n, law = 10, WeiszZollinger(phi0=0.1, cap=2.0)
    system = chain(n, law)
    begun, t = sources(n, 0.5, 0.4), 80.0 * limit(system)
    phi, count = begun[0, 0].copy(), 800

    def rate(u: Float) -> Float:
        flux = np.diff(0.1 * np.log(u))
        return np.diff(flux, prepend=0.0, append=0.0)

    for _ in range(count):
        h = t / count
        a = rate(phi)
        b = rate(phi + 0.5 * h * a)
        c = rate(phi + 0.5 * h * b)
        phi = phi + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(phi + h * c))
    counts = (100, 200, 400) if name == "explicit" else (20, 40, 80, 160)
    errors = [
        float(np.abs(run(name, system, begun, 0 * begun, t, steps)[0].phi[0, 0, 0] - phi).max()) for steps in counts
    ]
    assert np.log2(errors[-2] / errors[-1]) == pytest.approx(SOLVERS[name][2], abs=0.15)


@pytest.mark.quick(name=["explicit"])
@pytest.mark.parametrize("name", SOLVERS)
def test_below_the_bend_it_is_the_capped_coefficient(name: str) -> None:
    cells = resisted(9, 11)
    system, plain = falling(dyed(cells, None), WeiszZollinger(phi0=20.0, cap=10.0)), dyed(cells, None)
    plain = replace(plain, dyes=(replace(plain.dyes[0], D0=10.0 * plain.dyes[0].D0),))
    phi, t = start(cells)[0], 30.0 * limit(system)
    assert limit(system) == pytest.approx(limit(plain), rel=1e-15)
    (ours, _), (other, _) = (run(name, one, phi, 0 * phi, t, 40) for one in (system, plain))
    assert np.abs(ours.phi - other.phi).max() < 1e-9


@pytest.mark.full
@pytest.mark.parametrize("name", SOLVERS)
def test_dye_is_kept_and_no_cell_holds_less_than_none_or_more_than_it_can(name: str) -> None:
    cells = resisted(12, 13)
    phi = start(cells)[0]
    system = replace(falling(dyed(cells, LAWS["langmuir"], adsorption=0.3)), supply=kept(cells, 0.8))
    steps = 400 if name == "explicit" else 20
    end, report = run(name, system, phi, 0 * phi, 300.0 * limit(system), steps)
    total = fsum(phi.reshape(-1)) + fsum(report.supplied)
    assert report.status == "ok" and report.supplied[0] > 0.0
    assert abs(report.mobile[0] + report.fixed[0] - total) <= 1e-13 * np.sqrt(steps) * total
    assert end.phi.min() >= 0.0 and (end.phi[0] <= cells.mobile_room).all()
    assert end.fixed.min() >= 0.0 and (end.fixed[0] <= cells.fixed_room).all()
    assert (end.phi >= system.supply).all() and end.fixed.max() > 0.0


@pytest.mark.full
def test_implicit_steps_come_to_the_explicit_solvers_amounts() -> None:
    """Limits, supply and fibre all at once, from amounts that jump from cell to cell."""
    cells = resisted(9, 11)
    phi = start(cells)[0]
    system = replace(falling(dyed(cells, LAWS["langmuir"])), supply=kept(cells))
    t = 120.0 * limit(system)
    other, _ = run("explicit", system, phi, 0 * phi, t, 4800)
    gaps = []
    for steps in (24, 96, 384):
        ours, _ = run("backward_euler", system, phi, 0 * phi, t, steps)
        gaps.append(max(np.abs(ours.phi - other.phi).max(), np.abs(ours.fixed - other.fixed).max()))
    assert gaps[2] < 2e-3 and gaps[0] > 2.0 * gaps[1] > 4.0 * gaps[2]


def test_without_a_cap_it_is_refused() -> None:
    with pytest.raises(ValidationError, match="add a cap"):
        WeiszZollinger(phi0=0.1)  # type: ignore[call-arg]
