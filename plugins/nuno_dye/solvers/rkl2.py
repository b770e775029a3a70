"""Runge-Kutta-Legendre super-time-stepping: long explicit steps, of second order (Meyer, Balsara and Aslam 2014).

A step of s stages reaches (s^2 + s - 2) / 4 explicit limits, so that it costs about 4 / s of what they would. Stages
are as many as the step needs. Adsorption, limits and supplies act in every stage (nuno_dye.solvers.rkl2_stage), so that
nothing is split: adsorption apart from diffusion (Strang) was a hundred times less accurate beside a kept-up drop.
Smooth amounts converge with the second order in the step; where a limit begins to bind, or supply to act, with the
first.

A first step over a jump would ring, and fibre would keep what it takes of that: the first one, and one after cloth or
supplies have changed, is taken in parts that grow with the time since, from a quarter of an explicit step on, and so
are the few after it (nuno_dye.solvers.long_steps).

An explicit stage can overshoot where amounts jump. What a step leaves below nothing or above capacity goes to or
comes from the nearest cells that can take or give it (nuno_dye.solvers.repair).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_dye.laws.adsorption import NOTHING
from nuno_dye.laws.potential import Curve, curve_of
from nuno_dye.solvers import solving
from nuno_dye.solvers.fixing import Taking, bound_bands, settle_bands
from nuno_dye.solvers.long_steps import Layout, LongSteps, keep_up, split_steps
from nuno_dye.solvers.rkl2_rows import ROWS, Rules
from nuno_dye.solvers.rkl2_stage import LEVELS, Amounts, super_step
from nuno_schemas.dye import Dye, DyeReport, DyeState, DyeSystem
from nuno_schemas.fabric import Float, Memory
from nuno_schemas.plugin import Config

MARGIN = 2
"""Rows of padding beyond the two that every layout has: factors look two rows ahead."""
MOST_STAGES = 201
"""Rounding grows with the square of the stages; a longer step is taken in parts."""
PACE = 0.25
"""Cells come to their limits in four explicit steps, or in the whole step where that is shorter."""
STIFFER = 1.25
"""By how much limits may raise the largest eigenvalue: PACE of them."""


class Rkl2Config(Config):
    """How a step begins where amounts jump."""

    start: int = Field(4, ge=1, le=1024, description="steps in each doubling of the time since amounts jumped")


@dataclass
class Spread:
    """One dye while it is advanced.

    amounts  in the kernel's layout
    fixes    whether fibre takes any; kept, whether any cell is kept up; limited, whether limits may bind
    curve    how D falls with it
    """

    one: Dye
    amounts: Amounts
    fixes: bool
    kept: bool
    limited: bool
    curve: Curve | None

    @property
    def floor(self) -> Float | None:
        """(2 r, w) what is kept up, None where nothing is."""
        return self.amounts.floor if self.kept else None


class Rkl2(LongSteps):
    """Second-order super-time-stepping."""

    name: ClassVar[str] = "rkl2"
    order: ClassVar[int] = 2
    Config: ClassVar[type[BaseModel]] = Rkl2Config

    def prepare(self, config: Rkl2Config, system: DyeSystem, state: DyeState) -> Memory:
        """Memory: `highest` (dyes,), the largest amount that any cell can have had; `met` (2,), sums of the room and of
        the floors that the last step met; `since` (1,), steps since they were others. Raises BadInput.
        """
        solving.require_compiled_laws(system, self.name)
        arrays = {"highest": solving.largest_amounts(state.phi), "met": np.full(2, np.nan), "since": np.zeros(1)}
        return Memory(arrays, Layout(config, MARGIN, system))

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """See nuno_schemas.dye.DyeSolverPlugin."""
        layout: Layout = solving.renew_work(memory, system)
        highest, since = memory.arrays["highest"], memory.arrays["since"]
        if solving.begin_frame(memory.arrays, layout.known, steps):
            since[:] = 0.0
        totals, given, message = {"steps": steps, "stages": 0}, [], ""
        for k in range(len(system.dyes)):
            limited = not float(highest[k]) <= layout.known.room
            added, failed = _advance_one(layout, k, state, steps, dt, limited, int(since[0]), totals)
            given.append(added)
            message = message or failed
        state.t += steps * dt
        since[0] = int(since[0]) + steps
        return solving.make_report(system, state, totals, given, message)


def find_stages(reach: float) -> int:
    """Least odd number of stages that covers `reach` explicit limits."""
    s = max(3, math.ceil(0.5 * (math.sqrt(9.0 + 16.0 * reach) - 1.0)))
    return s + (s + 1) % 2


def find_coefficients(s: int) -> Float:
    """(s, 4) mu, nu, mu', gamma' of the stages (Meyer, Balsara and Aslam 2014, equations 16 and 17)."""
    j = np.arange(s + 1.0)
    b = np.full(s + 1, 1.0 / 3.0)
    b[2:] = (j[2:] ** 2 + j[2:] - 2.0) / (2.0 * j[2:] * (j[2:] + 1.0))
    w = 4.0 / (s * s + s - 2.0)
    found = np.zeros((s, 4))
    found[0, 2] = b[1] * w
    found[1:, 0] = (2.0 * j[2:] - 1.0) / j[2:] * b[2:] / b[1:-1]
    found[1:, 1] = -(j[2:] - 1.0) / j[2:] * b[2:] / b[:-2]
    found[1:, 2] = found[1:, 0] * w
    found[1:, 3] = -(1.0 - b[1:-1]) * found[1:, 2]
    return found


def _spread(layout: Layout, k: int, limited: bool) -> Spread:
    """Arrays for one dye, kept until supplies keep up something else."""
    if (k, limited) in layout.fed:
        return layout.fed[k, limited]  # type: ignore[no-any-return]
    shape, floors, one = layout.mobile.shape, layout.known.floors, layout.known.system.dyes[k]
    floor = np.zeros(shape) if floors is None else layout.planes(floors[k])
    kept, fixes = bool(floor.any()), solving.law_of(one, 1.0).kind != NOTHING

    def planes() -> Float:
        return np.zeros((3 * shape[0], shape[1]))

    own = planes()
    held, seen = planes() if fixes else own, planes() if kept else own
    bite = np.zeros(shape) if fixes else own
    # Bands shrink by a row or two a stage at either end, and must keep one: what lies between them stays apart then.
    levels = int(min(LEVELS, max(1, np.diff(layout.cuts).min() // 4)))
    scratch = np.zeros((len(layout.cuts) - 1, levels * ROWS, shape[1]))
    factors = planes() if limited else own
    amounts = Amounts(own, np.zeros(shape), seen, floor, held, bite, layout.fibre, factors, scratch)
    layout.fed[k, limited] = found = Spread(one, amounts, fixes, kept, limited, curve_of(one))
    return found


def _advance_one(
    layout: Layout, k: int, state: DyeState, steps: int, dt: float, limited: bool, since: int, totals: dict[str, int]
) -> tuple[float, str]:
    """Bring one dye from the start of a frame to its end or to where a step fails; what was given, why it fails."""
    spread, parts = _spread(layout, k, limited), 1
    scale = spread.one.D0 * dt / layout.known.system.cells.size**2
    while find_stages(_reach(layout, spread, scale / parts)) > MOST_STAGES:
        parts += parts
    amounts = layout.planes(state.phi[k]), layout.planes(state.fixed[k])
    given: list[float] = []
    failed, reach = "", _reach(layout, spread, scale / parts)
    for share in split_steps(since * parts, steps * parts, reach, layout.config.start):
        after, added = _step(layout, spread, amounts, float(share) * scale / parts, totals)
        if after is None:
            failed = f"a step of {float(share) * dt / parts:g} s leaves amounts beyond capacity"
            break
        amounts = after
        given.append(added)
    if steps == 0:
        _step(layout, spread, amounts, 0.0, dict(totals))
    layout.write_back(amounts, state.phi[k], state.fixed[k])
    return math.fsum(given), failed


def _reach(layout: Layout, spread: Spread, scale: float) -> float:
    """Explicit limits in a step."""
    stiffer = STIFFER if spread.limited or spread.fixes else 1.0
    one = spread.one
    return scale * (layout.known.most * one.steepest * stiffer + (one.adsorption if spread.fixes else 0.0))


def _step(
    layout: Layout, spread: Spread, start: tuple[Float, Float], scale: float, totals: dict[str, int]
) -> tuple[tuple[Float, Float] | None, float]:
    """One step; mobile and fixed dye at its end, None where that fails, and what was given."""
    phi, floor, nx = start[0], spread.amounts.floor, layout.cut.nx
    reach = _reach(layout, spread, scale)
    pace, law = max(PACE * reach, 1.0), solving.law_of(spread.one, scale)
    found, fixed = _run(layout, spread, start, scale, reach, Rules(*law, pace, spread.kept))
    totals["stages"] += find_stages(reach)
    taking = Taking(spread.amounts.held[: len(phi)], layout.fibre, *law)
    if spread.fixes:
        bound_bands(layout.cuts, found, phi, fixed, taking, floor, nx)
    most = np.maximum(layout.mobile, phi)
    if layout.mend(found, most, spread.floor, scale) > 0:
        return None, 0.0
    given = keep_up(found, spread.floor, most)
    if spread.fixes:
        settle_bands(layout.cuts, found, phi, fixed, taking, floor, nx, pace)
        given += keep_up(found, spread.floor, most)
    return (found, fixed), given


def _run(
    layout: Layout, spread: Spread, start: tuple[Float, Float], scale: float, reach: float, rules: Rules
) -> tuple[Float, Float]:
    """All stages; raw mobile and fixed amounts at their end."""
    amounts, height = spread.amounts, len(start[0])
    amounts.mobile.reshape(3, height, -1)[:] = start[0]
    if spread.fixes:
        amounts.held.reshape(3, height, -1)[:] = start[1]
    if spread.kept:
        np.maximum(start[0], amounts.floor, out=amounts.seen[:height])
    coefficients, most = find_coefficients(find_stages(reach)), layout.mobile if spread.limited else None
    super_step(coefficients, rules, layout.cuts, layout.weights_of(scale), spread.curve, amounts, most)
    even = slice(height, 2 * height)
    return amounts.mobile[even].copy(), amounts.held[even].copy() if spread.fixes else start[1]
