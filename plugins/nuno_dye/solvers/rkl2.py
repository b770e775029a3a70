"""Runge-Kutta-Legendre super-time-stepping: long explicit steps, of second order (Meyer, Balsara and Aslam 2014).

A step of s stages reaches (s^2 + s - 2) / 4 explicit limits, so that it costs about 4 / s of what they would. Stages
are as many as the step needs. Adsorption, limits and supplies act in every stage (nuno_dye.solvers.rkl2), so that
nothing is split: adsorption apart from diffusion (Strang) was a hundred times less accurate beside a kept-up drop.
Smooth amounts converge with the second order in the step; where a limit begins to bind, or supply to act, with the
first.

A first step over a jump would ring: it begins with a quarter of an explicit step (nuno_dye.solvers.long_steps).

An explicit stage can overshoot where amounts jump. What a step leaves below nothing or above capacity goes to or
comes from the nearest cells that can take or give it (nuno_dye.solvers.repair).
"""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

import numpy as np
from numba import prange
from pydantic import BaseModel, Field

from nuno_dye.laws.adsorption import Uptake
from nuno_dye.laws.potential import Curve
from nuno_dye.solvers import solving
from nuno_dye.solvers.diffusion import Rows, Weights
from nuno_dye.solvers.fixing import bound_bands, settle_bands
from nuno_dye.solvers.long_steps import Dyed, Layout, LongSteps, Pair, keep_up
from nuno_dye.solvers.rkl2_rows import (
    ROWS,
    SLOT,
    Row,
    Rules,
    Stage,
    flux_row,
    keep_factors,
    limited_row,
    open_row,
    spread_row,
)
from nuno_kernels import block_kernel, kernel, parallel_kernel
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config

# A super-step of the Runge-Kutta-Legendre method: all of its stages in one compiled call.
#
#     Y_j = Y_0 + mu_j (Y_j-1 - Y_0) + nu_j (Y_j-2 - Y_0) + mu'_j dt M(Y_j-1) + gamma'_j dt M(Y_0)
#
# (Meyer, Balsara and Aslam 2014, equation 15). Written in differences from Y_0, rounding of the coefficients makes
# no dye: M moves it over faces, and what one cell loses the other gains.
#
# M is that of the explicit step as its step goes to 0. A cell that is full lets in as much as goes out of it and as its
# fibre takes: its inflow is scaled by (outflow + taken + pace (V_u - phi)) / inflow, if that is below 1, `pace` being
# how fast it comes to its capacity. Outflow into cells that are full themselves is what their factors of the stage
# before let through. A kept-up cell acts on its neighbours as though it held its floor, while its own sum runs on, so
# that at the end it tells what must be given. Adsorption is part of M (nuno_dye.solvers.fixing).
#
# One stage at a time is as slow as memory is, so a pass takes several while their rows are in the core's cache. A
# stage of a row needs the one before of the rows up to `depth` away, and its planes hold no more than the last two
# stages; so stage n of row i follows stage n - 1 of row i + depth. Bands of rows take a pass at once, each stage
# `depth` rows fewer at an end that meets another band; what is left between two bands, `depth` rows more each stage,
# is taken after both. Nothing is computed twice, and the bits do not depend on bands or passes.

LEVELS = 8
"""Stages of a pass; a row of 200 x 2 cells has about 40 kB."""
SETTLING = 4
"""Passes that find the first stage's factors, from 0 on: as many full cells in a row let dye through at once."""


class Amounts(NamedTuple):
    """One dye while it takes a step. Three planes (6 r, w) hold amounts at the start, in even and in odd stages.

    mobile   phi, raw; `slope` (2 r, w) is dt M(Y_0)
    seen     what neighbours see of it: `mobile` itself, but where it is kept up no less than its `floor` (2 r, w)
    held     what fibre has taken; `bite` (2 r, w) is what it takes at first, `fibre` (2 r, w) is V_d
    factors  of even and odd stages, the first plane unused
    scratch  (bands, levels ROWS, w), ROWS as in nuno_dye.solvers.rkl2_rows

    Those of fibre are any where it takes nothing, `floor` where nothing is kept up, `factors` where nothing is limited.
    """

    mobile: Float
    slope: Float
    seen: Float
    floor: Float
    held: Float
    bite: Float
    fibre: Float
    factors: Float
    scratch: Float


class Stages(NamedTuple):
    """Stages of a pass, numbered as the coefficients are; -1 finds factors alone, from plane `turn` into the other."""

    first: int
    number: int
    turn: int


class Span(NamedTuple):
    """Rows `top` to `bottom` of the first stage, and how many more each later one takes above and below."""

    top: int
    bottom: int
    up: int
    low: int


