"""A super-step of the Runge-Kutta-Legendre method: all of its stages in one compiled call.

    Y_j = Y_0 + mu_j (Y_j-1 - Y_0) + nu_j (Y_j-2 - Y_0) + mu'_j dt M(Y_j-1) + gamma'_j dt M(Y_0)

(Meyer, Balsara and Aslam 2014, equation 15). Written in differences from Y_0, rounding of the coefficients makes
no dye: M moves it over faces, and what one cell loses the other gains.

M is that of the explicit step as its step goes to 0. A cell that is full lets in as much as goes out of it and as
its fibre takes: its inflow is scaled by (outflow + taken + pace (V_u - phi)) / inflow, if that is below 1, `pace`
being how fast it comes to its capacity. Outflow into cells that are full themselves is what their factors of the
stage before let through. A kept-up cell acts on its neighbours as though it held its floor, while its own sum runs on,
so that at the end it tells what must be given. Adsorption is part of M (nuno_dye.fixing).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numba import prange

from nuno_dye.diffusion import LEFT, slide
from nuno_dye.fixing import take_row, taken_at
from nuno_kernels import kernel, parallel_kernel
from nuno_kernels.simd import WIDTH, load, splat, store
from nuno_kernels.simd_choose import higher, lower, where_greater
from nuno_schemas.fabric import Float

SLOT = 7
"""Rows of scratch for a row of cells: fluxes to the right, down, and between the layers, and the layers' factors."""
RATES = 4 * SLOT
"""Where in the scratch the two layers' M of a row are, and after them what fibre takes."""
SETTLING = 4
"""Passes that find the first stage's factors, from 0 on: as many full cells in a row let dye through at once."""


class Planes(NamedTuple):
    """Amounts before a step and in its stages, (2 r, w) each, weft rows before warp rows."""

    start: Float
    even: Float
    odd: Float


class Amounts(NamedTuple):
    """One dye while it takes a step.

    mobile   phi, raw; `slope` is dt M(Y_0)
    seen     what neighbours see of it: `mobile` itself, but where it is kept up no less than its floor
    held     what fibre has taken, any where it takes nothing
    factors  of even and odd stages, any where nothing is limited
    scratch  (bands, 4 SLOT + 4, w)
    """

    mobile: Planes
    slope: Float
    seen: Planes
    held: Planes
    factors: Planes
    scratch: Float


class Weights(NamedTuple):
    """D dt / d^2 of the faces: to the next column and the next row (2 r, w), between the layers (r, w)."""

    along: Float
    down: Float
    across: Float


@kernel
def spread_row(seen: Any, along: Any, down: Any, across: Any, scratch: Any, row: int) -> None:
    """M of a row's cells where no limit can bind."""
    other = row + across.shape[0]
    left_0, left_1 = splat(0.0), splat(0.0)
    for c in range(LEFT, seen.shape[1] - WIDTH, WIDTH):
        phi_0, phi_1 = load(seen, row, c), load(seen, other, c)
        right_0 = load(along, row, c) * (load(seen, row, c + 1) - phi_0)
        right_1 = load(along, other, c) * (load(seen, other, c + 1) - phi_1)
        down_0 = load(down, row, c) * (load(seen, row + 1, c) - phi_0)
        down_1 = load(down, other, c) * (load(seen, other + 1, c) - phi_1)
        up_0 = load(down, row - 1, c) * (phi_0 - load(seen, row - 1, c))
        up_1 = load(down, other - 1, c) * (phi_1 - load(seen, other - 1, c))
        through = load(across, row, c) * (phi_1 - phi_0)
        store(scratch, RATES, c, (right_0 - slide(left_0, right_0)) + (down_0 - up_0) + through)
        store(scratch, RATES + 1, c, (right_1 - slide(left_1, right_1)) + (down_1 - up_1) - through)
        left_0, left_1 = right_0, right_1


@kernel
def begin_row(out: Any, start: Any, slope: Any, scratch: Any, of: int, row: int, first: float) -> None:
    """The first stage of a row of one layer, whose M is scratch[of]; keeps it."""
    for c in range(LEFT, out.shape[1] - WIDTH, WIDTH):
        rate = load(scratch, of, c)
        store(slope, row, c, rate)
        store(out, row, c, load(start, row, c) + first * rate)


@kernel
def finish_row(
    out: Any, start: Any, slope: Any, here: Any, scratch: Any, of: int, row: int,
    mu: float, nu: float, new: float, old: float,
) -> None:  # fmt: skip
    """A later stage of a row of one layer."""
    for c in range(LEFT, out.shape[1] - WIDTH, WIDTH):
        begun, rate = load(start, row, c), load(scratch, of, c)
        steps = mu * (load(here, row, c) - begun) + nu * (load(out, row, c) - begun)
        store(out, row, c, begun + (steps + (new * rate + old * load(slope, row, c))))


