"""Adsorption: a step takes (D_ab dt / d^2) (phi - A)^+ from the mobile phi to the fixed A; or (D_ab dt / d^2) phi.

It takes no more than the isotherm and the fibre's capacity V_d allow, min(V_d, A_d(phi)) - A, nor than phi; A never
decreases (dye paper, equations 5 to 8). The paper computes uptake "like diffusion, by equation 2", whose drive is a
difference, and "as a one-way diffusion while A exceeds neither V_d nor A_d", which phi - A ends before where A_d > phi:
both readings are there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import forced_inline, kernel
from nuno_kernels.formula import limit_at, method_or
from nuno_kernels.lanes import WIDTH, any_below, higher, load, lower, splat, store, where_greater
from nuno_schemas.fabric import Float


class Law(NamedTuple):
    """The rate at which fibre takes dye in a step or a stage, and its limit.

    Tuples for parallel loops have these three fields themselves: numba allows no tuple within a tuple there.

    isotherm  its formula (nuno_kernels.formula)
    rate      D_ab dt / d^2, 0 if fibre takes no dye
    back      1 if phi - A drives it, 0 if phi does
    """

    isotherm: Any
    rate: float
    back: float


class Uptake(NamedTuple):
    """Fixed dye and its limits, (2 r, w) each, or bands (b, 2 r, w) as in nuno_dye.solvers.diffusion.Bands.

    fixed  fixed amounts A
    fibre  capacity V_d for fixed dye, 0 in gaps
    isotherm, rate, back  as in Law
    """

    fixed: Float
    fibre: Float
    isotherm: Any
    rate: float
    back: float


@kernel
def law_in(uptake: Uptake) -> Law:
    """Return the law of an uptake."""
    return Law(uptake.isotherm, uptake.rate, uptake.back)


@kernel
def no_bound(isotherm: Any, phi: Any) -> Any:
    """Return what is below any limit of eight cells."""
    return splat(-np.inf)


bound_below = method_or("least", no_bound)


@kernel
def may_bind(isotherm: Any, phi: Any, fixed: Any, free: Any, pace: float) -> bool:
    """Return whether `pace` times the distance to the limit may be below the uptake without it, `free`, in any lane:
    not where no lane takes dye, nor above a bound that is cheaper than the limit.
    """
    margin = pace * (bound_below(isotherm, phi) - fixed) - free
    return bool(any_below(where_greater(free, splat(0.0), margin), 0.0))


@forced_inline
def limited(law: Law, phi: Any, fixed: Any, room: Any, taken: Any, pace: float) -> Any:
    """Return the uptake of eight cells, `taken` without the isotherm, up to `pace` times the distance to its limit."""
    if may_bind(law.isotherm, phi, fixed, taken, pace):
        taken = lower(taken, pace * (limit_at(law.isotherm, higher(phi, splat(0.0)), room) - fixed))
    return taken


@forced_inline
def adsorb(phi: Float, fixed: Float, fibre: Float, row: int, c: int, law: Law | None) -> Any:
    """Fix dye in eight cells, if there is a law. Return the remaining mobile dye."""
    if law is None:
        return load(phi, row, c)
    mobile, bound, capacity = load(phi, row, c), load(fixed, row, c), load(fibre, row, c)
    taken = lower(lower(law.rate * (mobile - law.back * bound), capacity - bound), mobile)
    taken = higher(limited(law, mobile, bound, capacity, taken, 1.0), splat(0.0))
    remaining = mobile - taken
    store(phi, row, c, remaining)
    store(fixed, row, c, bound + taken)
    return remaining


@kernel
def adsorb_both(phi: Float, uptake: Uptake, b: int, start: int, row: int, r: int) -> None:
    """Fix dye in one row of both layers of band `b`, (2 r, w), from column `start`."""
    law = law_in(uptake)
    fixed, fibre = uptake.fixed[b], uptake.fibre[b]
    for at in (row, row + r):
        for c in range(start, phi.shape[1] - WIDTH, WIDTH):
            adsorb(phi, fixed, fibre, at, c, law)
