"""M of a row's cells and a stage from it, vector by vector: the inner loops of nuno_dye.solvers.rkl2.

A kernel processes a row of both layers, (2 r, w), weft rows before warp rows, and stores data for the next one in
`scratch` from row `slots`: four rows of SLOT each in turn. Amounts are in three consecutive planes (6 r, w), given by
their first rows (see Row). Every array is a separate argument: numba counts references of one that is chosen among
several, or taken out of a tuple, which costs more than the row itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from nuno_dye.laws.adsorption import NOTHING, Law
from nuno_dye.laws.potential import Curve, potentials
from nuno_dye.solvers.diffusion import LEFT, slide
from nuno_dye.solvers.fixing import taken_at
from nuno_kernels import forced_inline, kernel
from nuno_kernels.lanes.simd import WIDTH, higher, load, lower, splat, store, where_greater
from nuno_schemas.fabric import Float

SLOT = 7
"""Scratch rows of a row of cells: fluxes to the right, down, and between the layers, and the layers' factors."""
ROWS = 4 * SLOT
"""Rows of scratch of a stage."""


class Rules(NamedTuple):
    """The limits of the cells in a step.

    kind, first, second, rate  as in nuno_dye.laws.adsorption.Law
    pace                       rate at which a cell approaches its capacity, and fibre its limit
    kept                       whether any cell is maintained

    The loop tests `kind` and `kept`; arguments that may be None would make four kernels of each, of seven seconds'
    compilation.
    """

    kind: int
    first: float
    second: float
    rate: float
    pace: float
    kept: bool


class Stage(NamedTuple):
    """A stage: its coefficients, the first rows of its start and end planes, and whether it is the first."""

    mu: float
    nu: float
    new: float
    old: float
    here: int
    into: int
    first: bool


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
def advanced(planes: Float, slope: Float, rate: Any, row: int, c: int, stage: Stage) -> Any:
    """Return eight amounts after a stage, whose M is `rate`."""
    initial = load(planes, row, c)
    if stage.first:
        return initial + stage.new * rate
    before, last = load(planes, row + stage.into, c), load(planes, row + stage.here, c)
    steps = stage.mu * (last - initial) + stage.nu * (before - initial)
    return initial + (steps + (stage.new * rate + stage.old * load(slope, row, c)))


@forced_inline
def finish(
    mobile: Float, slope: Float, seen: Float, floor: Float, held: Float, bite: Float, fibre: Float, rules: Rules,
    stage: Stage, rate: Any, phi: Any, row: int, c: int,
) -> None:  # fmt: skip
    """Finish a stage of eight cells that get `rate` over their faces and hold `phi`: their fixed and mobile dye. All is
    read before anything is written. Rejected: each write where its value is known, slower than a loop for each of these
    parts, probably since arrays of one shape have addresses that agree in their last 12 bits.
    """
    taken = fixed = splat(0.0)
    if rules.kind != NOTHING:
        law = Law(rules.kind, rules.first, rules.second, rules.rate)
        taken = taken_at(phi, load(held, row + stage.here, c), load(fibre, row, c), law, rules.pace)
        rate = rate - taken
        fixed = advanced(held, bite, taken, row, c, stage)
    result = advanced(mobile, slope, rate, row, c, stage)
    visible = higher(load(floor, row, c), result) if rules.kept else result
    store(mobile, row + stage.into, c, result)
    if rules.kept:
        store(seen, row + stage.into, c, visible)
    if rules.kind != NOTHING:
        store(held, row + stage.into, c, fixed)
    if stage.first:
        store(slope, row, c, rate)
        if rules.kind != NOTHING:
            store(bite, row, c, taken)


@kernel
def spread_row(
    mobile: Float, slope: Float, seen: Float, floor: Float, held: Float, bite: Float, fibre: Float, rules: Rules,
    stage: Stage, along: Float, down: Float, across: Float, curve: Curve | None, row: int,
) -> None:  # fmt: skip
    """Take a stage of a row's cells if no limit can bind."""
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
        finish(mobile, slope, seen, floor, held, bite, fibre, rules, stage, rate_0, held_0, row, c)
        finish(mobile, slope, seen, floor, held, bite, fibre, rules, stage, rate_1, held_1, other, c)
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
    law = Law(rules.kind, rules.first, rules.second, rules.rate)
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
            if law.kind != NOTHING:
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
    mobile: Float, slope: Float, seen: Float, floor: Float, held: Float, bite: Float, fibre: Float, rules: Rules,
    stage: Stage, scratch: Float, slots: int, row: int,
) -> None:  # fmt: skip
    """Take a stage of a row's cells, from fluxes and factors of this row and of the rows above and below."""
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
            finish(mobile, slope, seen, floor, held, bite, fibre, rules, stage, rate, phi, at, c)
            previous = right


@kernel
def keep_factors(factors: Float, scratch: Float, place: Row) -> None:
    """Copy factors of a row into plane `passing`, for the next stage."""
    r, slot = factors.shape[0] // 6, place.slots + SLOT * (place.row % 4)
    for layer in range(2):
        for c in range(LEFT, factors.shape[1] - WIDTH, WIDTH):
            store(factors, place.row + layer * r + place.passing, c, load(scratch, slot + 5 + layer, c))
