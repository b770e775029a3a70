"""Adsorption: a step takes (D_ab dt / d^2) (phi - A)^+ from the mobile phi to the fixed A; or (D_ab dt / d^2) phi.

It takes no more than the isotherm and the fibre's capacity V_d allow, min(V_d, A_d(phi)) - A, nor than phi; A never
decreases (dye paper, equations 5 to 8). The paper computes uptake "like diffusion, by equation 2", whose drive is a
difference, and "as a one-way diffusion while A exceeds neither V_d nor A_d", which phi - A ends before where A_d > phi:
both readings are there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

from numba import types
from numba.extending import overload

from nuno_dye.laws.power import power
from nuno_kernels import forced_inline, kernel
from nuno_kernels.formula import INLINE, is_formula, limit_at
from nuno_kernels.lanes import WIDTH, any_below, higher, load, lower, splat, store, where_greater
from nuno_schemas.fabric import Float

NOTHING, PARTITION, FREUNDLICH, LANGMUIR, OWN = 0, 1, 2, 3, 4
"""Isotherms in the kernels; OWN is a formula of any package."""


class Law(NamedTuple):
    """The rate at which fibre takes dye in a step or a stage, and its limit.

    Tuples for parallel loops have these five fields themselves: numba allows no tuple within a tuple there.

    kind           one of the isotherms above, NOTHING if fibre takes no dye
    first, second  its parameters: k, k and b, or K; or `first` is the formula (nuno_kernels.formula)
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


def law_in(uptake: Uptake | None) -> Law:
    """Return the law of an uptake, or of none; kernels call it."""
    return Law(NOTHING, 0.0, 0.0, 0.0, 0.0) if uptake is None else Law(*uptake[2:])


@overload(law_in, jit_options=INLINE, strict=False)  # type: ignore[untyped-decorator]
def _law_in(uptake: Any) -> Any:
    if isinstance(uptake, types.NoneType):
        return lambda uptake: Law(NOTHING, 0.0, 0.0, 0.0, 0.0)
    return lambda uptake: Law(uptake.kind, uptake.first, uptake.second, uptake.rate, uptake.back)


F = TypeVar("F", bound=Callable[..., Any])


def or_own(own: Any) -> Callable[[F], F]:
    """Return a decorator of kernels whose first argument is a law: where that is a formula, `own` takes their place."""

    def decorate(known: F) -> F:
        def called(law: Law, *rest: Any) -> Any:
            return known(law, *rest)

        @overload(called, jit_options=INLINE, strict=False)  # type: ignore[untyped-decorator]
        def typed(law: Any, *rest: Any) -> Any:
            chosen = own if is_formula(law.types[Law._fields.index("first")]) else known
            return lambda law, *rest: chosen(law, *rest)

        return cast(F, called)

    return decorate


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
def own_limited(law: Law, phi: Any, fixed: Any, room: Any, taken: Any, pace: float) -> Any:
    """Return the uptake up to a formula's limit; the formula is evaluated only if any lane takes dye."""
    if any_below(splat(0.0) - taken, 0.0):
        taken = lower(taken, pace * (limit_at(law.first, higher(phi, splat(0.0)), room) - fixed))
    return taken


@or_own(own_limited)
@forced_inline
def limited(law: Law, phi: Any, fixed: Any, room: Any, taken: Any, pace: float) -> Any:
    """Return the uptake of eight cells, `taken` without the isotherm, up to `pace` times the distance to its limit."""
    if law.kind != FREUNDLICH or may_bind(law.first, phi, fixed, taken, pace):
        taken = lower(taken, pace * (limit_of(law, phi, room) - fixed))
    return taken


@forced_inline
def adsorb(phi: Float, fixed: Float, fibre: Float, row: int, c: int, law: Law) -> Any:
    """Fix dye in eight cells. Return the remaining mobile dye."""
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
