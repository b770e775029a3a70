"""Adsorption: a step takes (D_ab dt / d^2) (phi - A)^+ from the mobile phi to the fixed A.

Never more than the isotherm and the fibre's room V_d allow, min(V_d, A_d(phi)) - A, nor than there is; A never
decreases (dye paper, equations 5 to 8).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from nuno_dye.laws.power import power
from nuno_kernels import forced_inline, kernel
from nuno_kernels.lanes.choose import any_below, higher, lower, where_greater
from nuno_kernels.lanes.simd import WIDTH, load, splat, store
from nuno_schemas.fabric import Float

NOTHING, PARTITION, FREUNDLICH, LANGMUIR = 0, 1, 2, 3
"""Isotherms that the kernels know."""


class Law(NamedTuple):
    """How fast fibre takes dye in a step or a stage, and how much at most.

    Tuples that go into parallel loops have these four fields themselves: numba takes no tuple within a tuple there.

    kind           one of the isotherms above, NOTHING where fibre takes none
    first, second  its numbers: k, k and b, or K
    rate           D_ab dt / d^2
    """

    kind: int
    first: float
    second: float
    rate: float


class Uptake(NamedTuple):
    """What fibre has taken and may take, (2 r, w) each, or that of bands (b, 2 r, w) as in
    nuno_dye.solvers.diffusion.Bands.

    fixed  fixed amounts A
    fibre  capacity V_d for fixed dye, 0 in gaps
    kind, first, second, rate  as in Law
    """

    fixed: Float
    fibre: Float
    kind: int
    first: float
    second: float
    rate: float


@kernel
def limit_of(law: Law, phi: Any, room: Any) -> Any:
    """What eight cells may fix at mobile dye phi: k phi, k phi^b, or V_d K phi / (1 + K phi)."""
    if law.kind == PARTITION:
        return law.first * phi
    if law.kind == FREUNDLICH:
        return law.first * power(phi, law.second)
    return room * (law.first * phi) / (1.0 + law.first * phi)


@kernel
def may_bind(first: float, phi: Any, held: Any, free: Any, pace: float) -> Any:
    """Whether `pace` times what Freundlich's limit leaves is below what is taken without it, `free`, in any lane.

    phi^b >= min(phi, 1), as b <= 1: most often that tells, and the power is not needed.
    """
    margin = pace * (first * lower(phi, splat(1.0)) - held) - free
    return any_below(where_greater(free, splat(0.0), margin), 0.0)


@forced_inline
def adsorb(phi: Float, fixed: Float, fibre: Float, row: int, c: int, law: Law) -> Any:
    """Fix dye in eight cells; the mobile dye that is left there."""
    there, held, room = load(phi, row, c), load(fixed, row, c), load(fibre, row, c)
    taken = lower(lower(law.rate * (there - held), room - held), there)
    if law.kind != FREUNDLICH or may_bind(law.first, there, held, taken, 1.0):
        taken = lower(taken, limit_of(law, there, room) - held)
    taken = higher(taken, splat(0.0))
    left = there - taken
    store(phi, row, c, left)
    store(fixed, row, c, held + taken)
    return left


@kernel
def adsorb_both(phi: Float, uptake: Uptake, b: int, start: int, row: int, r: int) -> None:
    """Fix dye in one row of both layers of band `b`, (2 r, w), from column `start` on."""
    law, fixed, fibre = Law(uptake.kind, uptake.first, uptake.second, uptake.rate), uptake.fixed[b], uptake.fibre[b]
    for at in (row, row + r):
        for c in range(start, phi.shape[1] - WIDTH, WIDTH):
            adsorb(phi, fixed, fibre, at, c, law)
