"""A cell's equation in an implicit stage, with fixed neighbours, and with its fibre and its limits.

    phi + (A - A_b) = b + sum over faces f w (phi_j - phi)

with weights w, f the factor of the face's receiver, and A the fixed dye at phi:

    A(phi) = max(A_0, min(V_d, A_d(phi), max(A_b, (A_b + rho phi) / (1 + rho))))

A_0 is fixed dye at the step's start (`least`), A_b at the stage's start (`fixed` of its Uptake), rho = D_ab dt / d^2:
within its limit fibre takes rho (phi - A)^+, and it releases none. A grows with phi, so that there is one root, and
trying the pieces of A finds it.
"""

from __future__ import annotations

import math

import numpy as np

from nuno_dye.laws.adsorption import FREUNDLICH, LANGMUIR, PARTITION, Law, Uptake
from nuno_dye.laws.potential import Curve, amount, potential
from nuno_dye.solvers.fixing import limit_beside
from nuno_dye.solvers.upkeep import sum_compensated
from nuno_kernels import kernel
from nuno_schemas.fabric import Float

ROUNDS = 40
"""The most Newton steps for Freundlich's limit; four or five suffice."""
BENDS = 60
"""The most Newton steps if D falls with dye; one to eight suffice."""


@kernel
def held_at(x: float, least: float, uptake: Uptake, at: int, c: int) -> float:
    """Return A at mobile dye x."""
    initial, capacity, rate = uptake.fixed[at, c], uptake.fibre[at, c], uptake.rate
    free = max(initial, (initial + rate * x) / (1.0 + rate))
    law = Law(uptake.kind, uptake.first, uptake.second, rate)
    limit = min(limit_beside(law, max(x, 0.0), capacity), capacity)
    held: float = max(least, min(limit, free))
    return held


@kernel
def solve_limit(law: Law, total: float, ways: float, room: float) -> float:
    """Return the x >= 0 with ways x + A_d(x) = total, total > 0."""
    first, second = law.first, law.second
    if law.kind == PARTITION:
        return total / (ways + first)
    if law.kind == FREUNDLICH:
        # Concave in x: from below its root Newton's steps stay below it.
        x = min(0.5 * total / ways, (0.5 * total / first) ** (1.0 / second)) if first > 0.0 else total / ways
        for _ in range(ROUNDS):
            bound = first * x**second
            step = (total - ways * x - bound) / (ways + second * bound / x) if x > 0.0 else 0.0
            x += step
            if step <= 1e-15 * x:
                break
        return x
    # ways K x^2 + (ways + K (V_d - S)) x - S = 0, the greater root, without cancellation.
    p, q = ways + first * (room - total), 4.0 * ways * first * total
    root = math.sqrt(p * p + q)
    return 2.0 * total / (p + root) if p > 0.0 else (root - p) / (2.0 * ways * first)


@kernel
def solve_cell(total: float, ways: float, least: float, uptake: Uptake | None, at: int, c: int) -> float:
    """Return the x with ways x + A(x) - A_b = total."""
    if uptake is None or uptake.fibre[at, c] <= least:
        return total / ways
    initial, room, rate = uptake.fixed[at, c], uptake.fibre[at, c], uptake.rate
    law = Law(uptake.kind, uptake.first, uptake.second, rate)
    x: float = total / ways
    if x > initial:
        x = (total + initial * rate / (1.0 + rate)) / (ways + rate / (1.0 + rate))
    elif x <= 0.0:
        return x
    free = max(initial, (initial + rate * x) / (1.0 + rate))
    if min(limit_beside(law, x, room), room) >= free:
        return x
    total += initial
    x = (total - least) / ways
    if limit_beside(law, max(x, 0.0), room) <= least:
        return x
    x = (total - room) / ways
    if x > 0.0 and limit_beside(law, x, room) >= room:
        return x
    return solve_limit(law, total, ways, room)


@kernel
def solve_level(
    total: float, ways: float, near: float, curve: Curve | None, least: float, uptake: Uptake | None, at: int, c: int
) -> float:
    """Return the level G(x) with x + (ways - 1) G(x) + A(x) - A_b = total, `near` being a level close to it. G is
    concave and below its tangent at any x, for which `solve_cell` gives the root: that root is no greater than the one
    sought, and from below it each Newton step comes nearer.
    """
    if curve is None:
        return solve_cell(total, ways, least, uptake, at, c)
    x, level, through = amount(near, curve), near, ways - 1.0
    for _ in range(BENDS):
        slope = curve.cap if not x > curve.knee else curve.phi0 / x
        remainder = total - through * (level - slope * x)
        previous, x = x, solve_cell(remainder, 1.0 + through * slope, least, uptake, at, c)
        level = potential(x, curve)
        # The remaining error is of the order of the step's square.
        if not abs(x - previous) > 1e-8 * abs(x) or max(previous, x) <= curve.knee:
            break
    return level


def remove_excess(law: Law, floor: Float, least: Float, fixed: Float, room: Float) -> float:
    """Remove from the fibre of maintained cells the dye that extrapolation put beyond its limit at the floor, in place.
    Return its amount, which the supply saves. Otherwise it would return from the fibre into a cell that is already at
    its floor, and raise it and its limit.
    """
    limit = law.first * (floor**law.second if law.kind == FREUNDLICH else floor)
    if law.kind == LANGMUIR:
        limit = room * limit / (1.0 + limit)
    excess = np.where(floor > 0.0, np.maximum(fixed - np.maximum(least, np.minimum(limit, room)), 0.0), 0.0)
    fixed -= excess
    return sum_compensated(excess.reshape(-1))
