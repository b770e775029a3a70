"""What the speed of dye is measured on: peers take our steps, and the cases are what they are called."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
import pytest

from nuno import registry
from nuno_bench.speed import dye as dye_speed
from nuno_bench.speed.dye_peers import SlicedDiffusion, devito_diffusion, weigh_faces
from nuno_bench.validation.laws.dye import D0, SIZE
from nuno_schemas.dye import DyeReport, DyeState, DyeSystem
from nuno_schemas.fabric import Float

STEPS = 25


def explicit(system: DyeSystem, state: DyeState, steps: int) -> tuple[DyeReport, float]:
    """The report of so many steps by our solver, and D0 dt / size^2."""
    plugin = registry.load("nuno.dye_solvers", "explicit")
    config = plugin.Config()
    dt = dye_speed.SHARE * plugin.limit(config, system)
    return plugin.advance(system, state, plugin.prepare(config, system, state), steps, dt), D0 * dt / SIZE**2


def check_peer(make: Callable[[DyeSystem, float], Callable[[Float, int], None]], steps: int) -> None:
    system, state = dye_speed.free_diffusion(18, 23)
    phi, before = state.phi[0].copy(), state.phi.copy()
    _, scale = explicit(system, state, steps)
    make(system, scale)(phi, steps)
    assert np.abs(state.phi - before).max() > 0.05
    assert np.abs(phi - state.phi[0]).max() < 1e-14


def test_numpy_takes_our_steps() -> None:
    check_peer(lambda system, scale: SlicedDiffusion(system.cells, scale).advance, STEPS)


# Devito asks for an older NumPy than ours, so that no extra of ours may install it: it is tested where somebody has it.
if find_spec("devito"):

    @pytest.mark.parametrize("steps", [STEPS, STEPS + 1])
    def test_devito_takes_our_steps(steps: int) -> None:
        def make(system: DyeSystem, scale: float) -> Callable[[Float, int], None]:
            advance = devito_diffusion(system.cells, scale, 1)
            assert advance is not None
            return advance

        check_peer(make, steps)


def test_weights_of_the_peers_add_up_to_the_stated_limit() -> None:
    system, _ = dye_speed.free_diffusion(18, 23)
    along, down, across = weigh_faces(system.cells, 1.0)
    total = along + down + across
    total[:, :, 1:] += along[:, :, :-1]
    total[:, 1:] += down[:, :-1]
    plugin = registry.load("nuno.dye_solvers", "explicit")
    limit = plugin.limit(plugin.Config(), system)
    assert D0 * limit / SIZE**2 * total.max() == pytest.approx(1.0, rel=1e-12)


def test_the_whole_model_fixes_dye_and_is_limited() -> None:
    system, state = dye_speed.whole_model(40, 44)
    start = state.phi.sum()
    report, _ = explicit(system, state, STEPS)
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
    report, _ = explicit(system, state, STEPS)
    assert np.array_equal(state.phi[0][full], system.supply[0][full])
    assert report.supplied[0] > 0.0 and report.fixed[0] > 0.0
    assert report.mobile[0] + report.fixed[0] == pytest.approx(start + report.supplied[0], rel=1e-12)


def test_rates_are_cells_times_steps_over_time(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[int] = []
    monkeypatch.setattr(dye_speed, "WORK", 8_000)
    monkeypatch.setattr(dye_speed, "seconds", lambda call: call() or 0.5)
    found = dye_speed.time_peer(lambda phi, steps: taken.append(steps), np.zeros((2, 4, 5)), 3, "peer", "")
    assert taken == [1, 20, 20, 20] and found.samples == (40 * 20 / 0.5 * 1e-9,) * 3 and found.unit == dye_speed.UNIT
