"""The explicit dye solver: the plain loop's amounts, dye kept, the same bits however frames and threads are cut."""

from __future__ import annotations

from dataclasses import replace
from math import fsum

import numpy as np
import pytest
from dye_reference import CONFIG, D0, ISOTHERMS, LAWS, dyed, plain_step, random_cells, resisted, start

from nuno_dye.laws.faces import face_values, largest_sum
from nuno_dye.laws.isotherms import Freundlich, FreundlichConfig, Partition, PartitionConfig
from nuno_dye.solvers.explicit import Explicit
from nuno_dye.solvers.solving import CELLS_PER_THREAD
from nuno_dye.solvers.upkeep import sum_compensated
from nuno_schemas.dye import Dye, DyeReport, DyeState, DyeSystem, Isotherm
from nuno_schemas.fabric import Float


def advance(
    system: DyeSystem, phi: Float, fixed: Float, steps: int, frames: int = 1
) -> tuple[DyeState, list[DyeReport]]:
    """Frames of steps at 0.9 of the limit."""
    solver, state = Explicit(), DyeState(phi[None].copy(), fixed[None].copy())
    memory = solver.prepare(CONFIG, system, state)
    dt = 0.9 * solver.limit(CONFIG, system)
    return state, [solver.advance(system, state, memory, steps, dt) for _ in range(frames)]


@pytest.mark.parametrize("name", ISOTHERMS)
def test_equals_a_plain_loop(name: str) -> None:
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


def test_an_isotherm_in_python_is_followed() -> None:
    cells = resisted(9, 11)
    phi, fixed = start(cells)
    law = Isotherm("python", function=lambda phi, room: room * 2.0 * phi / (1.0 + 2.0 * phi))
    ours, _ = advance(dyed(cells, law), phi, fixed, 7)
    known, _ = advance(dyed(cells, LAWS["langmuir"]), phi, fixed, 7)
    assert known.fixed.max() > 0.0
    assert np.abs(ours.phi - known.phi).max() < 1e-14 and np.abs(ours.fixed - known.fixed).max() < 1e-14


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
