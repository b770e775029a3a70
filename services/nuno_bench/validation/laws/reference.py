"""An independent solution of a spring net: forces by their definition in NumPy, integrated by extrapolation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Float
from nuno_schemas.system import System

Long = NDArray[np.floating[Any]]
COLUMNS = 6
"""Of the extrapolation table: order 12. More would cost digits: the scheme's weights alternate and grow."""


def accelerations(system: System, x: Long, v: Long) -> Long:
    """(n, 3) [m/s^2] of damped springs, gravity and viscous damping at x, v (n, 3); nothing else."""
    fabric, springs = system.fabric, system.fabric.springs
    force = np.zeros_like(x)
    if springs is not None:
        i, j = springs.pairs().T
        k, rest, c = (springs.per_spring(values) for values in (springs.k, springs.rest, springs.c))
        d = x[j] - x[i]
        length = np.sqrt((d * d).sum(axis=1))
        along = d / length[:, None]
        pull = k * (length - rest) + c * ((v[j] - v[i]) * along).sum(axis=1)
        np.add.at(force, i, pull[:, None] * along)
        np.add.at(force, j, -pull[:, None] * along)
    a = force / fabric.mass[:, None] + system.gravity - system.damping * v
    return np.where(fabric.pinned[:, None], 0.0, a)


def solve(system: System, duration: float, spans: int) -> tuple[Float, Float]:
    """x and v (n, 3) after `duration` [s], in `spans` extrapolated steps of the longest floats there are.

    Gragg's modified midpoint rule has an error in even powers of its step, which Neville's scheme
    takes away one by one (Hairer, Norsett & Wanner 1993, section II.9).
    """
    y: Long = np.stack([system.fabric.position, system.fabric.velocity]).astype(np.longdouble)
    for _ in range(spans):
        rows: list[list[Long]] = []
        for column in range(COLUMNS):
            row: list[Long] = [_midpoint(system, y, duration / spans, 2 * (column + 1))]
            for back in range(1, column + 1):
                ratio = ((column + 1) / (column + 1 - back)) ** 2
                row.append(row[-1] + (row[-1] - rows[-1][back - 1]) / (ratio - 1.0))
            rows.append(row)
        y = rows[-1][-1]
    return y[0].astype(np.float64), y[1].astype(np.float64)


def _midpoint(system: System, y: Long, span: float, steps: int) -> Long:
    def slope(z: Long) -> Long:
        return np.stack([z[1], accelerations(system, z[0], z[1])])

    h = span / steps
    before, now = y, y + h * slope(y)
    for _ in range(steps - 1):
        before, now = now, before + 2.0 * h * slope(now)
    result: Long = 0.5 * (now + before + h * slope(now))
    return result
