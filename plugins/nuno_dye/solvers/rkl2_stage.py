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

from typing import Any, NamedTuple

from numba import prange

from nuno_dye.solvers.fixing import take_row
from nuno_dye.solvers.rkl2_rows import (
    RATES,
    ROWS,
    advance_row,
    flux_row,
    keep_factors,
    limited_row,
    open_row,
    see_row,
    spread_row,
)
from nuno_kernels import kernel, parallel_kernel
from nuno_schemas.fabric import Float

LEVELS = 8
"""Stages of a pass; a row of 200 x 2 cells has about 40 kB."""
SETTLING = 4
"""Passes that find the first stage's factors, from 0 on: as many full cells in a row let dye through at once."""


class Amounts(NamedTuple):
    """One dye while it takes a step. Three planes (6 r, w) hold amounts at the start, in even and in odd stages.

    mobile   phi, raw; `slope` (2 r, w) is dt M(Y_0)
    seen     what neighbours see of it: `mobile` itself, but where it is kept up no less than its floor
    held     what fibre has taken, any where it takes nothing
    factors  of even and odd stages, the first plane unused; any where nothing is limited
    scratch  (bands, levels ROWS, w), ROWS as in nuno_dye.solvers.rkl2_rows
    """

    mobile: Float
    slope: Float
    seen: Float
    held: Float
    factors: Float
    scratch: Float


class Weights(NamedTuple):
    """D dt / d^2 of the faces: to the next column and the next row (2 r, w), between the layers (r, w)."""

    along: Float
    down: Float
    across: Float


class Law(NamedTuple):
    """D_ab dt / d^2, the isotherm and its numbers; how fast a cell comes to its capacity, and fibre to its limit.

    `fixes` and `kept`: whether fibre takes any, and whether any is kept up. They are asked row by row; as arguments
    that may be None they made four kernels of each, of seven seconds' compilation.
    """

    rate: float
    isotherm: int
    first: float
    second: float
    pace: float
    fixes: bool
    kept: bool


class Stages(NamedTuple):
    """Of a pass, numbered as the coefficients are; -1 finds factors alone, from plane `turn` into the other."""

    first: int
    number: int
    turn: int


@kernel
def end_row(
    row: int, here: int, into: int, j: int, coefs: Any, law: Any, r: int, mobile: Any, slope: Any, seen: Any,
    held: Any, bite: Any, fibre: Any, floor: Any, scratch: Any, rates: int,
) -> None:  # fmt: skip
    """Stage `j` of a row of both layers, from what diffusion brings it, in scratch[rates] and the next."""
    for layer in range(2):
        at, of = row + layer * r, rates + layer
        if law.fixes:
            take_row(
                seen, held, fibre, scratch, of, at, here, law.rate, law.isotherm, law.first, law.second, law.pace
            )  # fmt: skip
            advance_row(held, bite, scratch, of + 2, at, here, into, coefs, j)
        advance_row(mobile, slope, scratch, of, at, here, into, coefs, j)
        if law.kept:
            see_row(seen, mobile, floor, at, at + into)


