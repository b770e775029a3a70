"""M of a row's cells and a stage from it, in vectors: the inner loops of nuno_dye.solvers.rkl2_stage.

A kernel takes a row of both layers, (2 r, w), weft rows before warp rows, and puts what the next one needs into
`scratch` from row `slots` on: four rows of SLOT each in turn, and M itself from RATES on. Amounts lie in three planes,
one after the other, (6 r, w); `base`, `here`, `into`, `passed` and `passing` are the planes' first rows. To choose
among three arrays for every row cost more than the row itself: numba counts who holds an array.
"""

from __future__ import annotations

from typing import Any

from nuno_dye.laws.potential import potentials
from nuno_dye.solvers.diffusion import LEFT, slide
from nuno_dye.solvers.fixing import taken_at
from nuno_kernels import kernel
from nuno_kernels.lanes.choose import higher, lower, where_greater
from nuno_kernels.lanes.simd import WIDTH, load, splat, store

SLOT = 7
"""Rows of scratch for a row of cells: fluxes to the right, down, and between the layers, and the layers' factors."""
RATES = 4 * SLOT
"""Where in the scratch the two layers' M of a row are, and after them what fibre takes."""
ROWS = RATES + 4
"""Rows of scratch of a stage."""


@kernel
def spread_row(
    seen: Any, along: Any, down: Any, across: Any, curve: Any, scratch: Any, slots: int, row: int, base: int
) -> None:
    """M of a row's cells where no limit can bind."""
    other = row + across.shape[0]
    here_0, here_1, left_0, left_1, rates = base + row, base + other, splat(0.0), splat(0.0), slots + RATES
    for c in range(LEFT, seen.shape[1] - WIDTH, WIDTH):
        phi_0, phi_1 = potentials(load(seen, here_0, c), curve), potentials(load(seen, here_1, c), curve)
        right_0 = load(along, row, c) * (potentials(load(seen, here_0, c + 1), curve) - phi_0)
        right_1 = load(along, other, c) * (potentials(load(seen, here_1, c + 1), curve) - phi_1)
        down_0 = load(down, row, c) * (potentials(load(seen, here_0 + 1, c), curve) - phi_0)
        down_1 = load(down, other, c) * (potentials(load(seen, here_1 + 1, c), curve) - phi_1)
        up_0 = load(down, row - 1, c) * (phi_0 - potentials(load(seen, here_0 - 1, c), curve))
        up_1 = load(down, other - 1, c) * (phi_1 - potentials(load(seen, here_1 - 1, c), curve))
        through = load(across, row, c) * (phi_1 - phi_0)
        store(scratch, rates, c, (right_0 - slide(left_0, right_0)) + (down_0 - up_0) + through)
        store(scratch, rates + 1, c, (right_1 - slide(left_1, right_1)) + (down_1 - up_1) - through)
        left_0, left_1 = right_0, right_1


@kernel
def begin_row(planes: Any, slope: Any, scratch: Any, of: int, row: int, into: int, first: float) -> None:
    """The first stage of a row of one layer, whose M is scratch[of]; keeps it."""
    for c in range(LEFT, planes.shape[1] - WIDTH, WIDTH):
        rate = load(scratch, of, c)
        store(slope, row, c, rate)
        store(planes, into, c, load(planes, row, c) + first * rate)


@kernel
def finish_row(
    planes: Any, slope: Any, scratch: Any, of: int, row: int, here: int, into: int,
    mu: float, nu: float, new: float, old: float,
) -> None:  # fmt: skip
    """A later stage of a row of one layer."""
    for c in range(LEFT, planes.shape[1] - WIDTH, WIDTH):
        begun, rate = load(planes, row, c), load(scratch, of, c)
        steps = mu * (load(planes, here, c) - begun) + nu * (load(planes, into, c) - begun)
        store(planes, into, c, begun + (steps + (new * rate + old * load(slope, row, c))))


@kernel
def see_row(seen: Any, planes: Any, floor: Any, row: int, into: int) -> None:
    """What neighbours see of a row."""
    for c in range(LEFT, planes.shape[1] - WIDTH, WIDTH):
        store(seen, into, c, higher(load(floor, row, c), load(planes, into, c)))


@kernel
def advance_row(
    planes: Any, slope: Any, scratch: Any, of: int, row: int, here: int, into: int, coefs: Any, j: int
) -> None:
    """Stage `j` of a row of one layer, from its M."""
    if j == 0:
        begin_row(planes, slope, scratch, of, row, row + into, coefs[0, 2])
    else:
        finish_row(
            planes, slope, scratch, of, row, row + here, row + into, coefs[j, 0], coefs[j, 1], coefs[j, 2], coefs[j, 3]
        )


