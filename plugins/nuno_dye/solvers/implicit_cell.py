"""A cell's own equation in an implicit stage: its neighbours are given, its fibre and its limits are not split off.

    phi + (A - A_b) = b + sum over faces f w (phi_j - phi)

with weights w, f the factor of the face's receiver, and A what fibre holds at phi:

    A(phi) = max(A_0, min(V_d, A_d(phi), max(A_b, (A_b + rho phi) / (1 + rho))))

A_0 is fixed dye at the step's start (`least`), A_b where the stage begins (`fixed` of its Uptake), rho = D_ab dt / d^2:
within its limit fibre takes rho (phi - A)^+, and it gives nothing back. A grows with phi, so that there is one root,
and which of its pieces holds it is found by trying them.
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
"""Newton steps for Freundlich's limit at most; four or five do."""
BENDS = 60
"""Newton steps at most where D falls with dye; one to eight do."""


@kernel
def held_at(x: float, least: float, uptake: Uptake, at: int, c: int) -> float:
    """A at mobile dye x."""
    begun, room, rate = uptake.fixed[at, c], uptake.fibre[at, c], uptake.rate
    free = max(begun, (begun + rate * x) / (1.0 + rate))
    law = Law(uptake.kind, uptake.first, uptake.second, rate)
    limit = min(limit_beside(law, max(x, 0.0), room), room)
    held: float = max(least, min(limit, free))
    return held


@kernel
def solve_limit(law: Law, total: float, ways: float, room: float) -> float:
    """The x >= 0 with ways x + A_d(x) = total, total > 0."""
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
    """The x with ways x + A(x) - A_b = total."""
    if uptake is None or uptake.fibre[at, c] <= least:
        return total / ways
    begun, room, rate = uptake.fixed[at, c], uptake.fibre[at, c], uptake.rate
    law = Law(uptake.kind, uptake.first, uptake.second, rate)
    x: float = total / ways
    if x > begun:
        x = (total + begun * rate / (1.0 + rate)) / (ways + rate / (1.0 + rate))
    elif x <= 0.0:
        return x
    free = max(begun, (begun + rate * x) / (1.0 + rate))
    if min(limit_beside(law, x, room), room) >= free:
        return x
    total += begun
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
    """The level G(x) with x + (ways - 1) G(x) + A(x) - A_b = total, `near` being a level close to it.

    G is concave and lies below its tangent at any x, of which `solve_cell` knows the root: that root is
    no greater than the one sought, and from below it each of Newton's steps comes nearer.
    """
    if curve is None:
        return solve_cell(total, ways, least, uptake, at, c)
    x, level, through = amount(near, curve), near, ways - 1.0
    for _ in range(BENDS):
        slope = curve.cap if not x > curve.knee else curve.phi0 / x
        beyond = total - through * (level - slope * x)
        before, x = x, solve_cell(beyond, 1.0 + through * slope, least, uptake, at, c)
        level = potential(x, curve)
        # What is left is of the order of the step's square.
        if not abs(x - before) > 1e-8 * abs(x) or max(before, x) <= curve.knee:
            break
    return level


def hold_back(law: Law, floor: Float, least: Float, fixed: Float, room: Float) -> float:
    """Take from kept-up fibre what prolonging put beyond its limit at the floor, in place; what the supply saves.

    Left there, it would come off the fibre into a cell that is at its floor already, and raise it and its limit.
    """
    limit = law.first * (floor**law.second if law.kind == FREUNDLICH else floor)
    if law.kind == LANGMUIR:
        limit = room * limit / (1.0 + limit)
    beyond = np.where(floor > 0.0, np.maximum(fixed - np.maximum(least, np.minimum(limit, room)), 0.0), 0.0)
    fixed -= beyond
    return sum_compensated(beyond.reshape(-1))
