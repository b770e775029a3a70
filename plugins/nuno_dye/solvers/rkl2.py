"""Runge-Kutta-Legendre super-time-stepping: long explicit steps, of second order (Meyer, Balsara and Aslam 2014).

A step of s stages reaches (s^2 + s - 2) / 4 explicit limits, at about 4 / s of the cost of explicit steps. A step has
as many stages as it needs. Adsorption, limits and supplies act in every stage, so that nothing is split. Rejected:
adsorption separate from diffusion (Strang), a hundred times less accurate near a maintained drop. Smooth amounts
converge with second order in the step; where a limit begins to bind, or a supply to act, with first order.

A first step over a jump would ring: it begins with a quarter of an explicit step (nuno_dye.solvers.long_steps).

An explicit stage can overshoot where amounts jump. Amounts below 0 or above capacity after a step are balanced with the
nearest cells that can (nuno_dye.solvers.long_steps).
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numba import prange
from pydantic import BaseModel, Field

from nuno_dye.laws.adsorption import Law, Uptake
from nuno_dye.laws.diffusivity import Curve, potentials
from nuno_dye.solvers import solving
from nuno_dye.solvers.diffusion import LEFT, Rows, Weights, slide
from nuno_dye.solvers.fixing import bound_bands, settle_bands, taken_at
from nuno_dye.solvers.long_steps import Dyed, Layout, LongSteps, Pair, apply_floor
from nuno_kernels import block_kernel, forced_inline, kernel, parallel_kernel
from nuno_kernels.lanes import WIDTH, higher, load, lower, splat, store, where_greater
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config

# M of a row's cells and a stage from it, vector by vector: the inner loops of a super-step.
#
# A kernel processes a row of both layers, (2 r, w), weft rows before warp rows, and stores data for the next one in
# `scratch` from row `slots`: four rows of SLOT each in turn. Amounts are in three consecutive planes (6 r, w), given by
# their first rows (see Row), those of fixed dye after those of mobile dye. Every array is a separate argument: numba
# counts references of one that is chosen among several, or taken out of a tuple, which costs more than the row itself.
# Numbers are in tuples, which cost nothing.

SLOT = 7
"""Scratch rows of a row of cells: fluxes to the right, down, and between the layers, and the layers' factors."""
ROWS = 4 * SLOT
"""Rows of scratch of a stage."""


class Rules(NamedTuple):
    """The limits of the cells in a step.

    isotherm, rate, back  as in nuno_dye.laws.adsorption.Law
    pace                  rate at which a cell approaches its capacity, and fibre its limit
    kept                  whether any cell is maintained

    The loop tests `rate` and `kept`; arguments that may be None would make four kernels of each, of seven seconds'
    compilation.
    """

    isotherm: Any
    rate: float
    back: float
    pace: float
    kept: bool


class Stage(NamedTuple):
    """A stage of a row: the stage's coefficients, the first rows of its start and end planes, whether it is the first,
    the limits, the potential if D is not constant, and the row's number.
    """

    mu: float
    nu: float
    new: float
    old: float
    here: int
    into: int
    first: bool
    rules: Rules
    curve: Curve | None
    row: int


class Eight(NamedTuple):
    """Eight cells: their row and first column, what they get over their faces (lanes), and what they hold (lanes)."""

    row: int
    c: int
    rate: Any
    phi: Any


class Row(NamedTuple):
    """A row of both layers, and the places of its data.

    slots    first row of its scratch
    row      its number
    here     first row of the stage's start plane
    passed   first row of the plane of known factors
    passing  first row of the plane of factors for the next stage
    """

    slots: int
    row: int
    here: int
    passed: int
    passing: int


@forced_inline
def advanced(planes: Float, slope: Float, rate: Any, row: int, sloped: int, c: int, stage: Stage) -> Any:
    """Return eight amounts of a row after a stage, whose M is `rate`; row `sloped` has their slope."""
    initial = load(planes, row, c)
    if stage.first:
        return initial + stage.new * rate
    before, last = load(planes, row + stage.into, c), load(planes, row + stage.here, c)
    steps = stage.mu * (last - initial) + stage.nu * (before - initial)
    return initial + (steps + (stage.new * rate + stage.old * load(slope, sloped, c)))


