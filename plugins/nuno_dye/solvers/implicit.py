"""Implicit steps of any length: diffusion, limits, supplies and adsorption solved together
(nuno_dye.solvers.implicit_sweep).

`sdirk2` (Alexander 1977) takes two backward Euler stages of gamma = 1 - 1/sqrt(2) of the step, the second from what
the first, prolonged, came to: of second order, and damping as TR-BDF2 does, whose amplification it has; but its first
stage asks for no rate at the start, which is without bounds where a drop was just put. `backward_euler` is of first
order and never leaves the bounds.

Beside a jump the first step would overshoot, and fibre keeps what it takes of that: the first one, and one after
cloth or supplies have changed, is taken in parts that double from an explicit step on.

Every stage ends with the fluxes of what the sweeps found, so that dye is kept to rounding whatever residual they
leave. What the second stage takes below nothing or above capacity goes to the neighbours (nuno_dye.solvers.repair).
Where they cannot take it, as where many cells fill up in one step, backward Euler takes the step, and `damped` counts
it. Where its sweeps do not converge either, the step is taken again as two halves, eight times over; then the run ends
as unconverged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from nuno_dye.laws.potential import Curve, curve_of, raise_levels
from nuno_dye.solvers.bands import Cut
from nuno_dye.solvers.diffusion import Rows
from nuno_dye.solvers.implicit_cell import Fibre, hold_back
from nuno_dye.solvers.implicit_sweep import Stage, relax, settle
from nuno_dye.solvers.long_steps import BEYOND, split_steps, weights_of, write_back
from nuno_dye.solvers.repair import repair
from nuno_dye.solvers.rkl2_stage import Weights
from nuno_dye.solvers.solving import (
    Known,
    begin_frame,
    count_bands,
    describe_threads,
    know,
    largest_amounts,
    law_of,
    make_report,
    renew_work,
    require_compiled_laws,
)
from nuno_dye.solvers.sums import sum_compensated
from nuno_schemas.dye import Dye, DyeReport, DyeState, DyeSystem
from nuno_schemas.fabric import Float, Memory
from nuno_schemas.plugin import Config

GAMMA = 1.0 - math.sqrt(0.5)
MARGIN = 1
HALVINGS = 8
SWEEPS, SWEEPS_MORE = 200, 60.0
"""Sweeps of a stage at most: some, and more by the root of the largest sum of weights. Over-relaxation takes about
sqrt(W / 8) for a factor e, and a residual falls by about 20 of those."""
ROUNDING = 8.0 * 2.0**-52
"""Of the largest amount times the weights of a cell: no residual becomes smaller."""


class ImplicitConfig(Config):
    """How steps are taken and solved."""

    scheme: Literal["sdirk2", "backward_euler"] = Field("sdirk2", description="second or first order in the step")
    residual: float = Field(1e-5, gt=0, le=1e-2, description="of every cell's equation, of the largest amount")


@dataclass
class Work:
    """What was made from a system: most mobile dye, V_d and floors in the kernel's layout, and weights by scale."""

    config: ImplicitConfig
    known: Known
    cut: Cut
    cuts: Rows
    mobile: Float
    fibre: Float
    floors: dict[int, Float] = field(default_factory=dict)
    weights: dict[float, Weights] = field(default_factory=dict)


@dataclass
class Spread:
    """One dye while it is advanced: its floor, whether limits may bind, and how its D falls with it."""

    one: Dye
    floor: Float | None
    limited: bool
    totals: dict[str, int]
    curve: Curve | None = None
    given: list[float] = field(default_factory=list)
    residual: float = 0.0
    """The last that was too large."""


