"""Adsorption within a long step: as a rate in each of its stages, and settled at its end.

A stage takes D_ab / d^2 (phi - A), but no more than `pace` times what the limit min(V_d, A_d(phi)) leaves, so that
fixed dye comes to its limit within a few explicit steps. Those modes the stages damp by half a step at least; what
they leave to the limit is taken at the end: what a cell that holds S = phi + A takes is the A with A = A_d(S - A),
or, where phi is kept up, A_d(phi). It is never more than D_ab allows in the step, at the mean phi.
"""

from __future__ import annotations

import math
from typing import Any

from numba import prange

from nuno_dye.laws.adsorption import FREUNDLICH, PARTITION, Law, Uptake, limit_of, may_bind
from nuno_dye.solvers.diffusion import LEFT, Rows
from nuno_kernels import forced_inline, kernel, parallel_kernel
from nuno_kernels.lanes.choose import higher, lower
from nuno_kernels.lanes.simd import splat
from nuno_schemas.fabric import Float

ROUNDS = 60
"""Newton steps at most; five or six do."""


@forced_inline
def taken_at(phi: Any, fixed: Any, room: Any, law: Law, pace: float) -> Any:
    """What eight cells take. With a tuple of arrays as its argument the call cost more than all that it does."""
    taken = lower(law.rate * (phi - fixed), pace * (room - fixed))
    if law.kind != FREUNDLICH or may_bind(law.first, phi, fixed, taken, pace):
        taken = lower(taken, pace * (limit_of(law, phi, room) - fixed))
    return higher(taken, splat(0.0))


@kernel
def limit_beside(law: Law, phi: float, room: float) -> float:
    """A_d at mobile dye phi."""
    if law.kind == PARTITION:
        return law.first * phi
    if law.kind == FREUNDLICH:
        power: float = phi**law.second
        return law.first * power
    return room * law.first * phi / (1.0 + law.first * phi)


@kernel
def limit_within(law: Law, total: float, room: float) -> float:
    """The A with A = A_d(S - A)."""
    first, second = law.first, law.second
    if law.kind == PARTITION:
        return first * total / (1.0 + first)
    if law.kind == FREUNDLICH:
        # phi + k phi^b = S is concave in phi: from below its root Newton's steps stay below it.
        phi = min(0.5 * total, (0.5 * total / first) ** (1.0 / second)) if first > 0.0 else total
        for _ in range(ROUNDS):
            bound = first * phi**second
            step = (total - phi - bound) / (1.0 + second * bound / phi) if phi > 0.0 else 0.0
            phi += step
            if step <= 1e-16 * phi:
                break
        return total - phi
    # K A^2 - (1 + K (S + V_d)) A + V_d K S = 0, the lesser root, without cancellation.
    p = 1.0 + first * (total + room)
    return 2.0 * room * first * total / (p + math.sqrt(max(p * p - 4.0 * first * first * room * total, 0.0)))


@kernel
def settle_row(
    phi: Float, before: Float, fixed: Float, begun: Uptake, floor: Float, row: int, nx: int, pace: float
) -> None:
    """Bring a row's fixed dye to its limit; `before` is mobile dye at the step's start, `begun` fixed dye there."""
    held, fibre = begun.fixed, begun.fibre
    law = Law(begun.kind, begun.first, begun.second, begun.rate)
    for c in range(LEFT, LEFT + nx):
        there, found, room = phi[row, c], fixed[row, c], fibre[row, c]
        if not (there > found and room > found):
            continue
        limit = min(limit_beside(law, there, room), room)
        if not (limit > found and pace * (limit - found) < law.rate * (there - found)):
            continue
        mean = 0.5 * (there + before[row, c])
        if there > floor[row, c]:
            limit = limit_within(law, there + found, room)
        most = min(min(limit, room), mean - (mean - held[row, c]) * math.exp(-law.rate))
        taken = min(max(most - found, 0.0), there)
        phi[row, c], fixed[row, c] = there - taken, found + taken


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
    """Bring a row's fixed dye between that at the start and what was allowed; the rest is mobile again.

    What is allowed is A_d of the more mobile dye of the step's start and its end. Stages swing about a limit that
    they come to by 2 rho dt / s^2 (Legendre's polynomials), 5 % of it where the first half hour fills fibre.
    """
    held, fibre = begun.fixed, begun.fibre
    law = Law(begun.kind, begun.first, begun.second, begun.rate)
    for c in range(LEFT, LEFT + nx):
        least, there = held[row, c], phi[row, c] + fixed[row, c]
        found = min(max(fixed[row, c], least), max(fibre[row, c], least))
        if found > least:
            room, most = fibre[row, c], max(before[row, c], floor[row, c])
            if found > limit_beside(law, max(most, there - found), room):
                limit = limit_beside(law, most, room)
                limit = max(limit, limit_within(law, max(there, 0.0), room))
                found = min(found, max(limit, least))
        phi[row, c], fixed[row, c] = there - found, found


@parallel_kernel
def bound_bands(cuts: Rows, phi: Float, before: Float, fixed: Float, begun: Uptake, floor: Float, nx: int) -> None:
    """Bound all rows of both layers, (2 r, w)."""
    r = phi.shape[0] // 2
    for b in prange(cuts.shape[0] - 1):
        for row in range(cuts[b], cuts[b + 1]):
            for layer in range(2):
                bound_row(phi, before, fixed, begun, floor, row + layer * r, nx)
