"""Adsorption: a step takes (D_ab dt / d^2) (phi - A)^+ from the mobile phi to the fixed A.

Never more than the isotherm and the fibre's room V_d allow, min(V_d, A_d(phi)) - A, nor than there is; A never
decreases (dye paper, equations 5 to 8).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from nuno_dye.laws.power import power
from nuno_kernels import kernel
from nuno_kernels.lanes.choose import any_below, higher, lower, where_greater
from nuno_kernels.lanes.simd import WIDTH, load, splat, store
from nuno_schemas.fabric import Float

NOTHING, PARTITION, FREUNDLICH, LANGMUIR = 0, 1, 2, 3
"""Isotherms that the kernels know."""


class Uptake(NamedTuple):
    """What fibre has taken, may take and how fast, in bands as in nuno_dye.solvers.diffusion.Bands.

    fixed     (b, 2 r, w)  fixed amounts A
    fibre     (b, 2 r, w)  capacity V_d for fixed dye, 0 in gaps
    rate      D_ab dt / d^2
    isotherm  which, with its numbers `first` and `second`
    """

    fixed: Float
    fibre: Float
    rate: float
    isotherm: int
    first: float
    second: float


@kernel
def limit_of(isotherm: int, first: float, second: float, phi: Any, room: Any) -> Any:
    """What may be fixed at mobile dye phi: k phi, k phi^b, or V_d K phi / (1 + K phi); (k, b) or (K, -)."""
    if isotherm == PARTITION:
        return first * phi
    if isotherm == FREUNDLICH:
        return first * power(phi, second)
    return room * (first * phi) / (1.0 + first * phi)


@kernel
def may_bind(first: float, phi: Any, held: Any, free: Any, pace: float) -> Any:
    """Whether `pace` times what Freundlich's limit leaves is below what is taken without it, `free`, in any lane.

    phi^b >= min(phi, 1), as b <= 1: most often that tells, and the power is not needed.
    """
    margin = pace * (first * lower(phi, splat(1.0)) - held) - free
    return any_below(where_greater(free, splat(0.0), margin), 0.0)


@kernel
def adsorb_row(
    phi: Any, fixed: Any, fibre: Any, start: int, row: int, rate: float, isotherm: int, first: float, second: float
) -> None:
    """Fix dye in one row of one layer, from column `start` on; rate is D_ab dt / d^2."""
    nothing = splat(0.0)
    for c in range(start, phi.shape[1] - WIDTH, WIDTH):
        there, held, room = load(phi, row, c), load(fixed, row, c), load(fibre, row, c)
        taken = lower(lower(rate * (there - held), room - held), there)
        if isotherm != FREUNDLICH or may_bind(first, there, held, taken, 1.0):
            taken = lower(taken, limit_of(isotherm, first, second, there, room) - held)
        taken = higher(taken, nothing)
        store(phi, row, c, there - taken)
        store(fixed, row, c, held + taken)


@kernel
def adsorb_both(phi: Any, uptake: Any, b: int, start: int, row: int, r: int) -> None:
    """Fix dye in one row of both layers of band `b`, (2 r, w), from column `start` on."""
    for at in (row, row + r):
        adsorb_row(
            phi, uptake.fixed[b], uptake.fibre[b], start, at, uptake.rate, uptake.isotherm, uptake.first, uptake.second
        )
