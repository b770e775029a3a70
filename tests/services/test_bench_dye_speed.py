"""What the speed of dye is measured on: the cases are what they are called."""

from __future__ import annotations

import numpy as np
import pytest

from nuno.plugin_contract import registry
from nuno_bench.speed import steps as dye_speed
from nuno_schemas.dye import DyeReport, DyeState, DyeSystem

STEPS = 25


def explicit(system: DyeSystem, state: DyeState, steps: int) -> DyeReport:
    """The report of so many steps by our solver."""
    plugin = registry.load("nuno.dye_solvers", "explicit")
    config = plugin.Config()
    dt = dye_speed.DYE_SHARE * plugin.limit(config, system)
    report: DyeReport = plugin.advance(system, state, plugin.prepare(config, system, state), steps, dt)
    return report


def test_the_whole_model_fixes_dye_and_is_limited() -> None:
    system, state = dye_speed.whole_model(40, 44)
    start = state.phi.sum()
    report = explicit(system, state, STEPS)
    assert report.fixed[0] > 0.0 and report.mobile[0] + report.fixed[0] == pytest.approx(start, rel=1e-13)
    room = system.cells.mobile_room
    assert (state.phi[0] <= room).all() and (state.phi[0] > 0.999 * room)[system.cells.resist > 0.0].any()


@pytest.mark.parametrize("law", dye_speed.LAWS)
def test_figure_9_is_a_drop_that_is_kept_up_in_woven_yarns(law: str) -> None:
    system, state = dye_speed.figure_9(law)
    assert system.supply is not None and system.cells.fibre.shape == (2, 200, 200)
    assert system.cells.fibre.mean() == pytest.approx(0.8, abs=0.01)
    full = system.supply[0] > 0.0
    assert full[0].sum() == pytest.approx(np.pi * 15.0**2, rel=0.02)
    start = state.phi.sum()
    report = explicit(system, state, STEPS)
    assert np.array_equal(state.phi[0][full], system.supply[0][full])
    assert report.supplied[0] > 0.0 and report.fixed[0] > 0.0
    assert report.mobile[0] + report.fixed[0] == pytest.approx(start + report.supplied[0], rel=1e-12)