@forced_inline
def finish(
    amounts: Float, slope: Float, seen: Float, floor: Float, fibre: Float, stage: Stage, cells: Eight
) -> None:  # fmt: skip
    """Finish a stage of eight cells: their fixed and mobile dye. All is read before anything is written. Rejected: each
    write where its value is known, slower than a loop for each of these parts, probably since arrays of one shape have
    addresses that agree in their last 12 bits.
    """
    rules, row, c, rate = stage.rules, cells.row, cells.c, cells.rate
    held, bite = row + 3 * fibre.shape[0], row + fibre.shape[0]
    taken = fixed = splat(0.0)
    if rules.rate > 0.0:
        law = Law(rules.isotherm, rules.rate, rules.back)
        taken = taken_at(cells.phi, load(amounts, held + stage.here, c), load(fibre, row, c), law, rules.pace)
        rate = rate - taken
        fixed = advanced(amounts, slope, taken, held, bite, c, stage)
    result = advanced(amounts, slope, rate, row, row, c, stage)
    visible = higher(load(floor, row, c), result) if rules.kept else result
    store(amounts, row + stage.into, c, result)
    if rules.kept:
        store(seen, row + stage.into, c, visible)
    if rules.rate > 0.0:
        store(amounts, held + stage.into, c, fixed)
    if stage.first:
        store(slope, row, c, rate)
        if rules.rate > 0.0:
            store(slope, bite, c, taken)


@kernel
def spread_row(
    amounts: Float, slope: Float, seen: Float, floor: Float, fibre: Float, along: Float, down: Float, across: Float,
    stage: Stage,
) -> None:  # fmt: skip
    """Take a stage of a row's cells if no limit can bind."""
    row, curve = stage.row, stage.curve
    other = row + across.shape[0]
    here_0, here_1, left_0, left_1 = stage.here + row, stage.here + other, splat(0.0), splat(0.0)
    for c in range(LEFT, seen.shape[1] - WIDTH, WIDTH):
        held_0, held_1 = load(seen, here_0, c), load(seen, here_1, c)
        phi_0, phi_1 = potentials(held_0, curve), potentials(held_1, curve)
        right_0 = load(along, row, c) * (potentials(load(seen, here_0, c + 1), curve) - phi_0)
        right_1 = load(along, other, c) * (potentials(load(seen, here_1, c + 1), curve) - phi_1)
        down_0 = load(down, row, c) * (potentials(load(seen, here_0 + 1, c), curve) - phi_0)
        down_1 = load(down, other, c) * (potentials(load(seen, here_1 + 1, c), curve) - phi_1)
        up_0 = load(down, row - 1, c) * (phi_0 - potentials(load(seen, here_0 - 1, c), curve))
        up_1 = load(down, other - 1, c) * (phi_1 - potentials(load(seen, here_1 - 1, c), curve))
        through = load(across, row, c) * (phi_1 - phi_0)
        rate_0 = (right_0 - slide(left_0, right_0)) + (down_0 - up_0) + through
        rate_1 = (right_1 - slide(left_1, right_1)) + (down_1 - up_1) - through
        finish(amounts, slope, seen, floor, fibre, stage, Eight(row, c, rate_0, held_0))
        finish(amounts, slope, seen, floor, fibre, stage, Eight(other, c, rate_1, held_1))
        left_0, left_1 = right_0, right_1


@kernel
def flux_row(
    phi: Float, along: Float, down: Float, across: Float, curve: Curve | None, scratch: Float, slot: int, row: int,
    here: int,
) -> None:  # fmt: skip
    """Write fluxes of a row's faces into `scratch` from row `slot`: to the right and down in either layer, and between
    them. Amounts phi are those of the plane that begins at row `here`.
    """
    other = row + across.shape[0]
    here_0, here_1 = here + row, here + other
    for c in range(LEFT, phi.shape[1] - WIDTH, WIDTH):
        phi_0, phi_1 = potentials(load(phi, here_0, c), curve), potentials(load(phi, here_1, c), curve)
        right_0, right_1 = potentials(load(phi, here_0, c + 1), curve), potentials(load(phi, here_1, c + 1), curve)
        down_0, down_1 = potentials(load(phi, here_0 + 1, c), curve), potentials(load(phi, here_1 + 1, c), curve)
        store(scratch, slot, c, load(along, row, c) * (right_0 - phi_0))
        store(scratch, slot + 1, c, load(along, other, c) * (right_1 - phi_1))
        store(scratch, slot + 2, c, load(down, row, c) * (down_0 - phi_0))
        store(scratch, slot + 3, c, load(down, other, c) * (down_1 - phi_1))
        store(scratch, slot + 4, c, load(across, row, c) * (phi_1 - phi_0))