class Implicit:
    """Backward Euler stages, solved by over-relaxation."""

    name: ClassVar[str] = "implicit"
    order: ClassVar[int] = 2
    Config: ClassVar[type[BaseModel]] = ImplicitConfig

    def prepare(self, config: ImplicitConfig, system: DyeSystem, state: DyeState) -> Memory:
        """Memory: `highest` (dyes,), the largest amount that any cell can have had; `met` (2,), sums of the room and of
        the floors that the last step met. Raises BadInput.
        """
        require_compiled_laws(system, self.name)
        return Memory({"highest": largest_amounts(state), "met": np.full(2, np.nan)}, _make_work(config, system))

    def limit(self, config: ImplicitConfig, system: DyeSystem) -> float:
        """None: every step is stable."""
        return math.inf

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """See nuno_schemas.dye.DyeSolver."""
        work = _renew_work(memory, system)
        highest, fresh = memory.arrays["highest"], begin_frame(memory.arrays, work.known, steps)
        totals, given, message = {"steps": steps, "sweeps": 0, "damped": 0, "halvings": 0}, [], ""
        for k, one in enumerate(system.dyes):
            limited = not float(highest[k]) <= work.known.room
            spread = Spread(one, _floor(work, k), limited, totals, curve_of(one))
            failed = _advance_one(work, spread, state.phi[k], state.fixed[k], steps, dt, fresh)
            given.append(math.fsum(spread.given))
            message = message or failed
        state.t += steps * dt
        return make_report(system, state, totals, given, message)

    def about(self, system: DyeSystem) -> str:
        return describe_threads(system)


def _make_work(config: ImplicitConfig, system: DyeSystem) -> Work:
    cells = system.cells
    cut = Cut(cells.fibre.shape, 1, MARGIN)
    cuts = cut.top + np.linspace(0, cut.ny, count_bands(system) + 1).astype(np.int64)
    mobile, fibre = (cut.fill(room)[0][0] for room in (cells.mobile_room, cells.fixed_room))
    return Work(config, know(system), cut, cuts, mobile, fibre)


def _renew_work(memory: Memory, system: DyeSystem) -> Work:
    work: Work = memory.work  # type: ignore[assignment]
    memory.work = work = renew_work(work, system, lambda other: _make_work(work.config, other), work.floors)
    return work


def _floor(work: Work, k: int) -> Float | None:
    """What is kept up of a dye, None where nothing is."""
    floors = work.known.floors
    if floors is None or not floors[k].any():
        return None
    if k not in work.floors:
        work.floors[k] = work.cut.fill(floors[k])[0][0]
    return work.floors[k]


def _advance_one(work: Work, spread: Spread, phi: Float, fixed: Float, steps: int, dt: float, fresh: bool) -> str:
    """Bring one dye from the start of a frame to its end; why a step failed."""
    cut, scale = work.cut, spread.one.D0 * dt / work.known.system.cells.size**2
    amounts = cut.fill(phi)[0][0], cut.fill(fixed)[0][0]
    failed = ""
    for share in split_steps(0 if fresh else 1, steps, scale * work.known.most * spread.one.steepest, 1):
        after = _step(work, spread, amounts, float(share) * scale, 0)
        if after is None:
            failed = (
                f"steps of {dt / 2**HALVINGS:g} s still leave a residual of {spread.residual:.2g} of the largest amount"
            )
            break
        amounts = after
    if steps == 0:
        _stage(work, spread, amounts, amounts, 0.0, None)
    write_back(cut, amounts, phi, fixed)
    return failed


def _step(
    work: Work, spread: Spread, start: tuple[Float, Float], scale: float, halved: int
) -> tuple[Float, Float] | None:
    """Mobile and fixed dye after one step, None where it fails."""
    after = _whole_step(work, spread, start, scale)
    if after is not None or halved == HALVINGS:
        return after
    spread.totals["halvings"] += 1
    given = len(spread.given)
    middle = _step(work, spread, start, 0.5 * scale, halved + 1)
    after = None if middle is None else _step(work, spread, middle, 0.5 * scale, halved + 1)
    if after is None:
        del spread.given[given:]
    return after


def _whole_step(work: Work, spread: Spread, start: tuple[Float, Float], scale: float) -> tuple[Float, Float] | None:
    """One step without halves."""
    given: list[float] = []
    after = _two_stages(work, spread, start, scale, given) if work.config.scheme == "sdirk2" else None
    if after is None:
        spread.totals["damped"] += work.config.scheme == "sdirk2"
        given.clear()
        after = _stage(work, spread, start, start, scale, given)
    if after is not None:
        spread.given.extend(given)
    return after


