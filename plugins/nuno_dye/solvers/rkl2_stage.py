"""A super-step of the Runge-Kutta-Legendre method: all of its stages in one compiled call.

    Y_j = Y_0 + mu_j (Y_j-1 - Y_0) + nu_j (Y_j-2 - Y_0) + mu'_j dt M(Y_j-1) + gamma'_j dt M(Y_0)

(Meyer, Balsara and Aslam 2014, equation 15). Written in differences from Y_0, rounding of the coefficients makes
no dye: M moves it over faces, and what one cell loses the other gains.

M is that of the explicit step as its step goes to 0. A cell that is full lets in as much as goes out of it and as
its fibre takes: its inflow is scaled by (outflow + taken + pace (V_u - phi)) / inflow, if that is below 1, `pace`
being how fast it comes to its capacity. Outflow into cells that are full themselves is what their factors of the
stage before let through. A kept-up cell acts on its neighbours as though it held its floor, while its own sum runs on,
so that at the end it tells what must be given. Adsorption is part of M (nuno_dye.solvers.fixing).

One stage at a time is as slow as memory is, so a pass takes several while their rows are in the core's cache. A
stage of a row needs the one before of the rows up to `depth` away, and its planes hold no more than the last two
stages; so stage n of row i follows stage n - 1 of row i + depth. Bands of rows take a pass at once, each stage
`depth` rows fewer at an end that meets another band; what is left between two bands, `depth` rows more each stage,
is taken after both. Nothing is computed twice, and the bits do not depend on bands or passes.
"""

from __future__ import annotations

from typing import NamedTuple

from numba import prange

from nuno_dye.laws.potential import Curve
from nuno_dye.solvers.diffusion import Rows, Weights
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
