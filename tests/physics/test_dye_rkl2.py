"""Super-time-stepping of dye: its order, closed forms, the explicit solver's limits, dye kept whatever the step."""

from __future__ import annotations

from dataclasses import replace
from math import fsum

import numpy as np
import pytest
from test_dye_diffusion import random_cells, step_plainly
from test_dye_explicit import LAWS, dyed
from test_dye_step import ISOTHERMS, resisted, start
from test_dye_upkeep import kept

from nuno_dye import rkl2 as module
from nuno_dye.explicit import Explicit, ExplicitConfig
from nuno_dye.legendre import find_coefficients, find_stages
from nuno_dye.rkl2 import MOST_STAGES, Rkl2, Rkl2Config
from nuno_dye.solving import CELLS_PER_THREAD
from nuno_schemas.dye import Cells, Dye, DyeReport, DyeState, DyeSystem, Isotherm, Tortuosity
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

CONFIG = Rkl2Config()
ONES = np.ones((2, 3, 3))


def run(
    system: DyeSystem, phi: Float, fixed: Float, t: float, steps: int, frames: int = 1
) -> tuple[DyeState, DyeReport]:
    """`steps` steps in each of some frames, to `t` [s]; the report's totals are of all."""
    solver, state = Rkl2(), DyeState(phi[None].copy(), fixed[None].copy())
    memory = solver.prepare(CONFIG, system, state)
    reports = [solver.advance(system, state, memory, steps, t / (steps * frames)) for _ in range(frames)]
    given = (fsum(r.supplied[0] for r in reports),) if reports[0].supplied else ()
    return state, replace(reports[-1], supplied=given)


def follow(system: DyeSystem, phi: Float, fixed: Float, t: float, steps: int) -> DyeState:
    """The explicit solver's amounts."""
    solver, state = Explicit(), DyeState(phi[None].copy(), fixed[None].copy())
    memory = solver.prepare(ExplicitConfig(), system, state)
    solver.advance(system, state, memory, steps, t / steps)
    return state


def limit(system: DyeSystem) -> float:
    return Explicit().limit(ExplicitConfig(), system)


def orders(errors: list[float]) -> Float:
    found: Float = np.log2(np.array(errors[:-1]) / errors[1:])
    return found


def test_diffusion_is_of_second_order() -> None:
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
        float(np.abs(run(system, phi, 0 * phi, t, n)[0].phi.reshape(-1) - exact).max()) for n in (20, 40, 80, 160)
    ]
    assert orders(errors)[-1] == pytest.approx(2.0, abs=0.15) and errors[-1] < 2e-6


def test_coefficients_sum_to_what_a_constant_rate_needs() -> None:
    """Y' = 1 is solved exactly, and Y' = t in its mean: what the method's order rests on."""
    for s in (3, 7, 31, MOST_STAGES):
        mu, nu, new, old = find_coefficients(s).T
        y = [0.0, float(new[0])]
        for j in range(1, s):
            y.append(mu[j] * y[-1] + nu[j] * y[-2] + new[j] + old[j])
        assert y[-1] == pytest.approx(1.0, rel=1e-10)
        assert find_stages((s * s + s - 2) / 4 * (1 - 1e-12)) == s