def _two_stages(
    work: Work, spread: Spread, start: tuple[Float, Float], scale: float, given: list[float]
) -> tuple[Float, Float] | None:
    """One step of sdirk2, None where it leaves the bounds too far, as where cells fill up within its first stage."""
    share = (1.0 - GAMMA) / GAMMA
    middle = _stage(work, spread, start, start, GAMMA * scale, given)
    if middle is None:
        return None
    given[:] = [share * value for value in given]
    begun = start[0] + share * (middle[0] - start[0]), start[1] + share * (middle[1] - start[1])
    law = law_of(spread.one)
    if spread.floor is not None and law[0]:
        given[0] -= hold_back(law, spread.floor, start[1], begun[1], work.fibre)
    return _stage(work, spread, start, begun, GAMMA * scale, given)


def _stage(
    work: Work, spread: Spread, start: tuple[Float, Float], begun: tuple[Float, Float], scale: float,
    given: list[float] | None,
) -> tuple[Float, Float] | None:  # fmt: skip
    """Mobile and fixed dye after a stage, None where it fails; `start` is what the step starts from."""
    cut, curve, most = work.cut, spread.curve, np.maximum(work.mobile, start[0])
    weights = weights_of(work.weights, cut, work.known.faces, scale)
    kind, first, second = law_of(spread.one)
    fibre = Fibre(start[1], begun[1], work.fibre, spread.one.adsorption * scale, kind, first, second) if kind else None
    guess = np.clip(begun[0], 0.0, most)
    if spread.floor is not None:
        np.maximum(guess, spread.floor, out=guess)
    largest, ways = float(guess.max()), scale * work.known.most * spread.one.steepest
    least = np.zeros_like(guess) if spread.floor is None else spread.floor
    floor = _levels(least, curve)
    limits = _levels(most, curve) if spread.limited else None
    stage = Stage(_levels(guess, curve), np.ones_like(guess), begun[0])
    bound = max(work.config.residual, ROUNDING * (1.0 + ways)) * largest
    sweeps, steepest = int(SWEEPS + SWEEPS_MORE * math.sqrt(ways)), ways * _steepest(guess, work, curve)
    count, residual = relax(
        sweeps, steepest / (1.0 + steepest), bound, work.cuts, stage, weights, curve, fibre, floor, limits, cut.nx
    )
    if given is not None:
        spread.totals["sweeps"] += count
    out, held = np.zeros_like(guess), begun[1] if fibre is None else np.zeros_like(guess)
    settle(out, held, work.cuts, stage, weights, curve, fibre, spread.limited, cut.nx)
    if not residual <= bound:
        spread.residual = residual / (largest or 1.0)
        return None
    # Kept-up cells take any excess of their neighbours': it is given back to the supply that fed them.
    bounds = most if spread.floor is None else np.where(spread.floor > 0.0, most + BEYOND, most)
    if repair(out, bounds, least, weights, cut.top, cut.top + cut.ny - 1, cut.nx) != 0:
        spread.residual = residual / (largest or 1.0)
        return None
    if spread.floor is not None and given is not None:
        kept = np.where(spread.floor > 0.0, np.clip(out, spread.floor, most), out)
        given.append(sum_compensated((kept - out).reshape(-1)))
        out = kept
    elif given is not None:
        given.append(0.0)
    return out, held


def _steepest(guess: Float, work: Work, curve: Curve | None) -> float:
    """The largest D of the cells that can hold dye, as a share of the largest that there can be."""
    if curve is None:
        return 1.0
    return min(1.0, curve.knee / max(float(guess[work.mobile > 0.0].min(initial=np.inf)), curve.knee))


def _levels(values: Float, curve: Curve | None) -> Float:
    """G of amounts in the kernel's layout; the amounts themselves where D is constant."""
    if curve is None:
        return values
    levels = np.empty_like(values)
    raise_levels(values, curve, levels)
    return levels
