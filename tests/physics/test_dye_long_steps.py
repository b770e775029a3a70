"""What solvers of long steps have in common: closed forms, dye kept in its bounds, what is extreme, equal bits."""

from __future__ import annotations

from dataclasses import replace
from math import fsum

import numpy as np
import pytest
from dye_reference import ISOTHERMS, LAWS, dyed, kept, random_cells, resisted, start, step_plainly
from dye_runs import LONG, SECOND, SOLVERS, limit, orders, run

from nuno_dye.solvers.solving import CELLS_PER_THREAD
from nuno_schemas.dye import Cells, Dye, DyeState, DyeSystem, Isotherm, Tortuosity
from nuno_schemas.errors import BadInput

ONES = np.ones((2, 3, 3))


@pytest.mark.quick(name=["rkl2"])
@pytest.mark.parametrize("name", LONG)
def test_diffusion_is_of_the_solvers_order(name: str) -> None:
    """Against the exponential of the matrix whose columns are what a plain step makes of single cells."""
    cells = replace(random_cells(6, 7), v_max=1e3)
    n = cells.fibre.size
    # Kept up to nothing: as without, by kernels that others of these tests compile.
    system = replace(dyed(cells, None), supply=np.zeros((1, *cells.fibre.shape)))
    units = np.eye(n).reshape(n, *cells.fibre.shape)
    matrix = np.stack([(step_plainly(unit, cells, 1.0) - unit).reshape(-1) for unit in units])
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    phi = np.random.default_rng(1).random(cells.fibre.shape)
    t = 40.0 * limit(system)
    exact = vectors @ (np.exp(values * system.dyes[0].D0 * t / cells.size**2) * (vectors.T @ phi.reshape(-1)))
    errors = [
        float(np.abs(run(name, system, phi, 0 * phi, t, steps)[0].phi.reshape(-1) - exact).max())
        for steps in (20, 40, 80, 160)
    ]
    assert orders(errors)[-1] == pytest.approx(SOLVERS[name][2], abs=0.15)
    assert name != "rkl2" or errors[-1] < 2e-6


