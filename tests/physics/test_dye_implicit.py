"""Implicit steps of dye: their order, closed forms, the explicit solver's limits, dye kept whatever the step."""

from __future__ import annotations

from dataclasses import replace
from math import fsum
from typing import Any

import numpy as np
import pytest
from test_dye_diffusion import random_cells, step_plainly
from test_dye_explicit import LAWS, dyed
from test_dye_rkl2 import follow, limit, orders
from test_dye_step import ISOTHERMS, resisted, start
from test_dye_upkeep import kept

from nuno_dye import implicit as module
from nuno_dye.implicit import HALVINGS, Implicit, ImplicitConfig
from nuno_dye.solving import CELLS_PER_THREAD
from nuno_schemas.dye import Cells, Dye, DyeReport, DyeState, DyeSystem, Isotherm, Tortuosity
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

ONES = np.ones((2, 3, 3))
SCHEMES = {"sdirk2": 2, "backward_euler": 1}


def run(
    system: DyeSystem,
    phi: Float,
    fixed: Float,
    t: float,
    steps: int,
    scheme: str = "sdirk2",
    frames: int = 1,
    residual: float = 1e-11,
) -> tuple[DyeState, DyeReport]:
    """`steps` steps in each of some frames, to `t` [s], solved nearly to rounding; `supplied` is of all."""
    config: Any = {"scheme": scheme, "residual": residual}
    solver, state = Implicit(), DyeState(phi[None].copy(), fixed[None].copy())
    memory = solver.prepare(ImplicitConfig(**config), system, state)
    reports = [solver.advance(system, state, memory, steps, t / (steps * frames)) for _ in range(frames)]
    given = (fsum(r.supplied[0] for r in reports),) if reports[0].supplied else ()
    return state, replace(reports[-1], supplied=given)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_diffusion_is_of_the_schemes_order(scheme: str) -> None:
    """Against the exponential of the matrix whose columns are what a plain step makes of single cells."""
    cells = replace(random_cells(6, 7), v_max=1e3)
    system, n = dyed(cells, None), cells.fibre.size
    units = np.eye(n).reshape(n, *cells.fibre.shape)
    matrix = np.stack([(step_plainly(unit, cells, 1.0) - unit).reshape(-1) for unit in units])
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    phi = np.random.default_rng(1).random(cells.fibre.shape)
    t = 40.0 * limit(system)
    exact = vectors @ (np.exp(values * system.dyes[0].D0 * t / cells.size**2) * (vectors.T @ phi.reshape(-1)))
    errors = [
        float(np.abs(run(system, phi, 0 * phi, t, n, scheme)[0].phi.reshape(-1) - exact).max())
        for n in (20, 40, 80, 160)
    ]
    assert orders(errors)[-1] == pytest.approx(SCHEMES[scheme], abs=0.15)


def test_a_sheet_takes_up_from_a_bath_as_the_closed_form_says() -> None:
    """M_t / M_inf = 1 - 8 / pi^2 sum exp(-D (2 n + 1)^2 pi^2 t / 4 l^2) / (2 n + 1)^2, both faces kept up."""
    n = 81
    ones = np.ones((2, 1, n))
    apart = Tortuosity(layers=0.0, beside=1.0, rim=1.0, gap=1.0, yarn=1.0, weave=1.0)
    cells = Cells(ones > 0, ones > 0, ones, ones, 0 * ones, 1.0, apart)
    supply = np.zeros((1, 2, 1, n))
    supply[..., [0, -1]] = 1.0
    system, half = DyeSystem(cells, (Dye("blue", 1.0),), supply=supply), 0.5 * (n - 1)
    for t in (80.0, 320.0, 1280.0):
        end, report = run(system, 0 * ones, 0 * ones, t, 60)
        odd = 2.0 * np.arange(60) + 1.0
        share = 1.0 - (8.0 / (odd * np.pi) ** 2 * np.exp(-((odd * np.pi) ** 2) * t / (4.0 * half**2))).sum()
        inside = end.phi[0, 0, 0, 1:-1].sum() + 0.5 * 2.0
        assert inside / (n - 1) == pytest.approx(share, abs=2e-3)
        assert report.supplied[0] == pytest.approx(end.phi.sum(), rel=1e-13)


