"""A strip clamped at one end, on its side: the weight under which it tips over."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.linalg

from nuno_bench.instruments.rig import Rig, mount
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float

FIRST_ZERO = 12.8538
"""Six times the first zero of Bessel's function J of order -1/6."""
LOAD = 0.03
"""Share of the critical weight under which the strip is looked at."""
HELD = 4
TIMES, BALANCED = 60, 1e-4
"""Newton's method finds the strip at rest in its plane, to this share of the load."""


def critical(poisson: float) -> float:
    """w L^3 / B at which a narrow strip tips over."""
    return FIRST_ZERO * math.sqrt(2.0 / (1.0 + poisson))


def tips_over(fabric: object, rigidity: float, density: float, length: float, edges: int, wide: int,
              solver: str | None = None, **model: Any) -> float:  # fmt: skip
    """w L^3 / B at which a strip of `length` [m] and `wide` of its edges across, of rigidity B [N m] and density
    [kg/m^2], has no stiffness left against tipping over.

    Sideways stiffness is linear in the stress, and so in the weight: it is found without, and where the strip rests in
    its own plane under a small part of it, which bends it there by next to nothing.
    """
    edge = length / edges
    size, hold = [length + HELD * edge, wide * edge], HELD * edge
    rig = mount("buckling", fabric, size=size, hold=hold, edge=edge, solver=solver, **model)
    weight = density * length**3 / rigidity
    gravity = LOAD * critical(0.0) / weight
    start, free = rig.fabric.position.copy(), np.flatnonzero(~rig.fabric.pinned)
    start[:, 2] = 0.0
    rig.state.x[...] = start
    bare, inside = stiffness(rig, free, (2,)), stiffness(rig, free, (0, 1))
    load = np.zeros((len(free), 2))
    load[:, 1] = -gravity * rig.fabric.mass[free]
    for _ in range(TIMES):
        left = load + rig.forces()[free, :2]
        if np.abs(left).max() < BALANCED * np.abs(load).max():
            break
        rig.state.x[free, :2] += np.linalg.solve(inside, left.reshape(-1)).reshape(-1, 2)
    else:
        raise RunFailed("buckling: the strip finds no rest in its plane")
    stressed = (stiffness(rig, free, (2,)) - bare) / gravity
    most = scipy.linalg.eigh(-stressed, bare, eigvals_only=True)[-1]
    return float(weight / most)


def stiffness(rig: Rig, free: Any, axes: tuple[int, ...]) -> Float:
    """(f a, f a) stiffness [N/m] of the free vertices (f,) along some axes, in the present state.

    By central differences of two widths: what is moved across stiff cloth stretches it with the square of the way.
    """
    step, x, size = 1e-6 * rig.problem.size, rig.state.x, len(axes)
    found = np.empty((size * len(free), size * len(free)))
    for column, (vertex, axis) in enumerate((v, a) for v in free for a in axes):
        kept, pushed = x[vertex, axis], []
        for way in (-2.0, -1.0, 1.0, 2.0):
            x[vertex, axis] = kept + way * step
            pushed.append(rig.forces()[free][:, axes].reshape(-1))
        x[vertex, axis] = kept
        found[:, column] = (pushed[3] - pushed[0] - 8.0 * (pushed[2] - pushed[1])) / (12.0 * step)
    return np.asarray(0.5 * (found + found.T))
