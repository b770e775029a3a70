"""Adsorption within a long step: a rate in each of its stages, and settled at its end.

A stage takes D_ab / d^2 (phi - A) or D_ab / d^2 phi, but at most `pace` times the distance to the limit min(V_d,
A_d(phi)), so that fixed dye reaches its limit within a few explicit steps. The stages damp those modes by at least
half a step. The remaining distance to the limit is taken at the end: the A of a cell that holds S = phi + A satisfies
A = A_d(S - A), or, if phi is maintained, A_d(phi). It is at most what D_ab allows in the step, at the mean phi.
"""

from __future__ import annotations

import math
from typing import Any

from numba import prange

from nuno_dye.laws.adsorption import Law, Uptake, law_in, limited
from nuno_dye.solvers.diffusion import LEFT, Rows
from nuno_kernels import forced_inline, kernel, parallel_kernel
from nuno_kernels.formula import limit_at, method_or
from nuno_kernels.lanes import higher, lower, splat
from nuno_schemas.fabric import Float

ROUNDS = 150
"""The most steps to a formula's root: a third of them bisect, to the last bit."""


@forced_inline
def taken_at(phi: Any, fixed: Any, room: Any, law: Law, pace: float) -> Any:
    """Return the uptake of eight cells. A tuple of arrays as argument would make the call cost more than its work."""
    taken = lower(law.rate * (phi - law.back * fixed), pace * (room - fixed))
    return higher(limited(law, phi, fixed, room, taken, pace), splat(0.0))


@kernel
def limit_beside(law: Law, phi: float, room: float) -> float:
    """Return A_d at mobile dye phi."""
    limit: float = limit_at(law.isotherm, max(phi, 0.0), room)
    return limit


@kernel
def find_root(isotherm: Any, total: float, ways: float, room: float) -> float:
    """Return the x >= 0 with ways x + A_d(x) = total, total > 0.

    The left side rises, from 0 to at least the total at x = total / ways. Regula falsi finds where it crosses, with
    half the value of an end that stays twice (Illinois); every third step bisects, as A_d may begin at any slope.
    """
    low, high, below, side = 0.0, total / ways, -total, 0
    above, x = limit_at(isotherm, high, room), high
    for turn in range(ROUNDS):
        if not above > 0.0 or high - low <= 1e-15 * high:
            break
        x = 0.5 * (low + high) if turn % 3 == 2 else low - below * (high - low) / (above - below)
        value = ways * x + limit_at(isotherm, x, room) - total
        if value < 0.0:
            low, below, above, side = x, value, above * (0.5 if side < 0 else 1.0), -1
        else:
            high, above, below, side = x, value, below * (0.5 if side > 0 else 1.0), 1
    return x


root_of = method_or("root", find_root)


@kernel
def limit_within(law: Law, total: float, room: float) -> float:
    """Return the A with A = A_d(S - A)."""
    return limit_beside(law, root_of(law.isotherm, total, 1.0, room), room) if total > 0.0 else 0.0


@kernel
def settle_row(
    phi: Float, before: Float, fixed: Float, begun: Uptake, floor: Float, row: int, nx: int, pace: float
) -> None:
    """Bring a row's fixed dye to its limit; `before` is mobile dye at the step's start, `begun` fixed dye then."""
    held, fibre = begun.fixed, begun.fibre
    law = law_in(begun)
    for c in range(LEFT, LEFT + nx):
        mobile, bound, room = phi[row, c], fixed[row, c], fibre[row, c]
        if not (mobile > law.back * bound and room > bound):
            continue
        limit = min(limit_beside(law, mobile, room), room)
        if not (limit > bound and pace * (limit - bound) < law.rate * (mobile - law.back * bound)):
            continue
        mean = 0.5 * (mobile + before[row, c])
        if mobile > floor[row, c]:
            limit = limit_within(law, mobile + bound, room)
        free = mean - (mean - held[row, c]) * math.exp(-law.rate) if law.back > 0.0 else held[row, c] + law.rate * mean
        most = min(min(limit, room), free)
        taken = min(max(most - bound, 0.0), mobile)
        phi[row, c], fixed[row, c] = mobile - taken, bound + taken


@parallel_kernel
def settle_bands(
    cuts: Rows, phi: Float, before: Float, fixed: Float, begun: Uptake, floor: Float, nx: int, pace: float
) -> None:
    """Settle all rows of both layers, (2 r, w)."""
    r = phi.shape[0] // 2
    for b in prange(cuts.shape[0] - 1):
        for row in range(cuts[b], cuts[b + 1]):
            for layer in range(2):
                settle_row(phi, before, fixed, begun, floor, row + layer * r, nx, pace)


@kernel
def bound_row(phi: Float, before: Float, fixed: Float, begun: Uptake, floor: Float, row: int, nx: int) -> None:
    """Bring a row's fixed dye between that at the start and its limit; the rest becomes mobile again. The limit is A_d
    of the larger mobile amount of the step's start and end. Stages oscillate about a limit that they approach by 2 rho
    dt / s^2 (Legendre's polynomials), 5 % of it if fibre fills in the first half hour.
    """
    held, fibre = begun.fixed, begun.fibre
    law = law_in(begun)
    for c in range(LEFT, LEFT + nx):
        least, total = held[row, c], phi[row, c] + fixed[row, c]
        bound = min(max(fixed[row, c], least), max(fibre[row, c], least))
        if bound > least:
            room, most = fibre[row, c], max(before[row, c], floor[row, c])
            if bound > limit_beside(law, max(most, total - bound), room):
                limit = limit_beside(law, most, room)
                limit = max(limit, limit_within(law, max(total, 0.0), room))
                bound = min(bound, max(limit, least))
        phi[row, c], fixed[row, c] = total - bound, bound


@parallel_kernel
def bound_bands(cuts: Rows, phi: Float, before: Float, fixed: Float, begun: Uptake, floor: Float, nx: int) -> None:
    """Bound all rows of both layers, (2 r, w)."""
    r = phi.shape[0] // 2
    for b in prange(cuts.shape[0] - 1):
        for row in range(cuts[b], cuts[b + 1]):
            for layer in range(2):
                bound_row(phi, before, fixed, begun, floor, row + layer * r, nx)
