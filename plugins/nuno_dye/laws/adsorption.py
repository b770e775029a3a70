"""Adsorption: a step takes (D_ab dt / d^2) (phi - A)^+ from the mobile phi to the fixed A; or (D_ab dt / d^2) phi.

It takes no more than the isotherm and the fibre's capacity V_d allow, min(V_d, A_d(phi)) - A, nor than phi; A never
decreases (dye paper, equations 5 to 8). The paper computes uptake "like diffusion, by equation 2", whose drive is a
difference, and "as a one-way diffusion while A exceeds neither V_d nor A_d", which phi - A ends before where A_d > phi:
both readings are there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from nuno_dye.laws.power import power
from nuno_kernels import forced_inline, kernel
from nuno_kernels.lanes import WIDTH, any_below, higher, load, lower, splat, store, where_greater
from nuno_schemas.fabric import Float

NOTHING, PARTITION, FREUNDLICH, LANGMUIR = 0, 1, 2, 3
"""Isotherms in the kernels."""


class Law(NamedTuple):
    """The rate at which fibre takes dye in a step or a stage, and its limit.

    Tuples for parallel loops have these five fields themselves: numba allows no tuple within a tuple there.

    kind           one of the isotherms above, NOTHING if fibre takes no dye
    first, second  its parameters: k, k and b, or K
    rate           D_ab dt / d^2
    back           1 if phi - A drives it, 0 if phi does
    """

    kind: int
    first: float
    second: float
    rate: float
    back: float


class Uptake(NamedTuple):
    """Fixed dye and its limits, (2 r, w) each, or bands (b, 2 r, w) as in nuno_dye.solvers.diffusion.Bands.

    fixed  fixed amounts A
    fibre  capacity V_d for fixed dye, 0 in gaps
    kind, first, second, rate, back  as in Law
    """

    fixed: Float
    fibre: Float
    kind: int
    first: float
    second: float
    rate: float
    back: float


@kernel
def limit_of(law: Law, phi: Any, capacity: Any) -> Any:
    """Return the limit of fixed dye in eight cells at mobile dye phi: k phi, k phi^b, or V_d K phi / (1 + K phi)."""
    if law.kind == PARTITION:
        return law.first * phi
    if law.kind == FREUNDLICH:
        return law.first * power(phi, law.second)
    return capacity * (law.first * phi) / (1.0 + law.first * phi)


@kernel
def may_bind(first: float, phi: Any, fixed: Any, free: Any, pace: float) -> Any:
    """Return whether `pace` times the distance to Freundlich's limit may be below the uptake without it, `free`, in any
    lane. phi^b >= min(phi, 1), as b <= 1: this usually decides, without the power.
    """
    margin = pace * (first * lower(phi, splat(1.0)) - fixed) - free
    return any_below(where_greater(free, splat(0.0), margin), 0.0)


@forced_inline
def adsorb(phi: Float, fixed: Float, fibre: Float, row: int, c: int, law: Law) -> Any:
    """Fix dye in eight cells. Return the remaining mobile dye."""
    mobile, bound, capacity = load(phi, row, c), load(fixed, row, c), load(fibre, row, c)
    taken = lower(lower(law.rate * (mobile - law.back * bound), capacity - bound), mobile)
    if law.kind != FREUNDLICH or may_bind(law.first, mobile, bound, taken, 1.0):
        taken = lower(taken, limit_of(law, mobile, capacity) - bound)
    taken = higher(taken, splat(0.0))
    remaining = mobile - taken
    store(phi, row, c, remaining)
    store(fixed, row, c, bound + taken)
    return remaining


@kernel
def adsorb_both(phi: Float, uptake: Uptake, b: int, start: int, row: int, r: int) -> None:
    """Fix dye in one row of both layers of band `b`, (2 r, w), from column `start`."""
    law = Law(uptake.kind, uptake.first, uptake.second, uptake.rate, uptake.back)
    fixed, fibre = uptake.fixed[b], uptake.fibre[b]
    for at in (row, row + r):
        for c in range(start, phi.shape[1] - WIDTH, WIDTH):
            adsorb(phi, fixed, fibre, at, c, law)