@kernel
def open_row(
    seen: Float, held: Float, fibre: Float, most: Float, floor: Float, factors: Float, scratch: Float, rules: Rules,
    place: Row,
) -> None:  # fmt: skip
    """Compute factors of the inflow of a row's cells, from those in plane `passed`. The supply replaces the outflow of
    a maintained cell; dye that fibre takes also frees capacity.
    """
    row, r, nothing = place.row, most.shape[0] // 2, splat(0.0)
    law = Law(rules.isotherm, rules.rate, rules.back)
    slot, above = place.slots + SLOT * (row % 4), place.slots + SLOT * ((row - 1) % 4)
    for layer in range(2):
        previous, at, sign = splat(0.0), row + layer * r, 1.0 - 2.0 * layer
        here, here_factors, other_factors = at + place.here, at + place.passed, row + r - layer * r + place.passed
        for c in range(LEFT, seen.shape[1] - WIDTH, WIDTH):
            right, down = load(scratch, slot + layer, c), load(scratch, slot + 2 + layer, c)
            left, up = slide(previous, right), load(scratch, above + 2 + layer, c)
            other, phi = sign * load(scratch, slot + 4, c), load(seen, here, c)
            inflow = higher(right, nothing) - lower(left, nothing) + higher(down, nothing) - lower(up, nothing)
            inflow = inflow + higher(other, nothing)
            outflow = higher(left, nothing) * load(factors, here_factors, c - 1) - lower(right, nothing) * load(
                factors, here_factors, c + 1
            )
            outflow = outflow + higher(up, nothing) * load(factors, here_factors - 1, c)
            outflow = outflow - lower(down, nothing) * load(factors, here_factors + 1, c)
            outflow = outflow - lower(other, nothing) * load(factors, other_factors, c)
            if rules.kept:
                outflow = outflow - where_greater(load(floor, at, c), nothing, outflow)
            if law.rate > 0.0:
                fixed, room = load(held, here, c), load(fibre, at, c)
                outflow = outflow + taken_at(phi, fixed, room, law, rules.pace)
            share = (outflow + rules.pace * (load(most, at, c) - phi)) / inflow
            store(scratch, slot + 5 + layer, c, higher(lower(share, splat(1.0)), nothing))
            previous = right


@kernel
def scaled(flow: Any, here: Any, other: Any) -> Any:
    """Return a flow into this cell times its factor, one out of it times the other's."""
    return higher(flow, splat(0.0)) * here + lower(flow, splat(0.0)) * other


