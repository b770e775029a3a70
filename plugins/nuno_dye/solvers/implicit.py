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

from nuno_dye.laws.adsorption import NOTHING
from nuno_dye.laws.potential import Curve, curve_of, raise_levels
from nuno_dye.solvers import solving
from nuno_dye.solvers.implicit_cell import Fibre, hold_back
from nuno_dye.solvers.implicit_sweep import Stage, relax, settle
from nuno_dye.solvers.long_steps import Layout, LongSteps, keep_up, split_steps
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
"""No residual becomes smaller than this share of the largest amount times the weights of a cell."""


class ImplicitConfig(Config):
    """How steps are taken and solved."""

    scheme: Literal["sdirk2", "backward_euler"] = Field("sdirk2", description="second or first order in the step")
    residual: float = Field(1e-5, gt=0, le=1e-2, description="of every cell's equation, of the largest amount")


@dataclass
class Stepped:
    """One dye while it is advanced: its floor, whether limits may bind, and how its D falls with it."""

    one: Dye
    floor: Float | None
    limited: bool
    totals: dict[str, int]
    curve: Curve | None = None
    given: list[float] = field(default_factory=list)
    residual: float = 0.0
    """The last that was too large."""


class Implicit(LongSteps):
    """Backward Euler stages, solved by over-relaxation."""

    name: ClassVar[str] = "implicit"
    order: ClassVar[int] = 2
    Config: ClassVar[type[BaseModel]] = ImplicitConfig

    def prepare(self, config: ImplicitConfig, system: DyeSystem, state: DyeState) -> Memory:
        """Memory: `highest` (dyes,), the largest amount that any cell can have had; `met` (2,), sums of the room and of
        the floors that the last step met. Raises BadInput.
        """
        solving.require_compiled_laws(system, self.name)
        arrays = {"highest": solving.largest_amounts(state.phi), "met": np.full(2, np.nan)}
        return Memory(arrays, Layout(config, MARGIN, system))

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """See nuno_schemas.dye.DyeSolverPlugin."""
        layout: Layout = solving.renew_work(memory, system)
        highest, fresh = memory.arrays["highest"], solving.begin_frame(memory.arrays, layout.known, steps)
        totals, given, message = {"steps": steps, "sweeps": 0, "damped": 0, "halvings": 0}, [], ""
        for k, one in enumerate(system.dyes):
            limited = not float(highest[k]) <= layout.known.room
            dyed = Stepped(one, _floor(layout, k), limited, totals, curve_of(one))
            failed = _advance_one(layout, dyed, state.phi[k], state.fixed[k], steps, dt, fresh)
            given.append(math.fsum(dyed.given))
            message = message or failed
        state.t += steps * dt
        return solving.make_report(system, state, totals, given, message)


def _floor(layout: Layout, k: int) -> Float | None:
    """What is kept up of a dye, None where nothing is."""
    floors = layout.known.floors
    if floors is None or not floors[k].any():
        return None
    if k not in layout.fed:
        layout.fed[k] = layout.planes(floors[k])
    return np.asarray(layout.fed[k])


def _advance_one(layout: Layout, dyed: Stepped, phi: Float, fixed: Float, steps: int, dt: float, fresh: bool) -> str:
    """Bring one dye from the start of a frame to its end; why a step failed."""
    scale = dyed.one.D0 * dt / layout.known.system.cells.size**2
    amounts = layout.planes(phi), layout.planes(fixed)
    failed = ""
    for share in split_steps(0 if fresh else 1, steps, scale * layout.known.most * dyed.one.steepest, 1):
        after = _step(layout, dyed, amounts, float(share) * scale, 0)
        if after is None:
            failed = (
                f"steps of {dt / 2**HALVINGS:g} s still leave a residual of {dyed.residual:.2g} of the largest amount"
            )
            break
        amounts = after
    if steps == 0:
        _stage(layout, dyed, amounts, amounts, 0.0, None)
    layout.write_back(amounts, phi, fixed)
    return failed


def _step(
    layout: Layout, dyed: Stepped, start: tuple[Float, Float], scale: float, halved: int
) -> tuple[Float, Float] | None:
    """Mobile and fixed dye after one step, None where it fails."""
    after = _whole_step(layout, dyed, start, scale)
    if after is not None or halved == HALVINGS:
        return after
    dyed.totals["halvings"] += 1
    given = len(dyed.given)
    middle = _step(layout, dyed, start, 0.5 * scale, halved + 1)
    after = None if middle is None else _step(layout, dyed, middle, 0.5 * scale, halved + 1)
    if after is None:
        del dyed.given[given:]
    return after


