"""The whole explicit step: adsorption, then diffusion that fills no cell beyond its capacity.

Fibre takes dye by nuno_dye.laws.adsorption. All faces then compute their flux from the same phi. A cell that would be
filled beyond V_u scales its inflow by (V_u - phi) / inflow, one that would be emptied its outflow by phi / outflow, and
a face uses the smaller of its two factors, so dye is conserved. If no factor is below 1 the result has the bits of
`nuno_dye.solvers.diffusion`.

A level of a row needs two rows more on either side than it writes: the fluxes of its neighbours' neighbours decide
their factors. So each level of a pass runs two rows behind the previous one. One loop over a row's vectors does all of
a level's work there: fibre takes dye in the row below, the row's fluxes and factors are computed, and with them the row
above moves. Rejected: a loop for each of these, which reads and writes more, beyond the first cache.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numba import prange

from nuno_dye.laws.adsorption import Law, Uptake, adsorb, adsorb_both, law_in
from nuno_dye.laws.diffusivity import Curve, potentials
from nuno_dye.solvers.diffusion import LEFT, Rows, renew_ghosts, slide
from nuno_dye.solvers.solving import Upkeep, keep_both
from nuno_kernels import block_kernel, kernel, parallel_kernel
from nuno_kernels.lanes import WIDTH, higher, load, lower, splat, store, where_not_negative
from nuno_schemas.fabric import Float

LEVELS = 4
"""Steps of a pass; a row of 800 x 2 cells has 85 kB, and its scratch 72 kB a step. Three to six are equal within the
spread of `nuno bench speed dye`."""
RIGHT, DOWN, CAME, WENT, UP, THROUGH, SCRATCH_ROWS = 0, 2, 4, 6, 8, 10, 11
"""Rows of scratch for a row of cells, of either layer: its fluxes to the right and down, its factors of inflow and
outflow, and the scaled flux from above; the flux between the layers; and the number of these rows."""
EMPTYING = 0.99
"""Share of a cell's amount that may flow out of it in a step without factors of outflow, which are then 1, with a
margin for rounding, and cost a division and memory."""
BELOW_ONE = 1.0 - 2.0**-50
"""Ratio of scaled flows to the amount, or the free capacity: rounding then neither empties a cell below 0 nor overfills
it."""


class DyeBands(NamedTuple):
    """The data of a step, in bands as in nuno_dye.solvers.diffusion.Bands.

    mobile     (b, 2 r, w)  capacity V_u for mobile dye
    rolling    (b, 11 levels, w)  scratch: fluxes and factors of a row of both layers, by level
    empties    whether any cell may be emptied
    """

    phi: Float
    along: Float
    down: Float
    across: Float
    mobile: Float
    rolling: Float
    first: Rows
    last: Rows
    shrinks: Rows
    empties: bool


@kernel
def scale_of(flow: Any, available: Any) -> Any:
    """Return the factor that limits a flow to the available amount."""
    return higher(lower(splat(BELOW_ONE) * available / flow, splat(1.0)), splat(0.0))


@kernel
def inflow(left: Any, right: Any, up: Any, down: Any, other: Any) -> Any:
    """Return the inflow of a cell over its five faces."""
    nothing = splat(0.0)
    came = higher(right, nothing) - lower(left, nothing) + higher(down, nothing) - lower(up, nothing)
    return came + higher(other, nothing)


@kernel
def outflow(left: Any, right: Any, up: Any, down: Any, other: Any) -> Any:
    """Return the outflow of a cell over its five faces."""
    nothing = splat(0.0)
    went = higher(left, nothing) - lower(right, nothing) + higher(up, nothing) - lower(down, nothing)
    return went - lower(other, nothing)


@kernel
def scaled(flow: Any, came: Any, went: Any, other_came: Any, other_went: Any, empties: bool) -> Any:
    """Return a flow between this cell and another, times the smaller of the receiver's and the donor's factors."""
    if empties:
        came, other_came = lower(came, other_went), lower(other_came, went)
    return flow * where_not_negative(flow, came, other_came)


@kernel
def start_row(phi: Float, down: Float, across: Float, curve: Curve | None, scratch: Float, base: int, row: int) -> None:
    """Compute the fluxes from row `row` down into the next one."""
    for layer in range(2):
        at = row + layer * across.shape[0]
        for c in range(LEFT, phi.shape[1] - WIDTH, WIDTH):
            flow = load(down, at, c) * (potentials(load(phi, at + 1, c), curve) - potentials(load(phi, at, c), curve))
            store(scratch, base + DOWN + layer, c, flow)


class Level(NamedTuple):
    """A level of a pass at a row: the law of adsorption if there is any, the potential if D is not constant, the first
    row of its scratch, the row's number, whether any cell may be emptied, and whether the row above steps.
    """

    law: Law | None
    curve: Curve | None
    base: int
    row: int
    empties: bool
    moves: bool


@kernel
def step_row(
    phi: Float, fixed: Float, fibre: Float, along: Float, down: Float, across: Float, mobile: Float, scratch: Float,
    level: Level,
) -> None:  # fmt: skip
    """Compute fluxes and factors of a row's cells, with which the row above steps if it moves. `scratch` holds fluxes
    and factors of the row above, and gets, vector by vector, those of this one.
    """
    law, curve, base, row, empties, moves = level
    other, one, nothing = row + across.shape[0], splat(1.0), splat(0.0)
    left_0, left_1, moved_0, moved_1 = nothing, nothing, nothing, nothing
    went_0, went_1, above_went_0, above_went_1, next_went_0, next_went_1 = one, one, one, one, one, one
    for c in range(LEFT, phi.shape[1] - WIDTH, WIDTH):
        here_0, here_1 = load(phi, row, c), load(phi, other, c)
        level_0, level_1 = potentials(here_0, curve), potentials(here_1, curve)
        right_0 = load(along, row, c) * (potentials(load(phi, row, c + 1), curve) - level_0)
        right_1 = load(along, other, c) * (potentials(load(phi, other, c + 1), curve) - level_1)
        below_0 = adsorb(phi, fixed, fibre, row + 1, c, law)
        below_1 = adsorb(phi, fixed, fibre, other + 1, c, law)
        down_0 = load(down, row, c) * (potentials(below_0, curve) - level_0)
        down_1 = load(down, other, c) * (potentials(below_1, curve) - level_1)
        through = load(across, row, c) * (level_1 - level_0)
        up_0, up_1 = load(scratch, base + DOWN, c), load(scratch, base + DOWN + 1, c)
        near_0, near_1 = slide(left_0, right_0), slide(left_1, right_1)
        left_0, left_1 = right_0, right_1
        came_0 = scale_of(inflow(near_0, right_0, up_0, down_0, through), load(mobile, row, c) - here_0)
        came_1 = scale_of(inflow(near_1, right_1, up_1, down_1, nothing - through), load(mobile, other, c) - here_1)
        above_0, above_1 = load(scratch, base + CAME, c), load(scratch, base + CAME + 1, c)
        if empties:
            went_0 = scale_of(outflow(near_0, right_0, up_0, down_0, through), here_0)
            went_1 = scale_of(outflow(near_1, right_1, up_1, down_1, nothing - through), here_1)
            above_went_0, above_went_1 = load(scratch, base + WENT, c), load(scratch, base + WENT + 1, c)
            next_went_0, next_went_1 = load(scratch, base + WENT, c + 1), load(scratch, base + WENT + 1, c + 1)
        passed_0 = scaled(up_0, above_0, above_went_0, came_0, went_0, empties)
        passed_1 = scaled(up_1, above_1, above_went_1, came_1, went_1, empties)
        if moves:
            next_0, next_1 = load(scratch, base + CAME, c + 1), load(scratch, base + CAME + 1, c + 1)
            along_0 = scaled(load(scratch, base + RIGHT, c), above_0, above_went_0, next_0, next_went_0, empties)
            along_1 = scaled(load(scratch, base + RIGHT + 1, c), above_1, above_went_1, next_1, next_went_1, empties)
            between = scaled(load(scratch, base + THROUGH, c), above_0, above_went_0, above_1, above_went_1, empties)
            sum_0 = (along_0 - slide(moved_0, along_0)) + (passed_0 - load(scratch, base + UP, c)) + between
            sum_1 = (along_1 - slide(moved_1, along_1)) + (passed_1 - load(scratch, base + UP + 1, c)) - between
            store(phi, row - 1, c, load(phi, row - 1, c) + sum_0)
            store(phi, other - 1, c, load(phi, other - 1, c) + sum_1)
            moved_0, moved_1 = along_0, along_1
        store(scratch, base + RIGHT, c, right_0)
        store(scratch, base + RIGHT + 1, c, right_1)
        store(scratch, base + DOWN, c, down_0)
        store(scratch, base + DOWN + 1, c, down_1)
        store(scratch, base + THROUGH, c, through)
        store(scratch, base + CAME, c, came_0)
        store(scratch, base + CAME + 1, c, came_1)
        store(scratch, base + UP, c, passed_0)
        store(scratch, base + UP + 1, c, passed_1)
        if empties:
            store(scratch, base + WENT, c, went_0)
            store(scratch, base + WENT + 1, c, went_1)


@block_kernel
def pass_over_dye(
    levels: int, bands: DyeBands, uptake: Uptake | None, upkeep: Upkeep | None, curve: Curve | None, n: int
) -> None:
    """Take `levels` steps of band `n`: a row is adsorbed two ahead of the one that moves, with factors one ahead."""
    phi, along, down, across = bands.phi[n], bands.along[n], bands.down[n], bands.across[n]
    mobile, rolling, r, empties = bands.mobile[n], bands.rolling[n], bands.across.shape[1], bands.empties
    first, last, up, low = bands.first[n], bands.last[n], bands.shrinks[n, 0], bands.shrinks[n, 1]
    fixed, fibre, law = phi, phi, None if uptake is None else law_in(uptake)
    if uptake is not None:
        fixed, fibre = uptake.fixed[n], uptake.fibre[n]
    for at in range(first - 2 * up * (levels - 1) - 4, last + 2 * low * (levels - 1) + 2 * levels + 2):
        for level in range(levels):
            base, beyond = SCRATCH_ROWS * level, 2 * (levels - 1 - level)
            start, stop, row = first - up * beyond, last + low * beyond, at - 2 * level
            if start - 1 <= row + 2 <= stop + 2:
                if row + 1 == start - 2:
                    if uptake is not None:
                        adsorb_both(phi, uptake, n, LEFT, row + 1, r)
                        adsorb_both(phi, uptake, n, LEFT, row + 2, r)
                    start_row(phi, down, across, curve, rolling, base, row + 1)
                elif row + 1 > start - 2:
                    here = Level(law, curve, base, row + 1, empties, row >= start)
                    step_row(phi, fixed, fibre, along, down, across, mobile, rolling, here)
                if row >= start and upkeep is not None:
                    keep_both(phi, upkeep, n, LEFT, row, r)


@parallel_kernel
def pass_dye_bands(
    levels: int, bands: DyeBands, uptake: Uptake | None, upkeep: Upkeep | None, curve: Curve | None
) -> None:
    """Take `levels` steps of all bands."""
    for n in prange(bands.phi.shape[0]):
        pass_over_dye(levels, bands, uptake, upkeep, curve, n)


@kernel
def dye(
    steps: int, bands: DyeBands, uptake: Uptake | None, upkeep: Upkeep | None, curve: Curve | None, leave: Rows
) -> None:
    """Take `steps` steps, LEVELS in a pass, until `leave` (1,) is not 0; `uptake`, `upkeep`, `curve` may be None."""
    for done in range(0, steps, LEVELS):
        if leave[0] != 0:
            break
        pass_dye_bands(min(LEVELS, steps - done), bands, uptake, upkeep, curve)
        renew_ghosts(bands, bands.phi, 2 * LEVELS)
        if uptake is not None:
            renew_ghosts(bands, uptake.fixed, 2 * LEVELS)