@kernel
def limited_row(
    amounts: Float, slope: Float, seen: Float, floor: Float, fibre: Float, scratch: Float, stage: Stage, slots: int
) -> None:  # fmt: skip
    """Take a stage of a row's cells, from fluxes and factors of this row and of the rows above and below."""
    row = stage.row
    slot, above, below = slots + SLOT * (row % 4), slots + SLOT * ((row - 1) % 4), slots + SLOT * ((row + 1) % 4)
    for layer in range(2):
        sign, previous, mine, at = 1.0 - 2.0 * layer, splat(0.0), 5 + layer, row + layer * (fibre.shape[0] // 2)
        for c in range(LEFT, scratch.shape[1] - WIDTH, WIDTH):
            factor = load(scratch, slot + mine, c)
            right = scaled(load(scratch, slot + layer, c), factor, load(scratch, slot + mine, c + 1))
            down = scaled(load(scratch, slot + 2 + layer, c), factor, load(scratch, below + mine, c))
            up = scaled(load(scratch, above + 2 + layer, c), load(scratch, above + mine, c), factor)
            through = scaled(load(scratch, slot + 4, c), load(scratch, slot + 5, c), load(scratch, slot + 6, c))
            rate, phi = (right - slide(previous, right)) + (down - up) + sign * through, load(seen, at + stage.here, c)
            finish(amounts, slope, seen, floor, fibre, stage, Eight(at, c, rate, phi))
            previous = right


@kernel
def keep_factors(factors: Float, scratch: Float, place: Row) -> None:
    """Copy factors of a row into plane `passing`, for the next stage."""
    r, slot = factors.shape[0] // 6, place.slots + SLOT * (place.row % 4)
    for layer in range(2):
        for c in range(LEFT, factors.shape[1] - WIDTH, WIDTH):
            store(factors, place.row + layer * r + place.passing, c, load(scratch, slot + 5 + layer, c))


# A super-step of the Runge-Kutta-Legendre method: all of its stages in one compiled call.
#
#     Y_j = Y_0 + mu_j (Y_j-1 - Y_0) + nu_j (Y_j-2 - Y_0) + mu'_j dt M(Y_j-1) + gamma'_j dt M(Y_0)
#
# (Meyer, Balsara and Aslam 2014, equation 15). In differences from Y_0, rounding of the coefficients creates no dye: M
# moves it over faces, from one cell to another. M is that of the explicit step as its length goes to 0. A full cell
# admits its outflow and its fibre's uptake: its inflow is scaled by (outflow + taken + pace (V_u - phi)) / inflow, if
# that is below 1, `pace` being the rate at which it approaches its capacity. Outflow into cells that are also full is
# scaled by their factors of the previous stage. A maintained cell acts on its neighbours as though it held its floor,
# while its own sum continues, so that at the end it gives the supplied amount. Adsorption is part of M
# (nuno_dye.solvers.fixing).
#
# Memory limits the speed of single stages, so a pass takes several while their rows are in the core's cache. A stage of
# a row needs the previous stage of rows up to `depth` away, and its planes hold only the last two stages; so stage n of
# row i follows stage n - 1 of row i + depth. Bands of rows take a pass at once, each stage `depth` rows fewer at an end
# that meets another band; the rest between two bands, `depth` rows more each stage, follows after both. Nothing is
# computed twice, and the bits do not depend on bands or passes.

LEVELS = 8
"""Stages of a pass; a row of 200 x 2 cells has about 40 kB."""
SETTLING = 4
"""Passes that compute the first stage's factors, from 0: as many full cells in a row pass dye on at once."""


class Amounts(NamedTuple):
    """The amounts of one dye in a step. Three planes (6 r, w) hold those at the start, in even and in odd stages.

    amounts  phi, raw, in three planes, and fixed dye in three more (12 r, w) if fibre takes any
    slope    (2 r, w) dt M(Y_0) of phi, and the uptake of fibre in the first stage in as many rows more if it takes any
    seen     mobile dye as neighbours see it: at least its `floor` (2 r, w) if it is maintained
    held     the planes of fixed dye in `amounts`; `fibre` (2 r, w) is V_d
    factors  of even and odd stages, the first plane unused
    scratch  (bands, levels ROWS, w), see ROWS

    Arrays without use (of fibre that takes no dye, `floor` without maintained cells, `factors` without limits) are
    arbitrary.
    """

    amounts: Float
    slope: Float
    seen: Float
    floor: Float
    held: Float
    fibre: Float
    factors: Float
    scratch: Float


class Stages(NamedTuple):
    """Stages of a pass, numbered like coefficients; -1 computes factors only, from plane `turn` into the other."""

    first: int
    number: int
    turn: int


class Span(NamedTuple):
    """Rows `top` to `bottom` of the first stage, and the number by which each later stage extends above and below."""

    top: int
    bottom: int
    up: int
    low: int


@block_kernel
def pass_rows(
    span: Span, stages: Stages, rules: Rules, coefs: Float, weights: Weights, curve: Curve | None, amounts: Amounts,
    most: Float | None, scratch: Float,
) -> None:  # fmt: skip
    """Take all stages of a pass over some rows; arrays are taken out of the tuples here, once for all."""
    along, down, across, factors = weights.along, weights.down, weights.across, amounts.factors
    both, slope, seen, floor = amounts.amounts, amounts.slope, amounts.seen, amounts.floor
    held, fibre = amounts.held, amounts.fibre
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
            mu, nu, new, old = coefs[j, 0], coefs[j, 1], coefs[j, 2], coefs[j, 3]
            stage = Stage(mu, nu, new, old, here, into, j == 0, rules, curve, row)
            if most is None:
                spread_row(both, slope, seen, floor, fibre, along, down, across, stage)
            else:
                for ahead in range(row - 2 if row == begin else row + 1, row + 2):
                    place = Row(slots, ahead, here, passed, passing)
                    flux_row(seen, along, down, across, curve, scratch, slots + SLOT * (ahead % 4), ahead, here)
                    if ahead > row - 2:
                        open_row(seen, held, fibre, most, floor, factors, scratch, rules, place)
                keep_factors(factors, scratch, Row(slots, row, here, passed, passing))
                if j >= 0:
                    limited_row(both, slope, seen, floor, fibre, scratch, stage, slots)


@parallel_kernel
def pass_bands(
    stages: Stages, rules: Rules, coefs: Float, cuts: Rows, weights: Weights, curve: Curve | None, amounts: Amounts,
    most: Float | None,
) -> None:  # fmt: skip
    """Take the part of a pass in which bands are independent."""
    bands, depth = cuts.shape[0] - 1, 1 if most is None else 2
    for b in prange(bands):
        span = Span(cuts[b], cuts[b + 1] - 1, depth if b > 0 else 0, -depth if b < bands - 1 else 0)
        pass_rows(span, stages, rules, coefs, weights, curve, amounts, most, amounts.scratch[b])


@parallel_kernel
def pass_between(
    stages: Stages, rules: Rules, coefs: Float, cuts: Rows, weights: Weights, curve: Curve | None, amounts: Amounts,
    most: Float | None,
) -> None:  # fmt: skip
    """Take the rest of a pass, between the bands. A separate loop, since numba would fuse it."""
    depth = 1 if most is None else 2
    for b in prange(1, cuts.shape[0] - 1):
        span = Span(cuts[b], cuts[b] - 1, -depth, depth)
        pass_rows(span, stages, rules, coefs, weights, curve, amounts, most, amounts.scratch[b])


@kernel
def super_step(
    coefs: Float, rules: Rules, cuts: Rows, weights: Weights, curve: Curve | None, amounts: Amounts, most: Float | None,
    leave: Rows,
) -> None:  # fmt: skip
    """Take all stages, with coefficients (s, 4) mu, nu, mu', gamma', until `leave` (1,) is not 0; the last, as s is
    odd, is in the even plane.

    cuts (b + 1,) are first rows of the bands, and the one after the last. `curve` is None if D is constant, `most`
    (V_u) if nothing can be limited.
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
"""Cells reach their limits in four explicit steps, or in the whole step if that is shorter."""
STIFFER = 1.25
"""Factor by which limits may raise the largest eigenvalue: 1 + PACE."""


class Rkl2Config(Config):
    """The start of a step after amounts jump."""

    start: int = Field(4, ge=1, le=1024, description="steps in each doubling of the time since amounts jumped")


class Rkl2(LongSteps):
    """Second-order super-time-stepping."""

    name: ClassVar[str] = "rkl2"
    order: ClassVar[int] = 2
    Config: ClassVar[type[BaseModel]] = Rkl2Config
    counts = ("stages",)
    longest = (MOST_STAGES**2 + MOST_STAGES - 2) / 4

    def reach(self, layout: Layout, dyed: Dyed, scale: float) -> float:
        """Return the explicit limits in a step, with the larger eigenvalue by limits and adsorption."""
        one, stiffer = dyed.one, STIFFER if dyed.limited or dyed.fixes else 1.0
        return scale * (layout.derived.most * one.steepest * stiffer + (one.adsorption if dyed.fixes else 0.0))

    def step(self, layout: Layout, dyed: Dyed, start: Pair, scale: float) -> Pair | None:
        """Take all stages, then move amounts out of bounds to cells with room. None if there are none."""
        phi, nx, amounts = start[0], layout.cut.nx, _amounts(layout, dyed)
        reach = self.reach(layout, dyed, scale)
        pace, law = max(PACE * reach, 1.0), solving.law_of(dyed.one, scale)
        coefficients = find_coefficients(find_stages(reach))
        mobile, fixed = _run(layout, dyed, start, scale, coefficients, Rules(*law, pace, dyed.floor is not None))
        dyed.totals["stages"] += len(coefficients)
        initial = Uptake(amounts.held[: len(phi)], layout.fibre, *law)
        if dyed.fixes:
            bound_bands(layout.cuts, mobile, phi, fixed, initial, amounts.floor, nx)
        most = np.maximum(layout.mobile, phi)
        if layout.repair_bounds(mobile, most, dyed.floor, scale) > 0:
            dyed.reason = "leaves amounts beyond capacity"
            return None
        added = apply_floor(mobile, dyed.floor, most)
        if dyed.fixes:
            settle_bands(layout.cuts, mobile, phi, fixed, initial, amounts.floor, nx, pace)
            added += apply_floor(mobile, dyed.floor, most)
        dyed.supplied.append(added)
        return mobile, fixed


def find_stages(reach: float) -> int:
    """Return the least odd number of stages that covers `reach` explicit limits."""
    s = max(3, math.ceil(0.5 * (math.sqrt(9.0 + 16.0 * reach) - 1.0)))
    return s + (s + 1) % 2


def find_coefficients(s: int) -> Float:
    """Return mu, nu, mu', gamma' (s, 4) of the stages (Meyer, Balsara and Aslam 2014, equations 16 and 17)."""
    j = np.arange(s + 1.0)
    b = np.full(s + 1, 1.0 / 3.0)
    b[2:] = (j[2:] ** 2 + j[2:] - 2.0) / (2.0 * j[2:] * (j[2:] + 1.0))
    w = 4.0 / (s * s + s - 2.0)
    coefficients = np.zeros((s, 4))
    coefficients[0, 2] = b[1] * w
    coefficients[1:, 0] = (2.0 * j[2:] - 1.0) / j[2:] * b[2:] / b[1:-1]
    coefficients[1:, 1] = -(j[2:] - 1.0) / j[2:] * b[2:] / b[:-2]
    coefficients[1:, 2] = coefficients[1:, 0] * w
    coefficients[1:, 3] = -(1.0 - b[1:-1]) * coefficients[1:, 2]
    return coefficients


def _amounts(layout: Layout, dyed: Dyed) -> Amounts:
    """Return the arrays of one dye in the kernel's layout, cached until maintained supplies change."""
    key = dyed.number, dyed.limited
    if key in layout.floor_cache:
        return layout.floor_cache[key]  # type: ignore[no-any-return]
    shape, fixes = layout.mobile.shape, dyed.fixes

    def planes() -> Float:
        return np.zeros((3 * shape[0], shape[1]))

    parts = 2 if fixes else 1
    both, slope = np.zeros((parts * 3 * shape[0], shape[1])), np.zeros((parts * shape[0], shape[1]))
    held, seen = both[3 * shape[0] :] if fixes else both, both if dyed.floor is None else planes()
    floor = np.zeros(shape) if dyed.floor is None else dyed.floor
    # Bands shrink by a row or two a stage at either end, and must keep one, which separates the rests between them.
    levels = int(min(LEVELS, max(1, np.diff(layout.cuts).min() // 4)))
    scratch = np.zeros((len(layout.cuts) - 1, levels * ROWS, shape[1]))
    factors = planes() if dyed.limited else both
    layout.floor_cache[key] = amounts = Amounts(both, slope, seen, floor, held, layout.fibre, factors, scratch)
    return amounts


def _run(layout: Layout, dyed: Dyed, start: Pair, scale: float, coefficients: Float, rules: Rules) -> Pair:
    """Take all stages. Return raw mobile and fixed amounts."""
    amounts, height = _amounts(layout, dyed), len(start[0])
    amounts.amounts[: 3 * height].reshape(3, height, -1)[:] = start[0]
    if dyed.fixes:
        amounts.held.reshape(3, height, -1)[:] = start[1]
    if dyed.floor is not None:
        np.maximum(start[0], dyed.floor, out=amounts.seen[:height])
    most = layout.mobile if dyed.limited else None
    super_step(
        coefficients,
        rules,
        layout.cuts,
        layout.weights_of(scale),
        dyed.curve,
        amounts,
        most,
        layout.derived.system.leave,
    )
    even = slice(height, 2 * height)
    return amounts.amounts[even].copy(), amounts.held[even].copy() if dyed.fixes else start[1]
