"""Solvers of dye that take long steps: order, closed forms, bounds, extremes, equal bits."""

from __future__ import annotations

from dataclasses import replace
from math import fsum
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest
from dye_reference import ISOTHERMS, LAWS, dyed, kept, random_cells, resisted, start, step_plainly
from dye_runs import LONG, SECOND, SOLVERS, follow, limit, orders, run

from nuno_dye.solvers import long_steps as module
from nuno_dye.solvers.implicit import HALVINGS
from nuno_dye.solvers.long_steps import split_steps
from nuno_dye.solvers.rkl2 import MOST_STAGES, Rkl2, Rkl2Config, find_coefficients, find_stages
from nuno_dye.solvers.solving import CELLS_PER_THREAD
from nuno_kernels.formula import formula
from nuno_schemas.dye import Cells, Dye, DyeState, DyeSystem, Isotherm, Tortuosity

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
@pytest.mark.parametrize("uptake", ["difference", "amount"])
def test_fibre_takes_dye_with_second_order_up_to_its_limit(
    name: str, kept_up: bool, uptake: Literal["difference", "amount"]
) -> None:
    """A cell by itself: A = S/2 (1 - exp(-2 rho t)), or phi (1 - exp(-rho t)) where phi is kept up; then its limit.
    By the amount: S (1 - exp(-rho t)), or phi rho t.
    """
    closed = Tortuosity(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    cells = Cells(ONES > 0, ONES > 0, 0.5 * ONES, ONES, 0 * ONES, 1.0, closed)
    free, bound = Isotherm("partition", 1e3), Isotherm("langmuir", 1.0)
    phi, rho = 0.3 * ONES, 0.7
    errors = []
    for n in (8, 16, 32, 64):
        dye = Dye("blue", 1.0, rho, free, uptake=uptake)
        system = DyeSystem(cells, (dye,), supply=phi[None] if kept_up else None)
        fixed = run(name, system, phi, 0 * phi, 1.5, n)[0].fixed
        exact = 0.3 * (1.0 - np.exp(-1.5 * rho)) if kept_up else 0.15 * (1.0 - np.exp(-3.0 * rho))
        if uptake == "amount":
            exact = 0.3 * 1.5 * rho if kept_up else 0.3 * (1.0 - np.exp(-1.5 * rho))
        errors.append(float(np.abs(fixed - exact).max()))
    assert errors[-1] < 1e-12 or (orders(errors)[-1] > 1.8 and errors[-1] < 2e-5)
    system = replace(system, dyes=(Dye("blue", 1.0, rho, bound, uptake=uptake),))
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


@formula
class ByArithmetic(NamedTuple):
    """Langmuir's isotherm, which takes eight cells at once."""

    K: float

    def limit(self, phi: float, room: float) -> float:
        return room * (self.K * phi) / (1.0 + self.K * phi)


@formula
class ByCases(NamedTuple):
    """Langmuir's isotherm, which takes one cell after the other."""

    K: float

    def limit(self, phi: float, room: float) -> float:
        return room / (1.0 + 1.0 / (self.K * phi)) if phi > 0.0 else 0.0


@pytest.mark.quick(name=["rkl2"], law=[ByArithmetic])
@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("law", [ByArithmetic, ByCases])
def test_a_formula_fixes_what_the_isotherm_of_its_law_does(name: str, law: type) -> None:
    """To rounding, of dye that spreads, fills cells and is supplied."""
    cells, steps = resisted(15, 17), 300 if name == "explicit" else 6
    ours, own, free = (
        run(name, replace(system, supply=kept(cells)), *start(cells), 270.0 * limit(system), steps)[0]
        for isotherm in (Isotherm("langmuir", 2.0), Isotherm("own", law=law(2.0)), Isotherm("partition", 1e3))
        for system in (dyed(cells, isotherm, adsorption=0.3),)
    )
    assert np.abs(ours.phi - own.phi).max() < 1e-12 and np.abs(ours.fixed - own.fixed).max() < 1e-12
    assert ours.fixed.sum() < 0.9 * free.fixed.sum()


def test_coefficients_sum_to_what_a_constant_rate_needs() -> None:
    """Y' = 1 is solved exactly, and Y' = t in its mean: what the method's order rests on."""
    for s in (3, 7, 31, MOST_STAGES):
        mu, nu, new, old = find_coefficients(s).T
        y = [0.0, float(new[0])]
        for j in range(1, s):
            y.append(mu[j] * y[-1] + nu[j] * y[-2] + new[j] + old[j])
        assert y[-1] == pytest.approx(1.0, rel=1e-10)
        assert find_stages((s * s + s - 2) / 4 * (1 - 1e-12)) == s


@pytest.mark.quick(name=["langmuir"], supplied=[True])
@pytest.mark.parametrize("name", ISOTHERMS)
@pytest.mark.parametrize("supplied", [False, True])
def test_the_explicit_solver_comes_to_it_as_its_steps_shrink(name: str, supplied: bool) -> None:
    """Limits, supply and adsorption all at once; long steps stay close."""
    cells = resisted(15, 17)
    phi, fixed = start(cells)
    system = replace(dyed(cells, LAWS.get(name)), supply=kept(cells) if supplied else None)
    t = 120.0 * limit(system)
    ours, report = run("rkl2", system, phi, fixed, t, 480)
    gaps = [
        max(float(np.abs(getattr(ours, field) - getattr(other, field)).max()) for field in ("phi", "fixed"))
        for other in (follow(system, phi, fixed, t, n) for n in (150, 600, 2400))
    ]
    assert report.status == "ok"
    assert gaps[2] < 1e-3 and gaps[0] > 2.0 * gaps[1] > 4.0 * gaps[2]
    longer, _ = run("rkl2", system, phi, fixed, t, 6)
    assert max(np.abs(longer.phi - ours.phi).max(), np.abs(longer.fixed - ours.fixed).max()) < 0.02


@pytest.mark.quick(name=["langmuir"])
@pytest.mark.parametrize("name", ["partition", "langmuir"])
def test_what_fibre_fixes_while_a_drop_spreads_falls_with_finer_starts(name: str) -> None:
    """A drop put once, one step: fibre keeps what it takes at each place while dye passes."""
    ones = np.ones((2, 30, 30))
    cells = Cells(ones > 0, ones > 0, 0.5 * ones, ones, 0 * ones, 1.0, Tortuosity(1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
    law = Isotherm("partition", 0.5) if name == "partition" else Isotherm("langmuir", 20.0)
    system = DyeSystem(cells, (Dye("blue", 1.0, 0.02, law),))
    y, x = np.mgrid[0:30, 0:30] - 14.5
    phi = np.where(x * x + y * y < 25.0, 0.5, 0.0) * ones
    t = 300.0 * limit(system)
    exact = follow(system, phi, 0 * phi, t, 4800)
    errors = []
    for parts in (1, 4, 16):
        state = DyeState(phi[None].copy(), 0 * phi[None])
        memory = Rkl2().prepare(Rkl2Config(start=parts), system, state)
        Rkl2().advance(system, state, memory, 1, t)
        errors.append(float(np.abs(state.fixed - exact.fixed).sum() / exact.fixed.sum()))
    assert errors[0] > 3.0 * errors[1] and errors[1] > 2.0 * errors[2] and errors[2] < 2e-3


def test_steps_grow_with_the_time_since_amounts_jumped() -> None:
    shares = split_steps(0, 6, 1000.0, 4)
    ends = np.cumsum(shares)
    assert ends[-1] == pytest.approx(6.0, rel=1e-12) and shares[0] * 1000.0 <= 0.25
    assert np.all(shares[4:] <= 0.25 * ends[3:-1] * (1.0 + 1e-12)), "from the first explicit step on"
    assert np.array_equal(np.concatenate([split_steps(n, 1, 1000.0, 4) for n in range(6)]), shares)


def test_a_step_that_fails_is_said_and_leaves_what_was_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first of 16 parts succeed: what they gave and what cells hold belong together."""
    cells = resisted(8, 9)
    phi, fixed = start(cells)
    mend, calls = module.repair, iter(range(1000))
    monkeypatch.setattr(module, "repair", lambda *args: 1 if next(calls) >= 16 else mend(*args))
    system = replace(dyed(cells, None), supply=kept(cells))
    end, report = run("rkl2", system, phi, fixed, 1024.0, 1)
    assert report.status == "unconverged" and "beyond capacity" in report.message
    assert report.supplied[0] > 0.0 and not np.array_equal(end.phi[0], phi)
    assert report.mobile[0] == pytest.approx(phi.sum() + report.supplied[0], rel=1e-13)


SCHEMES = {"sdirk2": 2, "backward_euler": 1}


@pytest.mark.quick(name=["langmuir"], supplied=[True])
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
        ours, report = run("backward_euler", system, phi, fixed, t, steps)
        assert report.status == "ok" and report.totals["halvings"] == 0
        gaps.append(max(float(np.abs(getattr(ours, one) - getattr(other, one)).max()) for one in ("phi", "fixed")))
    assert gaps[2] < 1e-3 and gaps[0] > 2.0 * gaps[1] > 4.0 * gaps[2]
    second, _ = run("sdirk2", system, phi, fixed, t, 384)
    assert max(np.abs(second.phi - other.phi).max(), np.abs(second.fixed - other.fixed).max()) < 2e-3


@pytest.mark.quick(name=["langmuir"])
@pytest.mark.parametrize("name", LAWS)
def test_long_steps_are_accurate_beside_a_kept_up_drop(name: str) -> None:
    """As in the dye paper's figure 9, smaller: 50 steps for 4,000 explicit ones."""
    ones = np.ones((2, 32, 32))
    cells = Cells(ones > 0, ones > 0, 0.5 * ones, ones, 0 * ones, 1.0, Tortuosity(1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
    y, x = np.indices((32, 32)) - 15.5
    supply = np.broadcast_to(0.5 * (x**2 + y**2 < 25.0), (1, *ones.shape))
    system = replace(dyed(cells, LAWS[name], adsorption=0.01), supply=supply)
    phi, t = 1.0 * supply[0], 3600.0 * limit(system)
    other, (ours, _) = follow(system, phi, 0 * phi, t, 4000), run("sdirk2", system, phi, 0 * phi, t, 50)
    assert max(np.abs(ours.phi - other.phi).max(), np.abs(ours.fixed - other.fixed).max()) < 1e-3 * 0.5


def test_a_step_that_fails_is_damped_then_halved_and_then_said(monkeypatch: pytest.MonkeyPatch) -> None:
    cells = resisted(8, 9)
    phi, fixed = start(cells)
    # Kept up to nothing: as without, by kernels that others of these tests compile.
    system, calls, repair = replace(dyed(cells, LAWS["langmuir"]), supply=0 * phi[None]), [0], module.repair
    t = 30.0 * limit(system)

    def failing(times: int) -> Any:
        calls[0] = 0

        def stub(*args: Any) -> int:
            calls[0] += 1
            return 1 if calls[0] <= times else repair(*args)

        return stub

    for times, damped, halvings in ((1, 1, 0), (2, 1, 1), (4, 2, 2)):
        monkeypatch.setattr(module, "repair", failing(times))
        _, report = run("sdirk2", system, phi, fixed, t, 1)
        assert report.status == "ok"
        assert (report.totals["damped"], report.totals["halvings"]) == (damped, halvings)
        assert report.mobile[0] + report.fixed[0] == pytest.approx(phi.sum() + fixed.sum(), rel=1e-13)
    monkeypatch.setattr(module, "repair", failing(10_000))
    end, report = run("sdirk2", system, phi, fixed, 1024.0, 1)
    assert report.status == "unconverged" and "residual" in report.message
    assert report.totals["halvings"] == HALVINGS
    assert np.array_equal(end.phi[0], phi) and np.array_equal(end.fixed[0], fixed)
