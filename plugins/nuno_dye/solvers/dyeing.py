"""The whole explicit step: adsorption first, then diffusion that fills no cell beyond its capacity.

Fibre takes what nuno_dye.laws.adsorption says. All faces then take their flux from the same phi; a cell that would be
filled beyond V_u scales its inflow by (V_u - phi) / inflow, one that would be emptied its outflow by phi / outflow,
and a face uses the smaller of its two factors, so dye is kept. Where no factor is below 1 the result has the bits
of `nuno_dye.solvers.diffusion`.

A level of a row needs two rows more on either side than it writes: the fluxes of its neighbours' neighbours decide
their factors. So each level of a pass runs two rows behind the one before.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numba import prange

from nuno_dye.laws.adsorption import Uptake, adsorb_both
from nuno_dye.laws.potential import Curve, potentials
from nuno_dye.solvers.diffusion import LEFT, Rows, renew_ghosts, slide
from nuno_dye.solvers.upkeep import Upkeep, keep_both
from nuno_kernels import block_kernel, kernel, parallel_kernel
from nuno_kernels.lanes.choose import higher, lower
from nuno_kernels.lanes.simd import WIDTH, load, splat, store
from nuno_schemas.fabric import Float

LEVELS = 3
"""Steps of a pass; a row of 800 x 2 cells has 110 kB."""
SLOT = 9
"""Rows of scratch for a row of cells: fluxes to the right, down, and between the layers, factors in and out."""
BELOW_ONE = 1.0 - 2.0**-50
"""Scaled flows are smaller by this much than what there is, or is room for: rounding then neither empties a cell
below nothing nor fills it beyond."""


class DyeBands(NamedTuple):
    """What a step needs, in bands as in nuno_dye.solvers.diffusion.Bands.

    mobile     (b, 2 r, w)  capacity V_u for mobile dye
    rolling    (b, 36 levels, w)  scratch: fluxes and factors of four rows of both layers, by level
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


@kernel
def flux_row(
    phi: Float, along: Float, down: Float, across: Float, curve: Curve | None, scratch: Float, slot: int, row: int,
    here: int,
) -> None:  # fmt: skip
    """Fluxes of a row's faces into rows `slot` and on of `scratch`: to the right and down in either layer, and between
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
def scale_of(flow: Any, there: Any) -> Any:
    """What a flow is multiplied with so that it is no more than there is."""
    return higher(lower(splat(BELOW_ONE) * there / flow, splat(1.0)), splat(0.0))


@kernel
def factor_row(phi: Float, mobile: Float, rolling: Float, base: int, row: int, r: int) -> None:
    """Factors of a row's cells, from the fluxes of all their faces: of what flows in, and of what flows out."""
    slot, above, nothing = base + SLOT * (row % 4), base + SLOT * ((row - 1) % 4), splat(0.0)
    for layer in range(2):
        before, at, sign = splat(0.0), row + layer * r, 1.0 - 2.0 * layer
        for c in range(LEFT, phi.shape[1] - WIDTH, WIDTH):
            right, down = load(rolling, slot + layer, c), load(rolling, slot + 2 + layer, c)
            left, up = slide(before, right), load(rolling, above + 2 + layer, c)
            other = sign * load(rolling, slot + 4, c)
            came = higher(right, nothing) - lower(left, nothing) + higher(down, nothing) - lower(up, nothing)
            went = higher(left, nothing) - lower(right, nothing) + higher(up, nothing) - lower(down, nothing)
            came, went = came + higher(other, nothing), went - lower(other, nothing)
            there = load(phi, at, c)
            store(rolling, slot + 5 + layer, c, scale_of(came, load(mobile, at, c) - there))
            store(rolling, slot + 7 + layer, c, scale_of(went, there))
            before = right


@kernel
def scaled(flow: Any, came: Any, went: Any, other_came: Any, other_went: Any) -> Any:
    """A flow from the other cell into this one, or the other way: the smaller of receiver's and donor's factors."""
    nothing = splat(0.0)
    return higher(flow, nothing) * lower(came, other_went) + lower(flow, nothing) * lower(other_came, went)


@kernel
def scale_down(rolling: Float, base: int, row: int) -> None:
    """Scale the fluxes between a row and the next one."""
    slot, below = base + SLOT * (row % 4), base + SLOT * ((row + 1) % 4)
    for layer in range(2):
        came, went = 5 + layer, 7 + layer
        for c in range(LEFT, rolling.shape[1] - WIDTH, WIDTH):
            flow = scaled(
                load(rolling, slot + 2 + layer, c),
                load(rolling, slot + came, c), load(rolling, slot + went, c),
                load(rolling, below + came, c), load(rolling, below + went, c),
            )  # fmt: skip
            store(rolling, slot + 2 + layer, c, flow)


