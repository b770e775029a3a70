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


def slopes(system: System, y: Long) -> Long:
    """(2, n, 3) derivatives of positions and velocities y: of springs, gravity and viscous damping, nothing else."""
    fabric, springs = system.fabric, system.fabric.springs
    (x, v), force = y, np.zeros_like(y[0])
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
    return np.stack([v, np.where(fabric.pinned[:, None], 0.0, a)])


def solve(system: System, duration: float, spans: int) -> Float:
    """Positions and velocities (2, n, 3) after `duration` [s], in `spans` extrapolated steps of the longest floats.

    Gragg's modified midpoint rule has an error in even powers of its step, which Neville's scheme
    takes away one by one (Hairer, Norsett & Wanner 1993, section II.9).
    """
    y: Long = np.stack([system.fabric.position, system.fabric.velocity]).astype(np.longdouble)
    for _ in range(spans):
        rows: list[list[Long]] = []
        for column in range(COLUMNS):
            row = [_midpoint(system, y, duration / spans, 2 * (column + 1))]
            for back in range(1, column + 1):
                ratio = ((column + 1) / (column + 1 - back)) ** 2
                row.append(row[-1] + (row[-1] - rows[-1][back - 1]) / (ratio - 1.0))
            rows.append(row)
        y = rows[-1][-1]
    return y.astype(np.float64)


def _midpoint(system: System, y: Long, span: float, steps: int) -> Long:
    h = span / steps
    before, now = y, y + h * slopes(system, y)
    for _ in range(steps - 1):
        before, now = now, before + 2.0 * h * slopes(system, now)
    return np.asarray(0.5 * (now + before + h * slopes(system, now)))