def _whole_step(layout: Layout, dyed: Stepped, start: tuple[Float, Float], scale: float) -> tuple[Float, Float] | None:
    """One step without halves."""
    given: list[float] = []
    after = _two_stages(layout, dyed, start, scale, given) if layout.config.scheme == "sdirk2" else None
    if after is None:
        dyed.totals["damped"] += layout.config.scheme == "sdirk2"
        given.clear()
        after = _stage(layout, dyed, start, start, scale, given)
    if after is not None:
        dyed.given.extend(given)
    return after


def _two_stages(
    layout: Layout, dyed: Stepped, start: tuple[Float, Float], scale: float, given: list[float]
) -> tuple[Float, Float] | None:
    """One step of sdirk2, None where it leaves the bounds too far, as where cells fill up within its first stage."""
    share = (1.0 - GAMMA) / GAMMA
    middle = _stage(layout, dyed, start, start, GAMMA * scale, given)
    if middle is None:
        return None
    given[:] = [share * value for value in given]
    begun = start[0] + share * (middle[0] - start[0]), start[1] + share * (middle[1] - start[1])
    law = solving.law_of(dyed.one, GAMMA * scale)
    if dyed.floor is not None and law.kind != NOTHING:
        given[0] -= hold_back(law, dyed.floor, start[1], begun[1], layout.fibre)
    return _stage(layout, dyed, start, begun, GAMMA * scale, given)


def _stage(
    layout: Layout, dyed: Stepped, start: tuple[Float, Float], begun: tuple[Float, Float], scale: float,
    given: list[float] | None,
) -> tuple[Float, Float] | None:  # fmt: skip
    """Mobile and fixed dye after a stage, None where it fails; `start` is what the step starts from."""
    curve, most, law = dyed.curve, np.maximum(layout.mobile, start[0]), solving.law_of(dyed.one, scale)
    fibre = None if law.kind == NOTHING else Fibre(start[1], begun[1], layout.fibre, *law)
    guess = np.clip(begun[0], 0.0, most)
    if dyed.floor is not None:
        np.maximum(guess, dyed.floor, out=guess)
    largest, ways = float(guess.max()), scale * layout.known.most * dyed.one.steepest
    floor = _levels(np.zeros_like(guess) if dyed.floor is None else dyed.floor, curve)
    limits = _levels(most, curve) if dyed.limited else None
    stage = Stage(_levels(guess, curve), np.ones_like(guess), begun[0], floor, *layout.weights_of(scale))
    bound = max(layout.config.residual, ROUNDING * (1.0 + ways)) * largest
    sweeps, steepest = int(SWEEPS + SWEEPS_MORE * math.sqrt(ways)), ways * _steepest(guess, layout, curve)
    nx, radius = layout.cut.nx, steepest / (1.0 + steepest)
    count, residual = relax(sweeps, radius, bound, layout.cuts, stage, curve, fibre, limits, nx)
    if given is not None:
        dyed.totals["sweeps"] += count
    out, held = np.zeros_like(guess), begun[1] if fibre is None else np.zeros_like(guess)
    settle(out, held, layout.cuts, stage, curve, fibre, dyed.limited, nx)
    if not residual <= bound or layout.mend(out, most, dyed.floor, scale) != 0:
        dyed.residual = residual / (largest or 1.0)
        return None
    added = keep_up(out, dyed.floor, most)
    if given is not None:
        given.append(added)
    return out, held


def _steepest(guess: Float, layout: Layout, curve: Curve | None) -> float:
    """The largest D of the cells that can hold dye, as a share of the largest that there can be."""
    if curve is None:
        return 1.0
    return min(1.0, curve.knee / max(float(guess[layout.mobile > 0.0].min(initial=np.inf)), curve.knee))


def _levels(values: Float, curve: Curve | None) -> Float:
    """G of amounts in the kernel's layout; the amounts themselves where D is constant."""
    if curve is None:
        return values
    levels = np.empty_like(values)
    raise_levels(values, curve, levels)
    return levels