@kernel
def see_row(seen: Any, out: Any, floor: Any, row: int) -> None:
    """What neighbours see of a row."""
    for c in range(LEFT, out.shape[1] - WIDTH, WIDTH):
        store(seen, row, c, higher(load(floor, row, c), load(out, row, c)))


@kernel
def advance_row(
    out: Any, start: Any, slope: Any, here: Any, scratch: Any, of: int, row: int, coefs: Any, j: int
) -> None:
    """Stage `j` of a row of one layer, from its M."""
    if j == 0:
        begin_row(out, start, slope, scratch, of, row, coefs[0, 2])
    else:
        finish_row(out, start, slope, here, scratch, of, row, coefs[j, 0], coefs[j, 1], coefs[j, 2], coefs[j, 3])


@kernel
def end_row(
    seen: Any, out: Any, start: Any, slope: Any, here: Any, held: Any, bound: Any, taking: Any, scratch: Any,
    seen_out: Any, floor: Any, row: int, r: int, pace: float, coefs: Any, j: int,
) -> None:  # fmt: skip
    """Stage `j` of a row of both layers, from what diffusion brings it."""
    for layer in range(2):
        at, of = row + layer * r, RATES + layer
        if taking is not None:
            take_row(seen, held, taking, scratch, of, at, pace)
            advance_row(bound, taking.start, taking.slope, held, scratch, of + 2, at, coefs, j)
        advance_row(out, start, slope, here, scratch, of, at, coefs, j)
        if floor is not None:
            see_row(seen_out, out, floor, at)


@kernel
def flux_row(seen: Any, along: Any, down: Any, across: Any, scratch: Any, row: int) -> None:
    """Fluxes of a row's faces into its slot."""
    other, slot = row + across.shape[0], SLOT * (row % 4)
    for c in range(LEFT, seen.shape[1] - WIDTH, WIDTH):
        phi_0, phi_1 = load(seen, row, c), load(seen, other, c)
        store(scratch, slot, c, load(along, row, c) * (load(seen, row, c + 1) - phi_0))
        store(scratch, slot + 1, c, load(along, other, c) * (load(seen, other, c + 1) - phi_1))
        store(scratch, slot + 2, c, load(down, row, c) * (load(seen, row + 1, c) - phi_0))
        store(scratch, slot + 3, c, load(down, other, c) * (load(seen, other + 1, c) - phi_1))
        store(scratch, slot + 4, c, load(across, row, c) * (phi_1 - phi_0))


@kernel
def open_row(
    seen: Any, held: Any, taking: Any, mobile: Any, floor: Any, passed: Any, scratch: Any, pace: float, row: int, r: int
) -> None:
    """Factors of the inflow of a row's cells.

    What flows out of a kept-up cell the supply replaces; what fibre takes leaves room there, too.
    """
    slot, above, nothing = SLOT * (row % 4), SLOT * ((row - 1) % 4), splat(0.0)
    for layer in range(2):
        before, at, sign, other_at = splat(0.0), row + layer * r, 1.0 - 2.0 * layer, row + r - layer * r
        for c in range(LEFT, seen.shape[1] - WIDTH, WIDTH):
            right, down = load(scratch, slot + layer, c), load(scratch, slot + 2 + layer, c)
            left, up = slide(before, right), load(scratch, above + 2 + layer, c)
            other = sign * load(scratch, slot + 4, c)
            came = higher(right, nothing) - lower(left, nothing) + higher(down, nothing) - lower(up, nothing)
            came = came + higher(other, nothing)
            went = higher(left, nothing) * load(passed, at, c - 1) - lower(right, nothing) * load(passed, at, c + 1)
            went = went + higher(up, nothing) * load(passed, at - 1, c) - lower(down, nothing) * load(passed, at + 1, c)
            went = went - lower(other, nothing) * load(passed, other_at, c)
            if floor is not None:
                went = went - where_greater(load(floor, at, c), nothing, went)
            if taking is not None:
                went = went + taken_at(seen, held, taking, at, c, pace)
            share = (went + pace * (load(mobile, at, c) - load(seen, at, c))) / came
            store(scratch, slot + 5 + layer, c, higher(lower(share, splat(1.0)), nothing))
            before = right


@kernel
def scaled(flow: Any, here: Any, other: Any) -> Any:
    """A flow into this cell by its factor, one out of it by the other's."""
    return higher(flow, splat(0.0)) * here + lower(flow, splat(0.0)) * other