@kernel
def flux_row(
    seen: Any, along: Any, down: Any, across: Any, curve: Any, scratch: Any, slots: int, row: int, base: int
) -> None:
    """Fluxes of a row's faces into its slot."""
    other, slot = row + across.shape[0], slots + SLOT * (row % 4)
    here_0, here_1 = base + row, base + other
    for c in range(LEFT, seen.shape[1] - WIDTH, WIDTH):
        phi_0, phi_1 = potentials(load(seen, here_0, c), curve), potentials(load(seen, here_1, c), curve)
        store(scratch, slot, c, load(along, row, c) * (potentials(load(seen, here_0, c + 1), curve) - phi_0))
        store(scratch, slot + 1, c, load(along, other, c) * (potentials(load(seen, here_1, c + 1), curve) - phi_1))
        store(scratch, slot + 2, c, load(down, row, c) * (potentials(load(seen, here_0 + 1, c), curve) - phi_0))
        store(scratch, slot + 3, c, load(down, other, c) * (potentials(load(seen, here_1 + 1, c), curve) - phi_1))
        store(scratch, slot + 4, c, load(across, row, c) * (phi_1 - phi_0))


@kernel
def open_row(
    seen: Any, held: Any, fibre: Any, most: Any, floor: Any, factors: Any, scratch: Any, law: Any, slots: int, row: int,
    r: int, base: int, passed: int,
) -> None:  # fmt: skip
    """Factors of the inflow of a row's cells, from those in plane `passed`.

    What flows out of a kept-up cell the supply replaces; what fibre takes leaves room there, too.
    """
    slot, above, nothing = slots + SLOT * (row % 4), slots + SLOT * ((row - 1) % 4), splat(0.0)
    for layer in range(2):
        before, at, sign = splat(0.0), row + layer * r, 1.0 - 2.0 * layer
        here, known, known_other = at + base, at + passed, row + r - layer * r + passed
        for c in range(LEFT, seen.shape[1] - WIDTH, WIDTH):
            right, down = load(scratch, slot + layer, c), load(scratch, slot + 2 + layer, c)
            left, up = slide(before, right), load(scratch, above + 2 + layer, c)
            other, phi = sign * load(scratch, slot + 4, c), load(seen, here, c)
            came = higher(right, nothing) - lower(left, nothing) + higher(down, nothing) - lower(up, nothing)
            came = came + higher(other, nothing)
            went = higher(left, nothing) * load(factors, known, c - 1) - lower(right, nothing) * load(
                factors, known, c + 1
            )
            went = went + higher(up, nothing) * load(factors, known - 1, c)
            went = went - lower(down, nothing) * load(factors, known + 1, c)
            went = went - lower(other, nothing) * load(factors, known_other, c)
            if law.kept:
                went = went - where_greater(load(floor, at, c), nothing, went)
            if law.fixes:
                fixed, room = load(held, here, c), load(fibre, at, c)
                went = went + taken_at(phi, fixed, room, law.rate, law.isotherm, law.first, law.second, law.pace)
            share = (went + law.pace * (load(most, at, c) - phi)) / came
            store(scratch, slot + 5 + layer, c, higher(lower(share, splat(1.0)), nothing))
            before = right


@kernel
def scaled(flow: Any, here: Any, other: Any) -> Any:
    """A flow into this cell by its factor, one out of it by the other's."""
    return higher(flow, splat(0.0)) * here + lower(flow, splat(0.0)) * other


@kernel
def limited_row(scratch: Any, slots: int, row: int) -> None:
    """M of a row's cells, from fluxes and factors of its own and of the rows above and below."""
    slot, above, below = slots + SLOT * (row % 4), slots + SLOT * ((row - 1) % 4), slots + SLOT * ((row + 1) % 4)
    for layer in range(2):
        sign, before, mine = 1.0 - 2.0 * layer, splat(0.0), 5 + layer
        for c in range(LEFT, scratch.shape[1] - WIDTH, WIDTH):
            factor = load(scratch, slot + mine, c)
            right = scaled(load(scratch, slot + layer, c), factor, load(scratch, slot + mine, c + 1))
            down = scaled(load(scratch, slot + 2 + layer, c), factor, load(scratch, below + mine, c))
            up = scaled(load(scratch, above + 2 + layer, c), load(scratch, above + mine, c), factor)
            through = scaled(load(scratch, slot + 4, c), load(scratch, slot + 5, c), load(scratch, slot + 6, c))
            store(scratch, slots + RATES + layer, c, (right - slide(before, right)) + (down - up) + sign * through)
            before = right


@kernel
def keep_factors(factors: Any, scratch: Any, slots: int, row: int, r: int, passing: int) -> None:
    """Factors of a row into plane `passing`, for the next stage."""
    for layer in range(2):
        for c in range(LEFT, factors.shape[1] - WIDTH, WIDTH):
            store(factors, row + layer * r + passing, c, load(scratch, slots + SLOT * (row % 4) + 5 + layer, c))
