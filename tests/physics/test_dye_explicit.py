"""Explicit diffusion and dyeing in woven cloth: a plain loop's amounts, limits, kept up supplies, equal bits."""

from __future__ import annotations

from dataclasses import replace
from math import fsum

import numpy as np
import pytest
from dye_reference import (
    CONFIG,
    D0,
    ISOTHERMS,
    LAWS,
    dyed,
    kept,
    plain_step,
    random_cells,
    resisted,
    spread,
    start,
    step_plainly,
)

from nuno_dye.laws.adsorption import Uptake
from nuno_dye.laws.diffusivity import face_values, largest_sum
from nuno_dye.laws.isotherms import Freundlich, FreundlichConfig, Partition, PartitionConfig
from nuno_dye.solvers.bands import Cut, make_dye_bands, read_bands
from nuno_dye.solvers.diffusion import GHOST
from nuno_dye.solvers.dyeing import LEVELS, dye
from nuno_dye.solvers.explicit import Explicit
from nuno_dye.solvers.solving import CELLS_PER_THREAD, sum_compensated
from nuno_schemas.dye import Cells, Dye, DyeReport, DyeState, DyeSystem
from nuno_schemas.fabric import Float, Memory


def test_equals_a_plain_loop() -> None:
    cells = random_cells(9, 13)
    phi = np.random.default_rng(5).random(cells.fibre.shape)
    faces = face_values(cells)
    scale = 0.9 / largest_sum(faces)
    exact, steps = phi, GHOST + 3
    for _ in range(steps):
        exact = step_plainly(exact, cells, scale)
    assert np.abs(spread(phi, faces, scale, steps) - exact).max() < 1e-14 * steps


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (GHOST, 7), (3 * GHOST + 1, 17), (61, 64)])
def test_bands_and_passes_change_no_bit(shape: tuple[int, int]) -> None:
    cells = random_cells(*shape)
    phi = np.random.default_rng(7).random(cells.fibre.shape)
    faces = face_values(cells)
    scale = 0.9 / max(largest_sum(faces), 1e-9)
    whole = spread(phi, faces, scale, 2 * GHOST + 5)
    for bands in (2, 3, 5):
        assert np.array_equal(spread(phi, faces, scale, 2 * GHOST + 5, bands), whole)
    bit_by_bit = phi
    for _ in range(2 * GHOST + 5):
        bit_by_bit = spread(bit_by_bit, faces, scale, 1)
    assert np.array_equal(bit_by_bit, whole)


def run(
    phi: Float,
    fixed: Float,
    cells: Cells,
    scale: float,
    rate: float,
    isotherm: str,
    steps: int,
    bands: int = 1,
    steepest: float = 1.0,
    back: float = 1.0,
) -> tuple[Float, Float]:
    packed = make_dye_bands(phi, cells, face_values(cells), scale, bands, steepest)
    law = ISOTHERMS[isotherm]
    bound, fibre = Cut(phi.shape, bands, 2 * LEVELS).fill(fixed, cells.fixed_room)
    uptake = None if law is None else Uptake(bound, fibre, law, rate, back)
    dye(steps, packed, uptake, None, None, np.zeros(1, np.int64))
    return read_bands(packed, packed.phi, np.empty_like(phi)), read_bands(packed, bound, np.empty_like(phi))


@pytest.mark.parametrize("back", [1.0, 0.0])
@pytest.mark.parametrize("isotherm", ISOTHERMS)
def test_dye_step_equals_a_plain_loop(isotherm: str, back: float) -> None:
    cells = resisted(11, 14)
    phi, fixed = start(cells)
    scale, steps = 0.95 / largest_sum(face_values(cells)), 2 * LEVELS + 2
    exact = phi, fixed
    for _ in range(steps):
        exact = plain_step(*exact, cells, scale, 0.05, isotherm, back)
    found = run(phi, fixed, cells, scale, 0.05, isotherm, steps, back=back)
    for a, b in zip(found, exact, strict=True):
        assert np.abs(a - b).max() < 1e-12
    assert (exact[1].max() > 0.0) == (isotherm != "nothing")