@kernel
def limited_row(scratch: Any, row: int) -> None:
    """M of a row's cells, from fluxes and factors of its own and of the rows above and below."""
    slot, above, below = SLOT * (row % 4), SLOT * ((row - 1) % 4), SLOT * ((row + 1) % 4)
    for layer in range(2):
        sign, before, mine = 1.0 - 2.0 * layer, splat(0.0), 5 + layer
        for c in range(LEFT, scratch.shape[1] - WIDTH, WIDTH):
            factor = load(scratch, slot + mine, c)
            right = scaled(load(scratch, slot + layer, c), factor, load(scratch, slot + mine, c + 1))
            down = scaled(load(scratch, slot + 2 + layer, c), factor, load(scratch, below + mine, c))
            up = scaled(load(scratch, above + 2 + layer, c), load(scratch, above + mine, c), factor)
            through = scaled(load(scratch, slot + 4, c), load(scratch, slot + 5, c), load(scratch, slot + 6, c))
            store(scratch, RATES + layer, c, (right - slide(before, right)) + (down - up) + sign * through)
            before = right


@kernel
def keep_factors(passing: Any, scratch: Any, row: int, r: int) -> None:
    """Factors of a row, for the next stage."""
    for layer in range(2):
        for c in range(LEFT, passing.shape[1] - WIDTH, WIDTH):
            store(passing, row + layer * r, c, load(scratch, SLOT * (row % 4) + 5 + layer, c))


@kernel
def stage_rows(
    first: int, last: int, seen: Any, here: Any, out: Any, seen_out: Any, along: Any, down: Any, across: Any,
    start: Any, slope: Any, held: Any, bound: Any, taking: Any, scratch: Any, floor: Any, mobile: Any,
    passed: Any, passing: Any, pace: float, coefs: Any, j: int,
) -> None:  # fmt: skip
    """Stage `j` of some rows; -1 finds factors alone."""
    r = across.shape[0]
    if mobile is None:
        for row in range(first, last + 1):
            spread_row(seen, along, down, across, scratch, row)
            end_row(
                seen, out, start, slope, here, held, bound, taking, scratch, seen_out, floor, row, r, pace, coefs, j
            )
    else:
        for ahead in range(first - 2, last + 2):
            flux_row(seen, along, down, across, scratch, ahead)
            if ahead >= first - 1:
                open_row(seen, held, taking, mobile, floor, passed, scratch, pace, ahead, r)
            if ahead > first:
                keep_factors(passing, scratch, ahead - 1, r)
                if j >= 0:
                    limited_row(scratch, ahead - 1)
                    end_row(
                        seen, out, start, slope, here, held, bound, taking, scratch, seen_out, floor, ahead - 1, r,
                        pace, coefs, j,
                    )  # fmt: skip


@parallel_kernel
def stage_bands(
    cuts: Any, seen: Any, here: Any, out: Any, seen_out: Any, weights: Any, start: Any, slope: Any,
    held: Any, bound: Any, taking: Any, scratch: Any, floor: Any, mobile: Any, passed: Any, passing: Any,
    pace: float, coefs: Any, j: int,
) -> None:  # fmt: skip
    """Stage `j` of all rows."""
    for b in prange(cuts.shape[0] - 1):
        stage_rows(
            cuts[b], cuts[b + 1] - 1, seen, here, out, seen_out, weights.along, weights.down, weights.across,
            start, slope, held, bound, taking, scratch[b], floor, mobile, passed, passing, pace, coefs, j,
        )  # fmt: skip


@kernel
def plane(of: Any, which: int) -> Any:
    """Start, even or odd amounts."""
    if which == 0:
        return of.start
    return of.even if which == 1 else of.odd


@kernel
def super_step(
    coefs: Any, pace: float, cuts: Any, weights: Any, amounts: Any, taking: Any, floor: Any, mobile: Any
) -> None:
    """All stages, (s, 4) coefficients mu, nu, mu', gamma'; the last, as s is odd, is in `even`.

    `taking` is None where nothing is adsorbed, `floor` where nothing is kept up, `mobile` (V_u) where nothing can be
    limited.
    """
    phi, seen, passed = amounts.mobile, amounts.seen, amounts.factors
    if mobile is not None:
        passed.even[:] = 0.0
        for n in range(SETTLING):
            stage_bands(
                cuts, seen.start, phi.start, phi.even, seen.even, weights, phi.start, amounts.slope,
                amounts.held.start, amounts.held.even, taking, amounts.scratch, floor, mobile,
                plane(passed, 1 + n % 2), plane(passed, 2 - n % 2), pace, coefs, -1,
            )  # fmt: skip
    for j in range(coefs.shape[0]):
        into = 1 + j % 2
        here = 0 if j == 0 else 3 - into
        stage_bands(
            cuts, plane(seen, here), plane(phi, here), plane(phi, into), plane(seen, into), weights,
            phi.start, amounts.slope, plane(amounts.held, here), plane(amounts.held, into), taking, amounts.scratch,
            floor, mobile,
            plane(passed, 1 + j % 2), plane(passed, 2 - j % 2), pace, coefs, j,
        )  # fmt: skip