@pytest.mark.parametrize("kept_up", [False, True])
def test_fibre_takes_dye_with_second_order_up_to_its_limit(kept_up: bool) -> None:
    """A cell by itself: A = S/2 (1 - exp(-2 rho t)), or phi (1 - exp(-rho t)) where phi is kept up; then its limit."""
    closed = Tortuosity(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    cells = Cells(ONES > 0, ONES > 0, 0.5 * ONES, ONES, 0 * ONES, 1.0, closed)
    free, bound = Isotherm("partition", 1e3), Isotherm("langmuir", 1.0)
    phi, rho = 0.3 * ONES, 0.7
    errors = []
    for n in (8, 16, 32, 64):
        system = DyeSystem(cells, (Dye("blue", 1.0, rho, free),), supply=phi[None] if kept_up else None)
        fixed = run(system, phi, 0 * phi, 1.5, n)[0].fixed
        exact = 0.3 * (1.0 - np.exp(-1.5 * rho)) if kept_up else 0.15 * (1.0 - np.exp(-3.0 * rho))
        errors.append(float(np.abs(fixed - exact).max()))
    assert orders(errors)[-1] > 1.8 and errors[-1] < 2e-5
    system = replace(system, dyes=(Dye("blue", 1.0, rho, bound),))
    end, _ = run(system, phi, 0 * phi, 50.0, 20)
    assert end.fixed == pytest.approx(0.5 * end.phi / (1.0 + end.phi), rel=1e-9)


@pytest.mark.parametrize("name", ISOTHERMS)
@pytest.mark.parametrize("supplied", [False, True])
def test_steps_come_to_the_explicit_solvers_amounts_as_they_shrink(name: str, supplied: bool) -> None:
    """Limits, supply and adsorption all at once, from amounts that jump from cell to cell."""
    cells = resisted(15, 17)
    phi, fixed = start(cells)
    system = replace(dyed(cells, LAWS.get(name)), supply=kept(cells) if supplied else None)
    t = 120.0 * limit(system)
    other = follow(system, phi, fixed, t, 9600)
    gaps = []
    for steps in (24, 96, 384):
        ours, report = run(system, phi, fixed, t, steps, "backward_euler")
        assert report.status == "ok" and report.totals["halvings"] == 0
        gaps.append(max(float(np.abs(getattr(ours, one) - getattr(other, one)).max()) for one in ("phi", "fixed")))
    assert gaps[2] < 1e-3 and gaps[0] > 2.0 * gaps[1] > 4.0 * gaps[2]
    second, _ = run(system, phi, fixed, t, 384)
    assert max(np.abs(second.phi - other.phi).max(), np.abs(second.fixed - other.fixed).max()) < 2e-3


@pytest.mark.parametrize("name", LAWS)
def test_long_steps_are_accurate_beside_a_kept_up_drop(name: str) -> None:
    """As in the dye paper's figure 9, smaller: 50 steps for 4,000 explicit ones."""
    ones = np.ones((2, 32, 32))
    cells = Cells(ones > 0, ones > 0, 0.5 * ones, ones, 0 * ones, 1.0, Tortuosity(1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
    y, x = np.indices((32, 32)) - 15.5
    supply = np.broadcast_to(0.5 * (x**2 + y**2 < 25.0), (1, *ones.shape))
    system = replace(dyed(cells, LAWS[name], adsorption=0.01), supply=supply)
    phi, t = 1.0 * supply[0], 3600.0 * limit(system)
    other, (ours, _) = follow(system, phi, 0 * phi, t, 4000), run(system, phi, 0 * phi, t, 50)
    assert max(np.abs(ours.phi - other.phi).max(), np.abs(ours.fixed - other.fixed).max()) < 1e-3 * 0.5


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", ISOTHERMS)
@pytest.mark.parametrize("supplied", [False, True])
@pytest.mark.parametrize("steps", [400, 7])
def test_dye_is_kept_and_no_cell_holds_less_than_none_or_more_than_it_can(
    scheme: str, name: str, supplied: bool, steps: int
) -> None:
    cells = resisted(19, 21)
    phi, fixed = start(cells)
    system = replace(dyed(cells, LAWS.get(name), adsorption=0.3), supply=kept(cells, 0.8) if supplied else None)
    end, report = run(system, phi, fixed, 2000.0 * limit(system), steps, scheme, residual=1e-11)
    total = fsum(phi.reshape(-1)) + fsum(report.supplied)
    assert report.status == "ok" and report.totals["steps"] == steps
    assert abs(report.mobile[0] + report.fixed[0] - total) <= 1e-13 * np.sqrt(steps) * total
    assert end.phi.min() >= 0.0 and end.fixed.min() >= 0.0
    assert (end.phi[0] <= cells.mobile_room).all() and (end.fixed[0] <= cells.fixed_room).all()
    assert system.supply is None or (end.phi >= system.supply).all()


def test_what_is_legal_but_extreme_is_done() -> None:
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
    for name, cells in cases.items():
        for share in (0.0, 1.0, rng.random(ones.shape)):
            phi = share * cells.mobile_room
            end, report = run(dyed(cells, LAWS["langmuir"]), phi, 0 * phi, 5e4, 3)
            assert report.status == "ok", name
            assert abs(report.mobile[0] + report.fixed[0] - phi.sum()) <= 2e-13 * phi.sum(), name
            assert end.phi.min() >= 0.0 and (end.phi[0] <= cells.mobile_room).all(), name


def test_full_resist_lets_nothing_through() -> None:
    cells = resisted(16, 20)
    resist = np.where(np.indices(cells.fibre.shape)[2] == 9, 1.0, 0.0)
    cells = replace(cells, resist=resist)
    phi = np.where(np.indices(cells.fibre.shape)[2] < 9, 0.7 * cells.mobile_room, 0.0)
    end, _ = run(dyed(cells, None), phi, 0 * phi, 1e4, 10)
    assert not end.phi[..., 9:].any() and end.phi.sum() == pytest.approx(phi.sum(), rel=1e-13)


@pytest.mark.parametrize("law", [None, "langmuir"])
def test_frames_and_threads_change_no_bit(law: str | None) -> None:
    side = int(CELLS_PER_THREAD**0.5) + 1
    cells = resisted(side, side)
    phi, fixed = start(cells)
    one = replace(dyed(cells, LAWS.get(law or "")), supply=kept(cells))
    t = 60.0 * limit(one)
    whole, _ = run(one, phi, fixed, t, 6)
    parts, _ = run(one, phi, fixed, t, 2, frames=3)
    two, _ = run(replace(one, threads=2), phi, fixed, t, 6)
    for state in (parts, two):
        assert np.array_equal(state.phi, whole.phi) and np.array_equal(state.fixed, whole.fixed)


def test_a_step_that_fails_is_damped_then_halved_and_then_said(monkeypatch: pytest.MonkeyPatch) -> None:
    cells = resisted(8, 9)
    phi, fixed = start(cells)
    system, calls, repair = dyed(cells, None), [0], module.repair
    t = 30.0 * limit(system)

    def failing(times: int) -> Any:
        calls[0] = 0

        def stub(*args: Any) -> int:
            calls[0] += 1
            return 1 if calls[0] <= times else repair(*args)

        return stub

    for times, damped, halvings in ((1, 1, 0), (2, 1, 1), (4, 2, 2)):
        monkeypatch.setattr(module, "repair", failing(times))
        _, report = run(system, phi, fixed, t, 1)
        assert report.status == "ok"
        assert (report.totals["damped"], report.totals["halvings"]) == (damped, halvings)
        assert report.mobile[0] == pytest.approx(phi.sum(), rel=1e-13)
    monkeypatch.setattr(module, "repair", failing(10_000))
    end, report = run(system, phi, fixed, 1024.0, 1)
    assert report.status == "unconverged" and "residual" in report.message
    assert report.totals["halvings"] == HALVINGS and np.array_equal(end.phi[0], phi)


def test_an_isotherm_in_python_is_refused_by_name() -> None:
    cells = resisted(8, 9)
    law = Isotherm("python", function=lambda phi, room: room)
    with pytest.raises(BadInput, match="isotherm in Python"):
        Implicit().prepare(ImplicitConfig(), dyed(cells, law), DyeState(np.zeros((1, *cells.fibre.shape)), np.zeros(1)))