def test_fibre_takes_no_more_than_there_is_however_fast_it_takes() -> None:
    """At a rate of 5, fibre with room would take five times the mobile dye; none is lost, and no cell owes any."""
    cells = replace(resisted(11, 14), v_max=10.0)
    phi, fixed = start(cells)
    scale = 0.95 / largest_sum(face_values(cells))
    found = run(phi, fixed, cells, scale, 5.0, "langmuir", LEVELS)
    exact = phi, fixed
    for _ in range(LEVELS):
        exact = plain_step(*exact, cells, scale, 5.0, "langmuir")
    assert found[0].min() >= 0.0 and found[1].max() > 0.0
    assert found[0].sum() + found[1].sum() == pytest.approx(phi.sum(), rel=1e-13)
    for a, b in zip(found, exact, strict=True):
        assert np.abs(a - b).max() < 1e-12


def test_without_a_limit_that_binds_it_is_diffusion_to_the_last_bit() -> None:
    cells = replace(random_cells(23, 30), v_max=1e6)
    phi = np.random.default_rng(5).random(cells.fibre.shape) * (cells.porosity > 0.0)
    fixed = np.zeros_like(phi)
    faces = face_values(cells)
    scale = 0.9 / largest_sum(faces)
    assert np.array_equal(run(phi, fixed, cells, scale, 0.0, "nothing", 20)[0], spread(phi, faces, scale, 20))
    assert np.abs(spread(phi, faces, scale, 1) - step_plainly(phi, cells, scale)).max() < 1e-14


def test_what_cannot_empty_a_cell_has_the_bits_of_what_could() -> None:
    """Factors of what flows out are 1 where they are not asked for."""
    cells = resisted(23, 30)
    phi, fixed = start(cells)
    scale = 0.98 / largest_sum(face_values(cells))
    asked, not_asked = (run(phi, fixed, cells, scale, 0.05, "langmuir", 50, steepest=most) for most in (2.0, 1.0))
    assert all(map(np.array_equal, asked, not_asked))


@pytest.mark.parametrize("isotherm", ["partition", "langmuir"])
def test_dye_step_bands_and_passes_change_no_bit(isotherm: str) -> None:
    cells = resisted(47, 33)
    phi, fixed = start(cells)
    scale, steps = 0.95 / largest_sum(face_values(cells)), 3 * LEVELS + 1
    whole = run(phi, fixed, cells, scale, 0.02, isotherm, steps)
    singly = phi, fixed
    for _ in range(steps):
        singly = run(*singly, cells, scale, 0.02, isotherm, 1)
    for other in (*(run(phi, fixed, cells, scale, 0.02, isotherm, steps, n) for n in (2, 3, 5)), singly):
        assert all(map(np.array_equal, other, whole))


@pytest.mark.parametrize("isotherm", ISOTHERMS)
def test_dye_is_kept_and_no_cell_holds_less_than_none_or_more_than_it_can(isotherm: str) -> None:
    cells, steps = resisted(40, 37), 3000
    phi, fixed = start(cells)
    mobile, bound = run(phi, fixed, cells, 1.0 / largest_sum(face_values(cells)), 0.03, isotherm, steps, 2)
    assert abs(mobile.sum() + bound.sum() - phi.sum()) <= 1e-13 * np.sqrt(steps) * phi.sum()
    assert mobile.min() >= 0.0 and bound.min() >= 0.0
    assert (mobile <= cells.mobile_room).all() and (bound <= cells.fixed_room).all()


def advance(
    system: DyeSystem, phi: Float, fixed: Float, steps: int, frames: int = 1
) -> tuple[DyeState, list[DyeReport]]:
    """Frames of steps at 0.9 of the limit."""
    solver, state = Explicit(), DyeState(phi[None].copy(), fixed[None].copy())
    memory = solver.prepare(CONFIG, system, state)
    dt = 0.9 * solver.limit(CONFIG, system)
    return state, [solver.advance(system, state, memory, steps, dt) for _ in range(frames)]