@block_kernel
def pass_rows(
    span: Span, stages: Stages, rules: Rules, coefs: Float, weights: Weights, curve: Curve | None, amounts: Amounts,
    most: Float | None, scratch: Float,
) -> None:  # fmt: skip
    """All stages of a pass over some rows; arrays are taken out of the tuples here, once for them all."""
    along, down, across, factors = weights.along, weights.down, weights.across, amounts.factors
    mobile, slope, seen, floor = amounts.mobile, amounts.slope, amounts.seen, amounts.floor
    held, bite, fibre = amounts.held, amounts.bite, amounts.fibre
    depth, r = 1 if most is None else 2, across.shape[0]
    for at in range(span.top, span.bottom + (span.low + depth) * (stages.number - 1) + 1):
        for n in range(stages.number):
            row, begin, j, slots = at - depth * n, span.top + span.up * n, stages.first + n, ROWS * n
            if not begin <= row <= span.bottom + span.low * n:
                continue
            into = 2 * r * (1 + j % 2)
            here = 0 if j <= 0 else 6 * r - into
            turn = stages.turn if j < 0 else j % 2
            passed, passing = 2 * r * (1 + turn), 2 * r * (2 - turn)
            stage = Stage(coefs[j, 0], coefs[j, 1], coefs[j, 2], coefs[j, 3], here, into, j == 0)
            if most is None:
                spread_row(mobile, slope, seen, floor, held, bite, fibre, rules, stage, along, down, across, curve, row)
            else:
                for ahead in range(row - 2 if row == begin else row + 1, row + 2):
                    place = Row(slots, ahead, here, passed, passing)
                    flux_row(seen, along, down, across, curve, scratch, slots + SLOT * (ahead % 4), ahead, here)
                    if ahead > row - 2:
                        open_row(seen, held, fibre, most, floor, factors, scratch, rules, place)
                keep_factors(factors, scratch, Row(slots, row, here, passed, passing))
                if j >= 0:
                    limited_row(mobile, slope, seen, floor, held, bite, fibre, rules, stage, scratch, slots, row)


@parallel_kernel
def pass_bands(
    stages: Stages, rules: Rules, coefs: Float, cuts: Rows, weights: Weights, curve: Curve | None, amounts: Amounts,
    most: Float | None,
) -> None:  # fmt: skip
    """What of a pass the bands can take without each other."""
    bands, depth = cuts.shape[0] - 1, 1 if most is None else 2
    for b in prange(bands):
        span = Span(cuts[b], cuts[b + 1] - 1, depth if b > 0 else 0, -depth if b < bands - 1 else 0)
        pass_rows(span, stages, rules, coefs, weights, curve, amounts, most, amounts.scratch[b])


@parallel_kernel
def pass_between(
    stages: Stages, rules: Rules, coefs: Float, cuts: Rows, weights: Weights, curve: Curve | None, amounts: Amounts,
    most: Float | None,
) -> None:  # fmt: skip
    """The rest of a pass, between the bands. A loop of its own: numba would fuse it."""
    depth = 1 if most is None else 2
    for b in prange(1, cuts.shape[0] - 1):
        span = Span(cuts[b], cuts[b] - 1, -depth, depth)
        pass_rows(span, stages, rules, coefs, weights, curve, amounts, most, amounts.scratch[b])


@kernel
def super_step(
    coefs: Float, rules: Rules, cuts: Rows, weights: Weights, curve: Curve | None, amounts: Amounts, most: Float | None,
    leave: Rows,
) -> None:  # fmt: skip
    """All stages, (s, 4) coefficients mu, nu, mu', gamma'; the last, as s is odd, is in the even plane. Until `leave`
    (1,) is not 0.

    cuts (b + 1,) are first rows of the bands, and the one after the last. `curve` is None where D is constant, `most`
    (V_u) where nothing can be limited.
    """
    levels = amounts.scratch.shape[1] // ROWS
    if most is not None:
        amounts.factors[:] = 0.0
        for n in range(SETTLING):
            pass_bands(Stages(-1, 1, n % 2), rules, coefs, cuts, weights, curve, amounts, most)
    for first in range(0, coefs.shape[0], levels):
        if leave[0] != 0:
            break
        stages = Stages(first, min(levels, coefs.shape[0] - first), 0)
        pass_bands(stages, rules, coefs, cuts, weights, curve, amounts, most)
        if cuts.shape[0] > 2 and stages.number > 1:
            pass_between(stages, rules, coefs, cuts, weights, curve, amounts, most)


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