def test_a_point_spreads_as_the_closed_form_says() -> None:
    n, errors = 121, []
    open_cloth = Tortuosity(layers=0.0, beside=0.25, rim=1.0, gap=1.0, yarn=1.0, weave=1.0)
    ones = np.ones((2, n, n))
    system = DyeSystem(Cells(ones > 0, ones > 0, ones, ones, 0 * ones, 1.0, open_cloth, 10.0), (Dye("blue", 1.0),))
    phi, place = np.zeros((2, n, n)), np.arange(n) - n // 2
    phi[:, n // 2, n // 2] = 1.0
    for t in (20.0, 80.0):
        end, _ = run(system, phi, 0 * phi, t, 20)
        fast, slow = (np.exp(-(place**2) / (4.0 * d * t)) / np.sqrt(4.0 * np.pi * d * t) for d in (1.0, 0.25))
        exact = np.stack([slow[:, None] * fast, fast[:, None] * slow])
        errors.append(np.abs(end.phi[0] - exact).max() / exact.max())
    assert errors[1] < 0.01 and errors[0] / errors[1] > 3.0


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
        end, report = run(system, 0 * ones, 0 * ones, t, 30)
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
def test_the_explicit_solver_comes_to_it_as_its_steps_shrink(name: str, supplied: bool) -> None:
    """Limits, supply and adsorption all at once; long steps stay close."""
    cells = resisted(15, 17)
    phi, fixed = start(cells)
    system = replace(dyed(cells, LAWS.get(name)), supply=kept(cells) if supplied else None)
    t = 120.0 * limit(system)
    ours, report = run(system, phi, fixed, t, 480)
    gaps = [
        max(float(np.abs(getattr(ours, field) - getattr(other, field)).max()) for field in ("phi", "fixed"))
        for other in (follow(system, phi, fixed, t, n) for n in (150, 600, 2400))
    ]
    assert report.status == "ok"
    assert gaps[2] < 1e-3 and gaps[0] > 2.0 * gaps[1] > 4.0 * gaps[2]
    longer, _ = run(system, phi, fixed, t, 6)
    assert max(np.abs(longer.phi - ours.phi).max(), np.abs(longer.fixed - ours.fixed).max()) < 0.02


@pytest.mark.parametrize("name", ISOTHERMS)
@pytest.mark.parametrize("supplied", [False, True])
@pytest.mark.parametrize("steps", [400, 7])
def test_dye_is_kept_and_no_cell_holds_less_than_none_or_more_than_it_can(
    name: str, supplied: bool, steps: int
) -> None:
    cells = resisted(31, 37)
    phi, fixed = start(cells)
    system = replace(dyed(cells, LAWS.get(name), adsorption=0.3), supply=kept(cells, 0.8) if supplied else None)
    end, report = run(system, phi, fixed, 2000.0 * limit(system), steps)
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
def test_frames_threads_and_a_resumed_run_change_no_bit(law: str | None) -> None:
    side = int(CELLS_PER_THREAD**0.5) + 1
    cells = resisted(side, side)
    phi, fixed = start(cells)
    one = replace(dyed(cells, LAWS.get(law or "")), supply=kept(cells))
    t = 60.0 * limit(one)
    whole, _ = run(one, phi, fixed, t, 6)
    parts, _ = run(one, phi, fixed, t, 2, 3)
    two, _ = run(replace(one, threads=2), phi, fixed, t, 6)
    solver, resumed = Rkl2(), DyeState(phi[None].copy(), fixed[None].copy())
    memory = solver.prepare(CONFIG, one, resumed)
    for _ in range(3):
        fresh = solver.prepare(CONFIG, one, DyeState(0 * resumed.phi, 0 * resumed.fixed))
        for name, values in memory.arrays.items():
            np.copyto(fresh.arrays[name], values)
        memory = fresh
        solver.advance(one, resumed, memory, 2, t / 6)
    for state in (parts, two, resumed):
        assert np.array_equal(state.phi, whole.phi) and np.array_equal(state.fixed, whole.fixed)


def test_a_step_that_fails_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    cells = resisted(8, 9)
    phi, fixed = start(cells)
    monkeypatch.setattr(module, "repair", lambda *args: 1)
    _, report = run(dyed(cells, None), phi, fixed, 1024.0, 1)
    assert report.status == "unconverged" and "beyond capacity" in report.message
    assert report.mobile[0] == pytest.approx(phi.sum(), rel=1e-14)


def test_an_isotherm_in_python_is_refused_by_name() -> None:
    cells = resisted(8, 9)
    law = Isotherm("python", function=lambda phi, room: room)
    with pytest.raises(BadInput, match="isotherm in Python"):
        Rkl2().prepare(CONFIG, dyed(cells, law), DyeState(np.zeros((1, *cells.fibre.shape)), np.zeros(1)))