@kernel
def move_row(phi: Float, rolling: Float, base: int, row: int, r: int) -> None:
    """Let the scaled fluxes of a row's faces flow; those to the rows above and below are scaled already."""
    slot, above = base + SLOT * (row % 4), base + SLOT * ((row - 1) % 4)
    left_0, left_1 = splat(0.0), splat(0.0)
    for c in range(LEFT, phi.shape[1] - WIDTH, WIDTH):
        came_0, came_1 = load(rolling, slot + 5, c), load(rolling, slot + 6, c)
        went_0, went_1 = load(rolling, slot + 7, c), load(rolling, slot + 8, c)
        right_0 = scaled(
            load(rolling, slot, c), came_0, went_0, load(rolling, slot + 5, c + 1), load(rolling, slot + 7, c + 1)
        )
        right_1 = scaled(
            load(rolling, slot + 1, c), came_1, went_1, load(rolling, slot + 6, c + 1), load(rolling, slot + 8, c + 1)
        )
        through = scaled(load(rolling, slot + 4, c), came_0, went_0, came_1, went_1)
        down_0 = load(rolling, slot + 2, c) - load(rolling, above + 2, c)
        down_1 = load(rolling, slot + 3, c) - load(rolling, above + 3, c)
        phi_0, phi_1 = load(phi, row, c), load(phi, row + r, c)
        store(phi, row, c, phi_0 + ((right_0 - slide(left_0, right_0)) + down_0 + through))
        store(phi, row + r, c, phi_1 + ((right_1 - slide(left_1, right_1)) + down_1 - through))
        left_0, left_1 = right_0, right_1


@block_kernel
def pass_over_dye(
    levels: int, bands: DyeBands, uptake: Uptake | None, upkeep: Upkeep | None, curve: Curve | None, n: int
) -> None:
    """`levels` steps of band `n`: rows are adsorbed two ahead, their fluxes and factors known one ahead."""
    phi, along, down, across = bands.phi[n], bands.along[n], bands.down[n], bands.across[n]
    mobile, rolling, r = bands.mobile[n], bands.rolling[n], bands.across.shape[1]
    first, last, up, low = bands.first[n], bands.last[n], bands.shrinks[n, 0], bands.shrinks[n, 1]
    for at in range(first - 2 * up * (levels - 1) - 4, last + 2 * low * (levels - 1) + 2 * levels + 2):
        for level in range(levels):
            base, beyond = 4 * SLOT * level, 2 * (levels - 1 - level)
            start, stop, row = first - up * beyond, last + low * beyond, at - 2 * level
            ahead = row + 2
            if start - 2 <= ahead <= stop + 2:
                if uptake is not None:
                    adsorb_both(phi, uptake, n, LEFT, ahead, r)
                if ahead > start - 2:
                    slot = base + SLOT * ((ahead - 1) % 4)
                    flux_row(phi, along, down, across, curve, rolling, slot, ahead - 1, 0)
                if ahead >= start:
                    factor_row(phi, mobile, rolling, base, ahead - 1, r)
            if start - 1 <= row <= stop:
                scale_down(rolling, base, row)
                if row >= start:
                    move_row(phi, rolling, base, row, r)
                    if upkeep is not None:
                        keep_both(phi, upkeep, n, LEFT, row, r)


@parallel_kernel
def pass_dye_bands(
    levels: int, bands: DyeBands, uptake: Uptake | None, upkeep: Upkeep | None, curve: Curve | None
) -> None:
    """`levels` steps of all bands."""
    for n in prange(bands.phi.shape[0]):
        pass_over_dye(levels, bands, uptake, upkeep, curve, n)


@kernel
def dye(steps: int, bands: DyeBands, uptake: Uptake | None, upkeep: Upkeep | None, curve: Curve | None) -> None:
    """`steps` steps, LEVELS of them in a pass; `uptake`, `upkeep` and `curve` may be None."""
    for done in range(0, steps, LEVELS):
        pass_dye_bands(min(LEVELS, steps - done), bands, uptake, upkeep, curve)
        renew_ghosts(bands, bands.phi, 2 * LEVELS)
        if uptake is not None:
            renew_ghosts(bands, uptake.fixed, 2 * LEVELS)