@pytest.mark.parametrize("name", ISOTHERMS)
def test_dye_explicit_equals_a_plain_loop(name: str) -> None:
    cells = resisted(9, 11)
    phi, fixed = start(cells)
    state, reports = advance(dyed(cells, LAWS.get(name)), phi, fixed, 4, 3)
    scale = 0.9 / largest_sum(face_values(cells))
    exact = phi, fixed
    for _ in range(12):
        exact = plain_step(*exact, cells, scale, 0.06 * scale, name)
    assert np.abs(state.phi[0] - exact[0]).max() < 1e-12
    assert np.abs(state.fixed[0] - exact[1]).max() < 1e-12
    assert sum(report.steps for report in reports) == 12


def test_the_limit_is_where_the_weights_of_some_cell_add_to_one() -> None:
    cells = random_cells(12, 15)
    limit = Explicit().limit(CONFIG, dyed(cells, None))
    assert limit * D0 / cells.size**2 * largest_sum(face_values(cells)) == pytest.approx(1.0, rel=1e-14)
    closed = replace(cells, porosity=np.zeros_like(cells.porosity))
    assert Explicit().limit(CONFIG, dyed(closed, None)) == np.inf


@pytest.mark.parametrize("law", [None, *LAWS])
@pytest.mark.parametrize("threads", [1, 2])
def test_where_nothing_can_be_limited_the_faster_kernel_has_the_bits_of_the_whole_step(
    law: str | None, threads: int
) -> None:
    """From a full cell beside an empty one, too; kept up or not."""
    side = int(CELLS_PER_THREAD**0.5) + 1
    cells = replace(random_cells(side, side), v_max=1e3)
    rng = np.random.default_rng(5)
    phi = rng.random(cells.fibre.shape) * (cells.porosity > 0.0)
    supply = 0.5 * (phi * (rng.random(phi.shape) > 0.9))[None]
    for system in (dyed(cells, LAWS.get(law or ""), threads), replace(dyed(cells, None, threads), supply=supply)):
        solver, states = Explicit(), [DyeState(phi[None].copy(), 0 * phi[None]) for _ in range(2)]
        memory = [solver.prepare(CONFIG, system, state) for state in states]
        assert memory[0].arrays["highest"][0] <= memory[0].work.derived.room  # type: ignore[attr-defined]
        memory[1].arrays["highest"][0] = np.inf
        dt = solver.limit(CONFIG, system)
        plain, whole = (solver.advance(system, *pair, 20, 0.9 * dt) for pair in zip(states, memory, strict=True))
        assert plain == whole and (plain.fixed[0] > 0.0) == (law is not None and system.supply is None)
        assert np.array_equal(states[0].phi, states[1].phi) and np.array_equal(states[0].fixed, states[1].fixed)


def test_freundlich_with_the_exponent_1_is_partition() -> None:
    cells = resisted(9, 11)
    laws = (Partition().prepare(PartitionConfig(k=0.7)), Freundlich().prepare(FreundlichConfig(k=0.7, b=1)))
    ours, other = (advance(dyed(cells, law), *start(cells), 7)[0] for law in laws)
    assert np.array_equal(ours.phi, other.phi) and np.array_equal(ours.fixed, other.fixed)


def test_dyes_do_not_act_on_each_other() -> None:
    cells = resisted(9, 11)
    phi, fixed = start(cells)
    dyes = (Dye("blue", D0, 0.06, LAWS["langmuir"]), Dye("red", 0.4 * D0))
    state, solver = DyeState(np.stack([phi, 0.5 * phi]), np.stack([fixed, fixed])), Explicit()
    memory = solver.prepare(CONFIG, DyeSystem(cells, dyes), state)
    solver.advance(DyeSystem(cells, dyes), state, memory, 6, 1.0)
    for k, (one, amount) in enumerate(zip(dyes, (phi, 0.5 * phi), strict=True)):
        system, alone = DyeSystem(cells, (one,)), DyeState(amount[None].copy(), fixed[None].copy())
        solver.advance(system, alone, solver.prepare(CONFIG, system, alone), 6, 1.0)
        assert np.array_equal(state.phi[k], alone.phi[0]) and np.array_equal(state.fixed[k], alone.fixed[0])
    assert not state.fixed[1].any()


