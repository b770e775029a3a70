"""Explicit diffusion between cells, several steps in one pass through memory.

    phi_i += sum over faces w_face (phi_j - phi_i),  w = D dt / d^2,

with four faces in the layer and one to the other layer. A step reads as many weights as amounts, so that memory limits
the speed of single steps. Here a band of rows takes `levels` steps while its rows are in the core's cache: level s + 1
of a row follows level s of the row below it, so the sweep runs one row behind for each level, in place. Every face's
flux is computed once and added to both sides, so dye is conserved to rounding. The result is the same to the last bit
for any division of rows into bands and of steps into passes.

A band has `ghost` rows of its neighbours on either side, which it also steps: one row fewer is right after each level,
and they are copied again after `ghost` levels.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import prange
from numpy.typing import NDArray

from nuno_dye.laws.adsorption import Uptake, adsorb_both
from nuno_dye.solvers.solving import Upkeep, keep_both
from nuno_kernels import block_kernel, kernel, parallel_kernel
from nuno_kernels.lanes import WIDTH, instruction, load, splat, store, vector
from nuno_schemas.fabric import Float

Rows = NDArray[np.int64]
GHOST = 8
"""Steps of a pass. Their rows (a row of 800 x 2 cells has 58 kB of amounts and weights) must fit into a core's cache,
and few rows may be stepped twice."""
LEFT = WIDTH
"""Columns before the first cell, without weight, which vectors may read to the left."""


@instruction(vector, vector, vector)
def slide(builder: Any, before: Any, here: Any) -> Any:
    """Return the eight lanes that begin one before `here`: the last of `before`, then all of `here` but its last."""
    mask = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), list(range(WIDTH - 1, 2 * WIDTH - 1)))
    return builder.shuffle_vector(before, here, mask)


class Weights(NamedTuple):
    """D dt / d^2 of the faces: to the next column and the next row (2 r, w), between the layers (r, w)."""

    along: Float
    down: Float
    across: Float


class Bands(NamedTuple):
    """Amounts and weights of all bands, each in its own planes, rows padded to whole vectors.

    phi          (b, 2 r, w)  amounts, weft rows before warp rows
    along, down  (b, 2 r, w)  weights of the faces to the next column and to the next row
    across       (b, r, w)    weights of the faces between the layers
    edge         (b, 2 levels, w)     scratch: flux from the row above, by level
    first, last  (b,)         rows whose amounts are the band's own, within its r
    shrinks      (b, 2) int64  1 where the rows beyond the first, the last, are a neighbour's
    """

    phi: Float
    along: Float
    down: Float
    across: Float
    edge: Float
    first: Rows
    last: Rows
    shrinks: Rows


@kernel
def step_row(phi: Float, along: Float, down: Float, across: Float, edge: Float, level: int, row: int) -> None:
    """Step row `row` of both layers, (2 r, w), in place; `edge` passes the fluxes on to the next row."""
    r = across.shape[0]
    other = row + r
    left_0, left_1 = splat(0.0), splat(0.0)
    for c in range(LEFT, phi.shape[1] - WIDTH, WIDTH):
        phi_0, phi_1 = load(phi, row, c), load(phi, other, c)
        right_0 = load(along, row, c) * (load(phi, row, c + 1) - phi_0)
        right_1 = load(along, other, c) * (load(phi, other, c + 1) - phi_1)
        down_0 = load(down, row, c) * (load(phi, row + 1, c) - phi_0)
        down_1 = load(down, other, c) * (load(phi, other + 1, c) - phi_1)
        through = load(across, row, c) * (phi_1 - phi_0)
        up_0, up_1 = load(edge, 2 * level, c), load(edge, 2 * level + 1, c)
        store(phi, row, c, phi_0 + ((right_0 - slide(left_0, right_0)) + (down_0 - up_0) + through))
        store(phi, other, c, phi_1 + ((right_1 - slide(left_1, right_1)) + (down_1 - up_1) - through))
        store(edge, 2 * level, c, down_0)
        store(edge, 2 * level + 1, c, down_1)
        left_0, left_1 = right_0, right_1


@kernel
def start_row(phi: Float, down: Float, edge: Float, level: int, row: int, r: int) -> None:
    """Compute the fluxes into row `row` from the one above it, which is at the same level."""
    for c in range(LEFT, phi.shape[1] - WIDTH, WIDTH):
        store(edge, 2 * level, c, load(down, row - 1, c) * (load(phi, row, c) - load(phi, row - 1, c)))
        below = row + r
        store(edge, 2 * level + 1, c, load(down, below - 1, c) * (load(phi, below, c) - load(phi, below - 1, c)))


@block_kernel
def pass_over(levels: int, bands: Bands, uptake: Uptake | None, upkeep: Upkeep | None, b: int) -> None:
    """Take `levels` steps of band `b`. Level s is right with levels - 1 - s rows of its neighbours. Fibre takes dye one
    row ahead: the previous level has finished that row and stored its fluxes.
    """
    phi, along, down, across = bands.phi[b], bands.along[b], bands.down[b], bands.across[b]
    edge, r, first, last = bands.edge[b], bands.across.shape[1], bands.first[b], bands.last[b]
    up, low = bands.shrinks[b, 0], bands.shrinks[b, 1]
    for at in range(first - up * (levels - 1), last + low * (levels - 1) + levels + 1):
        for level in range(levels):
            row, beyond = at - level, levels - 1 - level
            if first - up * beyond <= row <= last + low * beyond:
                if row == first - up * beyond:
                    if uptake is not None:
                        adsorb_both(phi, uptake, b, LEFT, row - 1, r)
                        adsorb_both(phi, uptake, b, LEFT, row, r)
                    start_row(phi, down, edge, level, row, r)
                if uptake is not None:
                    adsorb_both(phi, uptake, b, LEFT, row + 1, r)
                step_row(phi, along, down, across, edge, level, row)
                if upkeep is not None:
                    keep_both(phi, upkeep, b, LEFT, row, r)


@parallel_kernel
def pass_bands(levels: int, bands: Bands, uptake: Uptake | None, upkeep: Upkeep | None) -> None:
    """Take `levels` steps of all bands."""
    for b in prange(bands.phi.shape[0]):
        pass_over(levels, bands, uptake, upkeep, b)


@kernel
def copy_rows(to: Float, row: int, source: Float, start: int, r: int, count: int) -> None:
    """Copy `count` rows of both layers."""
    for i in range(count):
        for c in range(LEFT, to.shape[1] - WIDTH, WIDTH):
            store(to, row + i, c, load(source, start + i, c))
            store(to, row + r + i, c, load(source, start + r + i, c))


@parallel_kernel
def renew_ghosts(bands: Any, values: Float, ghost: int) -> None:
    """Copy `ghost` rows of `values` (b, 2 r, w) from the neighbours. A separate loop, since numba would fuse it."""
    for b in prange(values.shape[0]):
        r = bands.across.shape[1]
        if bands.shrinks[b, 0] == 1:
            copy_rows(values[b], bands.first[b] - ghost, values[b - 1], bands.last[b - 1] - ghost + 1, r, ghost)
        if bands.shrinks[b, 1] == 1:
            copy_rows(values[b], bands.last[b] + 1, values[b + 1], bands.first[b + 1], r, ghost)


@kernel
def diffuse(steps: int, bands: Bands, uptake: Uptake | None, upkeep: Upkeep | None, leave: Rows) -> None:
    """Take `steps` steps, GHOST in a pass, until `leave` (1,) is not 0; `uptake` and `upkeep` may be None."""
    for done in range(0, steps, GHOST):
        if leave[0] != 0:
            break
        pass_bands(min(GHOST, steps - done), bands, uptake, upkeep)
        renew_ghosts(bands, bands.phi, GHOST)
        if uptake is not None:
            renew_ghosts(bands, uptake.fixed, GHOST)