@pytest.mark.quick(kept_up=[True], name=["rkl2"])
@pytest.mark.parametrize("name", SECOND)
@pytest.mark.parametrize("kept_up", [False, True])
def test_fibre_takes_dye_with_second_order_up_to_its_limit(name: str, kept_up: bool) -> None:
    """A cell by itself: A = S/2 (1 - exp(-2 rho t)), or phi (1 - exp(-rho t)) where phi is kept up; then its limit."""
    closed = Tortuosity(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    cells = Cells(ONES > 0, ONES > 0, 0.5 * ONES, ONES, 0 * ONES, 1.0, closed)
    free, bound = Isotherm("partition", 1e3), Isotherm("langmuir", 1.0)
    phi, rho = 0.3 * ONES, 0.7
    errors = []
    for n in (8, 16, 32, 64):
        system = DyeSystem(cells, (Dye("blue", 1.0, rho, free),), supply=phi[None] if kept_up else None)
        fixed = run(name, system, phi, 0 * phi, 1.5, n)[0].fixed
        exact = 0.3 * (1.0 - np.exp(-1.5 * rho)) if kept_up else 0.15 * (1.0 - np.exp(-3.0 * rho))
        errors.append(float(np.abs(fixed - exact).max()))
    assert orders(errors)[-1] > 1.8 and errors[-1] < 2e-5
    system = replace(system, dyes=(Dye("blue", 1.0, rho, bound),))
    end, _ = run(name, system, phi, 0 * phi, 50.0, 20)
    assert end.fixed == pytest.approx(0.5 * end.phi / (1.0 + end.phi), rel=1e-9)


@pytest.mark.quick(law=["langmuir"])
@pytest.mark.parametrize("name", LONG)
@pytest.mark.parametrize("law", ["partition", "freundlich", "langmuir"])
def test_fibre_in_a_bath_comes_to_its_limit_and_not_beyond(name: str, law: str) -> None:
    """A_d of the bath, which fibre at half of D_ab reaches within the first steps; stages would swing about it."""
    ones = np.ones((2, 12, 12))
    cells = Cells(ones > 0, ones > 0, 0.5 * ones, ones, 0 * ones, 1.0, Tortuosity(1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
    isotherm = {
        "partition": Isotherm("partition", 0.5),
        "freundlich": Isotherm("freundlich", 0.3, 0.5),
        "langmuir": Isotherm("langmuir", 2.0),
    }[law]
    most = {"partition": 0.5 * 0.4, "freundlich": 0.3 * 0.4**0.5, "langmuir": 0.5 * 2.0 * 0.4 / 1.8}[law]
    system = DyeSystem(cells, (Dye("blue", 1.0, 0.01, isotherm),), supply=0.4 * ones[None])
    for t in (200.0, 700.0, 2000.0):
        end, report = run(name, system, 0 * ones, 0 * ones, t, 1)
        assert report.status == "ok" and end.fixed.max() <= most * (1.0 + 1e-11)
    assert end.fixed == pytest.approx(most, rel=1e-6)


@pytest.mark.quick(law=["langmuir"], supplied=[True], steps=[7], name=["sdirk2"])
@pytest.mark.parametrize("name", LONG)
@pytest.mark.parametrize("law", ISOTHERMS)
@pytest.mark.parametrize(("supplied", "steps", "limits"), [(False, 7, 2000.0), (True, 7, 2000.0), (True, 100, 500.0)])
def test_dye_is_kept_and_no_cell_holds_less_than_none_or_more_than_it_can(
    name: str, law: str, supplied: bool, steps: int, limits: float
) -> None:
    cells = resisted(19, 21)
    phi, fixed = start(cells)
    system = replace(dyed(cells, LAWS.get(law), adsorption=0.3), supply=kept(cells, 0.8) if supplied else None)
    end, report = run(name, system, phi, fixed, limits * limit(system), steps)
    total = fsum(phi.reshape(-1)) + fsum(report.supplied)
    assert report.status == "ok" and report.totals["steps"] == steps
    assert abs(report.mobile[0] + report.fixed[0] - total) <= 1e-13 * np.sqrt(steps) * total
    assert end.phi.min() >= 0.0 and end.fixed.min() >= 0.0
    assert (end.phi[0] <= cells.mobile_room).all() and (end.fixed[0] <= cells.fixed_room).all()
    assert system.supply is None or (end.phi >= system.supply).all()


@pytest.mark.quick(name=["sdirk2"])
@pytest.mark.parametrize("name", SECOND)
def test_what_is_legal_but_extreme_is_done(name: str) -> None:
    base = random_cells(14, 13)
    rng, ones = np.random.default_rng(3), np.ones(base.fibre.shape)
    wild = replace(base, porosity=10.0 ** rng.uniform(-6.0, 0.0, ones.shape))
    cases = {
        "anisotropic": replace(base, tortuosity=Tortuosity(1e-6, 1e-6, 1.0, 1.0, 1.0, 1e-3)),
        "porosities over six decades": wild,
        "no pores": replace(base, porosity=0 * ones),
        "all pores": replace(base, porosity=ones),
        "resisted everywhere": replace(base, resist=ones),
    }
    for case, cells in cases.items():
        for share in (0.0, 1.0, rng.random(ones.shape)):
            phi = share * cells.mobile_room
            # Kept up to nothing: as without, by kernels that others of these tests compile.
            system = replace(dyed(cells, LAWS["langmuir"]), supply=0 * phi[None])
            end, report = run(name, system, phi, 0 * phi, 5e4, 3)
            assert report.status == "ok", case
            assert abs(report.mobile[0] + report.fixed[0] - phi.sum()) <= 2e-13 * phi.sum(), case
            assert end.phi.min() >= 0.0 and (end.phi[0] <= cells.mobile_room).all(), case


@pytest.mark.quick(law=["langmuir"], name=["rkl2"])
@pytest.mark.parametrize("name", SECOND)
@pytest.mark.parametrize("law", [None, "langmuir"])
def test_frames_threads_and_a_resumed_run_change_no_bit(name: str, law: str | None) -> None:
    side = int(CELLS_PER_THREAD**0.5) + 1
    cells = resisted(side, side)
    phi, fixed = start(cells)
    one = replace(dyed(cells, LAWS.get(law or "")), supply=kept(cells))
    t = 60.0 * limit(one)
    whole, _ = run(name, one, phi, fixed, t, 6)
    parts, _ = run(name, one, phi, fixed, t, 2, 3)
    two, _ = run(name, replace(one, threads=2), phi, fixed, t, 6)
    resumed, _ = run(name, one, phi, fixed, t, 2, 3, resumed=True)
    for state in (parts, two, resumed):
        assert np.array_equal(state.phi, whole.phi) and np.array_equal(state.fixed, whole.fixed)


@pytest.mark.parametrize("name", SECOND)
def test_an_isotherm_in_python_is_refused_by_name(name: str) -> None:
    cells, (solver, config, _) = resisted(8, 9), SOLVERS[name]
    law = Isotherm("python", function=lambda phi, room: room)
    with pytest.raises(BadInput, match="isotherm in Python"):
        solver.prepare(config, dyed(cells, law), DyeState(np.zeros((1, *cells.fibre.shape)), np.zeros(1)))
