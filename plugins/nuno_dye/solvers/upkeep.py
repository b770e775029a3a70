"""Maintained supplies: after every step a cell holds at least its floor, and the added amounts are summed.

The sum is by cell, compensated (Kahan 1965), so that it depends neither on bands nor on passes. Rows without a floor
are not touched, and without an Upkeep none of this is compiled. All sums of dye are compensated.
"""

from __future__ import annotations

from typing import NamedTuple

from nuno_kernels import kernel
from nuno_kernels.lanes.simd import WIDTH, higher, load, store
from nuno_schemas.fabric import Bool, Float


class Upkeep(NamedTuple):
    """Floors of one dye and the amounts they added, in bands as in nuno_dye.solvers.diffusion.Bands.

    floor  (b, 2 r, w)  least amounts, 0 without a floor
    given  (b, 2 r, w)  added amounts
    lost   (b, 2 r, w)  rounding errors of these
    rows   (b, r)       whether a row has a floor in either layer
    """

    floor: Float
    given: Float
    lost: Float
    rows: Bool


@kernel
def sum_compensated(values: Float) -> float:
    """Return the sum of a flat array after Neumaier (1974), to rounding of the result and n eps^2 sum |value|."""
    total, lost = 0.0, 0.0
    for i in range(values.shape[0]):
        value = values[i]
        larger = total + value
        lost += (total - larger) + value if abs(total) >= abs(value) else (value - larger) + total
        total = larger
    return total + lost


@kernel
def keep_both(phi: Float, upkeep: Upkeep, b: int, start: int, row: int, r: int) -> None:
    """Raise one row of both layers of band `b`, (2 r, w), to its floor, from column `start`."""
    if upkeep.rows[b, row]:
        keep_row(phi, upkeep.floor[b], upkeep.given[b], upkeep.lost[b], start, row)
        keep_row(phi, upkeep.floor[b], upkeep.given[b], upkeep.lost[b], start, row + r)


@kernel
def keep_row(phi: Float, floor: Float, given: Float, lost: Float, start: int, row: int) -> None:
    """Raise one row of one layer to its floor, from column `start`."""
    for c in range(start, phi.shape[1] - WIDTH, WIDTH):
        present = load(phi, row, c)
        raised = higher(load(floor, row, c), present)
        sum_before = load(given, row, c)
        added = (raised - present) - load(lost, row, c)
        sum_after = sum_before + added
        store(phi, row, c, raised)
        store(given, row, c, sum_after)
        store(lost, row, c, (sum_after - sum_before) - added)