def test_a_compensated_sum_is_exact_to_rounding() -> None:
    rng = np.random.default_rng(3)
    values = rng.random(100_000) * 10.0 ** rng.integers(-12, 12, 100_000)
    assert sum_compensated(values) == pytest.approx(fsum(values), rel=2e-16)
    assert sum_compensated(np.array([1.0, 1e100, 1.0, -1e100])) == 2.0


def test_amounts_that_are_not_finite_are_reported() -> None:
    cells = random_cells(5, 6)
    phi = np.full(cells.fibre.shape, np.nan)
    _, reports = advance(dyed(cells, None), phi, 0 * phi, 1)
    assert reports[0].status == "diverged"


Frame = tuple[DyeSystem, int]


def roomy(ny: int, nx: int) -> Cells:
    """Cells that diffusion alone cannot fill."""
    return replace(random_cells(ny, nx), v_max=1e3)


def run_frames(state: DyeState, frames: list[Frame], memory: Memory | None = None) -> list[DyeReport]:
    solver, first = Explicit(), frames[0][0]
    memory = memory or solver.prepare(CONFIG, first, state)
    return [solver.advance(system, state, memory, steps, 0.9 * solver.limit(CONFIG, first)) for system, steps in frames]


def begun(phi: Float, fixed: Float) -> DyeState:
    return DyeState(phi[None].copy(), fixed[None].copy())


@pytest.mark.parametrize("name", [*ISOTHERMS, "alone"])
def test_dye_upkeep_equals_a_plain_loop(name: str) -> None:
    cells = roomy(9, 11) if name == "alone" else resisted(9, 11)
    phi, fixed = (0.1 * x for x in start(resisted(9, 11)))
    supply = 1e-3 * kept(cells) if name == "alone" else kept(cells)
    state = begun(phi, fixed)
    system = replace(dyed(cells, LAWS.get(name)), supply=supply)
    reports = run_frames(state, [(system, 5), (system, 8)])
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
    reports = run_frames(state, [(system, steps // 4)] * 4)
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
    reports = run_frames(whole, [(one, 24)]), run_frames(two, [(replace(one, threads=2), 24)])
    run_frames(cut, [(one, 7), (one, 1), (one, 16)])
    assert reports[0] == reports[1]
    for state in (two, cut):
        assert np.array_equal(state.phi, whole.phi) and np.array_equal(state.fixed, whole.fixed)


def test_nothing_kept_up_changes_no_bit_and_gives_nothing() -> None:
    cells = resisted(12, 13)
    without, with_none = (begun(*start(cells)) for _ in range(2))
    system = dyed(cells, LAWS["partition"])
    plain = run_frames(without, [(system, 9)])
    empty = run_frames(with_none, [(replace(system, supply=np.zeros((1, *cells.fibre.shape))), 9)])
    assert np.array_equal(without.phi, with_none.phi)
    assert plain[0].supplied == () and empty[0].supplied == (0.0,)


def test_only_the_dye_that_is_kept_up_is_given() -> None:
    cells = resisted(12, 13)
    supply = np.concatenate([0.0 * kept(cells), kept(cells)])
    system = DyeSystem(cells, (Dye("blue", D0), Dye("red", 0.4 * D0)), supply=supply)
    state = DyeState(np.zeros_like(supply), np.zeros_like(supply))
    (report,) = run_frames(state, [(system, 6)])
    assert report.supplied[0] == 0.0 and not state.phi[0].any()
    assert report.supplied[1] == pytest.approx(report.mobile[1], rel=1e-13) and report.mobile[1] > 0.0


def test_a_floor_above_the_room_fills_the_cell_and_no_more() -> None:
    cells = resisted(12, 13)
    full, more = (begun(*start(cells)) for _ in range(2))
    system = dyed(cells, None)
    run_frames(full, [(replace(system, supply=np.broadcast_to(cells.mobile_room, (1, *cells.fibre.shape))), 5)])
    run_frames(more, [(replace(system, supply=np.ones((1, *cells.fibre.shape))), 5)])
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
    run_frames(whole, frames)
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