@kernel
def pass_rows(
    top: int, bottom: int, up: int, low: int, stages: Any, law: Any, coefs: Any, along: Any, down: Any, across: Any,
    curve: Any, mobile: Any, slope: Any, seen: Any, held: Any, bite: Any, fibre: Any, floor: Any, most: Any,
    factors: Any, scratch: Any,
) -> None:  # fmt: skip
    """All stages of a pass, the first of rows `top` to `bottom`, and each `up` and `low` rows further.

    All arrays are arguments of their own: numba counts who holds one that is taken out of a tuple, for every row.
    """
    depth, r = 1 if most is None else 2, across.shape[0]
    for at in range(top, bottom + (low + depth) * (stages.number - 1) + 1):
        for n in range(stages.number):
            row, begin, j, slots = at - depth * n, top + up * n, stages.first + n, ROWS * n
            if not begin <= row <= bottom + low * n:
                continue
            into = 2 * r * (1 + j % 2)
            here = 0 if j <= 0 else 6 * r - into
            if most is None:
                spread_row(seen, along, down, across, curve, scratch, slots, row, here)
            else:
                turn = stages.turn if j < 0 else j % 2
                if row == begin:
                    flux_row(seen, along, down, across, curve, scratch, slots, row - 2, here)
                for ahead in range(row - 1 if row == begin else row + 1, row + 2):
                    flux_row(seen, along, down, across, curve, scratch, slots, ahead, here)
                    open_row(
                        seen, held, fibre, most, floor, factors, scratch, law, slots, ahead, r, here, 2 * r * (1 + turn)
                    )
                keep_factors(factors, scratch, slots, row, r, 2 * r * (2 - turn))
                if j >= 0:
                    limited_row(scratch, slots, row)
            if j >= 0:
                end_row(
                    row, here, into, j, coefs, law, r, mobile, slope, seen, held, bite, fibre, floor, scratch,
                    slots + RATES,
                )  # fmt: skip


@parallel_kernel
def pass_bands(
    stages: Any, law: Any, coefs: Any, cuts: Any, weights: Any, curve: Any, amounts: Any, bite: Any, fibre: Any,
    floor: Any, most: Any,
) -> None:  # fmt: skip
    """What of a pass the bands can take without each other."""
    bands, depth = cuts.shape[0] - 1, 1 if most is None else 2
    for b in prange(bands):
        pass_rows(
            cuts[b], cuts[b + 1] - 1, depth if b > 0 else 0, -depth if b < bands - 1 else 0, stages, law, coefs,
            weights.along, weights.down, weights.across, curve, amounts.mobile, amounts.slope, amounts.seen,
            amounts.held, bite, fibre, floor, most, amounts.factors, amounts.scratch[b],
        )  # fmt: skip


@parallel_kernel
def pass_between(
    stages: Any, law: Any, coefs: Any, cuts: Any, weights: Any, curve: Any, amounts: Any, bite: Any, fibre: Any,
    floor: Any, most: Any,
) -> None:  # fmt: skip
    """The rest of a pass, between the bands. A loop of its own: numba would fuse it."""
    depth = 1 if most is None else 2
    for b in prange(1, cuts.shape[0] - 1):
        pass_rows(
            cuts[b], cuts[b] - 1, -depth, depth, stages, law, coefs,
            weights.along, weights.down, weights.across, curve, amounts.mobile, amounts.slope, amounts.seen,
            amounts.held, bite, fibre, floor, most, amounts.factors, amounts.scratch[b],
        )  # fmt: skip


@kernel
def super_step(
    coefs: Any,
    law: Any,
    cuts: Any,
    weights: Any,
    curve: Any,
    amounts: Any,
    bite: Any,
    fibre: Any,
    floor: Any,
    most: Any,
) -> None:
    """All stages, (s, 4) coefficients mu, nu, mu', gamma'; the last, as s is odd, is in the even plane.

    cuts (b + 1,) are first rows of the bands, and the one after the last. `curve` is None where D is constant, `most`
    (V_u) where nothing can be limited. `bite`, what fibre takes at first, and `fibre`, V_d, are any where nothing is
    adsorbed, as `floor` where nothing is kept up.
    """
    levels = amounts.scratch.shape[1] // ROWS
    if most is not None:
        amounts.factors[:] = 0.0
        for n in range(SETTLING):
            pass_bands(Stages(-1, 1, n % 2), law, coefs, cuts, weights, curve, amounts, bite, fibre, floor, most)
    for first in range(0, coefs.shape[0], levels):
        stages = Stages(first, min(levels, coefs.shape[0] - first), 0)
        pass_bands(stages, law, coefs, cuts, weights, curve, amounts, bite, fibre, floor, most)
        if cuts.shape[0] > 2 and stages.number > 1:
            pass_between(stages, law, coefs, cuts, weights, curve, amounts, bite, fibre, floor, most)
