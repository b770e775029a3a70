"""Implicit steps of dye: their order, closed forms, the explicit solver's limits, dye kept whatever the step."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dye_reference import ISOTHERMS, LAWS, dyed, kept, resisted, start
from dye_runs import follow, limit, run

from nuno_dye.solvers import long_steps as module
from nuno_dye.solvers.implicit import HALVINGS
from nuno_schemas.dye import Cells, Tortuosity

ONES = np.ones((2, 3, 3))
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
