"""Runge-Kutta-Legendre super-time-stepping: long explicit steps, of second order (Meyer, Balsara and Aslam 2014).

A step of s stages reaches (s^2 + s - 2) / 4 explicit limits, so that it costs about 4 / s of what they would. Stages
are as many as the step needs. Adsorption, limits and supplies act in every stage (nuno_dye.solvers.rkl2_stage), so that
nothing is split: adsorption apart from diffusion (Strang) was a hundred times less accurate beside a kept-up drop.
Smooth amounts converge with the second order in the step; where a limit begins to bind, or supply to act, with the
first.

A first step over a jump would ring: it begins with a quarter of an explicit step (nuno_dye.solvers.long_steps).

An explicit stage can overshoot where amounts jump. What a step leaves below nothing or above capacity goes to or
comes from the nearest cells that can take or give it (nuno_dye.solvers.repair).
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_dye.laws.adsorption import Uptake
from nuno_dye.solvers import solving
from nuno_dye.solvers.fixing import bound_bands, settle_bands
from nuno_dye.solvers.long_steps import Dyed, Layout, LongSteps, Pair, keep_up
from nuno_dye.solvers.rkl2_rows import ROWS, Rules
from nuno_dye.solvers.rkl2_stage import LEVELS, Amounts, super_step
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config

MOST_STAGES = 201
"""Rounding grows with the square of the stages; a longer step is taken in parts."""
PACE = 0.25
"""Cells come to their limits in four explicit steps, or in the whole step where that is shorter."""
STIFFER = 1.25
"""By how much limits may raise the largest eigenvalue: PACE of them."""


class Rkl2Config(Config):
    """How a step begins where amounts jump."""

    start: int = Field(4, ge=1, le=1024, description="steps in each doubling of the time since amounts jumped")


class Rkl2(LongSteps):
    """Second-order super-time-stepping."""

    name: ClassVar[str] = "rkl2"
    order: ClassVar[int] = 2
    Config: ClassVar[type[BaseModel]] = Rkl2Config
    counts = ("stages",)
    longest = (MOST_STAGES**2 + MOST_STAGES - 2) / 4

    def reach(self, layout: Layout, dyed: Dyed, scale: float) -> float:
        """See LongSteps; what limits and adsorption add to the largest eigenvalue counts."""
        one, stiffer = dyed.one, STIFFER if dyed.limited or dyed.fixes else 1.0
        return scale * (layout.known.most * one.steepest * stiffer + (one.adsorption if dyed.fixes else 0.0))

    def step(self, layout: Layout, dyed: Dyed, start: Pair, scale: float) -> Pair | None:
        """See LongSteps: all stages, and what they leave out of bounds moved to where it fits."""
        phi, nx, amounts = start[0], layout.cut.nx, _amounts(layout, dyed)
        reach = self.reach(layout, dyed, scale)
        pace, law = max(PACE * reach, 1.0), solving.law_of(dyed.one, scale)
        coefficients = find_coefficients(find_stages(reach))
        found, fixed = _run(layout, dyed, start, scale, coefficients, Rules(*law, pace, dyed.floor is not None))
        dyed.totals["stages"] += len(coefficients)
        begun = Uptake(amounts.held[: len(phi)], layout.fibre, *law)
        if dyed.fixes:
            bound_bands(layout.cuts, found, phi, fixed, begun, amounts.floor, nx)
        most = np.maximum(layout.mobile, phi)
        if layout.mend(found, most, dyed.floor, scale) > 0:
            dyed.why = "leaves amounts beyond capacity"
            return None
        given = keep_up(found, dyed.floor, most)
        if dyed.fixes:
            settle_bands(layout.cuts, found, phi, fixed, begun, amounts.floor, nx, pace)
            given += keep_up(found, dyed.floor, most)
        dyed.given.append(given)
        return found, fixed


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


def _amounts(layout: Layout, dyed: Dyed) -> Amounts:
    """Arrays for one dye in the kernel's layout, kept until supplies keep up something else."""
    key = dyed.number, dyed.limited
    if key in layout.fed:
        return layout.fed[key]  # type: ignore[no-any-return]
    shape, fixes = layout.mobile.shape, dyed.fixes

    def planes() -> Float:
        return np.zeros((3 * shape[0], shape[1]))

    own = planes()
    held, seen = planes() if fixes else own, own if dyed.floor is None else planes()
    bite, floor = np.zeros(shape) if fixes else own, np.zeros(shape) if dyed.floor is None else dyed.floor
    # Bands shrink by a row or two a stage at either end, and must keep one: what lies between them stays apart then.
    levels = int(min(LEVELS, max(1, np.diff(layout.cuts).min() // 4)))
    scratch = np.zeros((len(layout.cuts) - 1, levels * ROWS, shape[1]))
    factors = planes() if dyed.limited else own
    layout.fed[key] = found = Amounts(own, np.zeros(shape), seen, floor, held, bite, layout.fibre, factors, scratch)
    return found


def _run(layout: Layout, dyed: Dyed, start: Pair, scale: float, coefficients: Float, rules: Rules) -> Pair:
    """All stages; raw mobile and fixed amounts at their end."""
    amounts, height = _amounts(layout, dyed), len(start[0])
    amounts.mobile.reshape(3, height, -1)[:] = start[0]
    if dyed.fixes:
        amounts.held.reshape(3, height, -1)[:] = start[1]
    if dyed.floor is not None:
        np.maximum(start[0], dyed.floor, out=amounts.seen[:height])
    most = layout.mobile if dyed.limited else None
    super_step(
        coefficients, rules, layout.cuts, layout.weights_of(scale), dyed.curve, amounts, most, layout.known.system.leave
    )
    even = slice(height, 2 * height)
    return amounts.mobile[even].copy(), amounts.held[even].copy() if dyed.fixes else start[1]
