"""Super-time-stepping of dye: its order, closed forms, the explicit solver's limits, dye kept whatever the step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dye_reference import ISOTHERMS, LAWS, dyed, kept, resisted, start
from dye_runs import follow, limit, run

from nuno_dye.solvers import long_steps as module
from nuno_dye.solvers.long_steps import split_steps
from nuno_dye.solvers.rkl2 import MOST_STAGES, Rkl2, Rkl2Config, find_coefficients, find_stages
from nuno_schemas.dye import Cells, Dye, DyeState, DyeSystem, Isotherm, Tortuosity


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
