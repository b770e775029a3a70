"""Supplies that are kept up: the plain loop's amounts, every share of dye accounted for, changed while it runs."""

from __future__ import annotations

from dataclasses import replace
from math import fsum

import numpy as np
import pytest
from dye_reference import CONFIG, D0, ISOTHERMS, LAWS, dyed, kept, plain_step, random_cells, resisted, start

from nuno_dye.laws.faces import face_values, largest_sum
from nuno_dye.solvers.explicit import Explicit
from nuno_dye.solvers.solving import CELLS_PER_THREAD
from nuno_schemas.dye import Cells, Dye, DyeReport, DyeState, DyeSystem
from nuno_schemas.fabric import Float, Memory

Frame = tuple[DyeSystem, int]


def roomy(ny: int, nx: int) -> Cells:
    """Cells that diffusion alone cannot fill."""
    return replace(random_cells(ny, nx), v_max=1e3)


def run(state: DyeState, frames: list[Frame], memory: Memory | None = None) -> list[DyeReport]:
    solver, first = Explicit(), frames[0][0]
    memory = memory or solver.prepare(CONFIG, first, state)
    return [solver.advance(system, state, memory, steps, 0.9 * solver.limit(CONFIG, first)) for system, steps in frames]


def begun(phi: Float, fixed: Float) -> DyeState:
    return DyeState(phi[None].copy(), fixed[None].copy())


@pytest.mark.parametrize("name", [*ISOTHERMS, "alone"])
def test_equals_a_plain_loop(name: str) -> None:
    cells = roomy(9, 11) if name == "alone" else resisted(9, 11)
    phi, fixed = (0.1 * x for x in start(resisted(9, 11)))
    supply = 1e-3 * kept(cells) if name == "alone" else kept(cells)
    state = begun(phi, fixed)
    system = replace(dyed(cells, LAWS.get(name)), supply=supply)
    reports = run(state, [(system, 5), (system, 8)])
    scale, given = 0.9 / largest_sum(face_values(cells)), []
    for _ in range(13):
        phi, fixed = plain_step(phi, fixed, cells, scale, 0.06 * scale, "nothing" if name == "alone" else name)
        given.append(np.maximum(supply[0] - phi, 0.0).sum())
        phi = np.maximum(phi, supply[0])
    assert np.abs(state.phi[0] - phi).max() < 1e-12 and np.abs(state.fixed[0] - fixed).max() < 1e-12
    assert [r.supplied[0] for r in reports] == pytest.approx([sum(given[:5]), sum(given[5:])], rel=1e-11)
    assert len([share for share in given if share > 0.0]) == 13


@pytest.mark.parametrize("name", [*ISOTHERMS, "alone"])
def test_every_share_of_dye_is_accounted_for(name: str) -> None:
    cells, steps = (roomy(40, 37) if name == "alone" else resisted(40, 37)), 2000
    phi, fixed = (1e-3 * x if name == "alone" else x for x in start(cells))
    system = replace(dyed(cells, LAWS.get(name)), supply=kept(cells, 1e-3 if name == "alone" else 0.9))
    state = begun(phi, fixed)
    reports = run(state, [(system, steps // 4)] * 4)
    total = fsum(phi.reshape(-1)) + fsum(r.supplied[0] for r in reports)
    assert abs(reports[-1].mobile[0] + reports[-1].fixed[0] - total) <= 1e-13 * np.sqrt(steps) * total
    assert all(report.supplied[0] > 0.0 for report in reports)
    assert (state.phi >= system.supply).all() and (state.phi[0] <= cells.mobile_room).all()


@pytest.mark.parametrize("law", [None, "langmuir"])
def test_frames_and_threads_change_no_bit(law: str | None) -> None:
    side = int(CELLS_PER_THREAD**0.5) + 1
    cells = resisted(side, side) if law else roomy(side, side)
    phi, fixed = (1e-3 * x for x in start(cells))
    one = replace(dyed(cells, LAWS.get(law or "")), supply=kept(cells, 1e-3))
    whole, two, cut = (begun(phi, fixed) for _ in range(3))
    reports = run(whole, [(one, 24)]), run(two, [(replace(one, threads=2), 24)])
    run(cut, [(one, 7), (one, 1), (one, 16)])
    assert reports[0] == reports[1]
    for state in (two, cut):
        assert np.array_equal(state.phi, whole.phi) and np.array_equal(state.fixed, whole.fixed)


def test_nothing_kept_up_changes_no_bit_and_gives_nothing() -> None:
    cells = resisted(12, 13)
    without, with_none = (begun(*start(cells)) for _ in range(2))
    system = dyed(cells, LAWS["partition"])
    plain = run(without, [(system, 9)])
    empty = run(with_none, [(replace(system, supply=np.zeros((1, *cells.fibre.shape))), 9)])
    assert np.array_equal(without.phi, with_none.phi)
    assert plain[0].supplied == () and empty[0].supplied == (0.0,)


def test_only_the_dye_that_is_kept_up_is_given() -> None:
    cells = resisted(12, 13)
    supply = np.concatenate([0.0 * kept(cells), kept(cells)])
    system = DyeSystem(cells, (Dye("blue", D0), Dye("red", 0.4 * D0)), supply=supply)
    state = DyeState(np.zeros_like(supply), np.zeros_like(supply))
    (report,) = run(state, [(system, 6)])
    assert report.supplied[0] == 0.0 and not state.phi[0].any()
    assert report.supplied[1] == pytest.approx(report.mobile[1], rel=1e-13) and report.mobile[1] > 0.0


def test_a_floor_above_the_room_fills_the_cell_and_no_more() -> None:
    cells = resisted(12, 13)
    full, more = (begun(*start(cells)) for _ in range(2))
    system = dyed(cells, None)
    run(full, [(replace(system, supply=np.broadcast_to(cells.mobile_room, (1, *cells.fibre.shape))), 5)])
    run(more, [(replace(system, supply=np.ones((1, *cells.fibre.shape))), 5)])
    assert np.array_equal(full.phi, more.phi) and np.array_equal(full.phi[0], cells.mobile_room)


def test_supply_and_resist_may_change_between_frames_and_a_resumed_run_has_the_same_bits() -> None:
    """What is remembered of other arrays is not used; the kernel is chosen by the largest amount so far."""
    cells = roomy(20, 23)
    phi, fixed = (1e-3 * x for x in start(cells))
    system = dyed(cells, None)
    low, high = (replace(system, supply=kept(cells, share)) for share in (1e-3, 0.99))
    pasted = replace(cells, resist=np.where(np.indices(cells.fibre.shape)[2] > 12, 1.0, 0.0))
    frames = [(low, 5), (system, 5), (high, 6), (replace(system, cells=pasted), 7), (replace(low, cells=pasted), 3)]
    whole, parts, solver = begun(phi, fixed), begun(phi, fixed), Explicit()
    run(whole, frames)
    memory = solver.prepare(CONFIG, system, parts)
    highest = []
    for one, steps in frames:
        fresh = solver.prepare(CONFIG, one, DyeState(0 * parts.phi, 0 * parts.fixed))
        np.copyto(fresh.arrays["highest"], memory.arrays["highest"])
        memory = fresh
        solver.advance(one, parts, memory, steps, 0.9 * solver.limit(CONFIG, low))
        highest.append(memory.arrays["highest"][0])
    assert np.array_equal(parts.phi, whole.phi)
    assert highest == [max(phi.max(), kept(cells, 1e-3).max())] * 2 + [kept(cells, 0.99).max()] * 3
