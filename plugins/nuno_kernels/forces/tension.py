"""Tension for Newton's method: the largest force, and the part that comes of turning."""

from __future__ import annotations

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.forces.springs import SpringLists, SpringRuns, tension_at
from nuno_kernels.step.blocks import BLOCK
from nuno_schemas.fabric import Float


@kernel
def size_of_tension(x: Float, i: int, j: int, constants: Float, c: int, locks: bool | None) -> float:
    """Return the size of a spring's tension [N], |k (|d| - L)| if it has not locked."""
    dx, dy, dz = x[0, j] - x[0, i], x[1, j] - x[1, i], x[2, j] - x[2, i]
    return abs(tension_at(np.sqrt(dx * dx + dy * dy + dz * dz), constants, c, locks))


@kernel
def tension_of_runs(runs: SpringRuns, x: Float) -> float:
    """Return the largest tension [N] of springs in runs."""
    largest, task, constants = 0.0, runs.task, runs.constants
    for t in range(task.shape[0]):
        for q in range(task[t, 2]):
            c = task[t, 3] if runs.each is None else task[t, 3] + q
            largest = max(largest, size_of_tension(x, task[t, 0] + q, task[t, 1] + q, constants, c, runs.locks))
    return largest


@kernel
def tension_of_lists(lists: SpringLists, x: Float) -> float:
    """Return the largest tension [N] of listed springs."""
    largest, ends, constants = 0.0, lists.ends, lists.constants
    for c in range(ends.shape[1]):
        largest = max(largest, size_of_tension(x, ends[0, c], ends[1, c], constants, c, lists.locks))
    return largest


@kernel
def turning(x0: Float, x: Float, d: Float, i: int, j: int, constants: Float, c: int, locks: bool | None) -> float:
    """Return the work [J] along d of the tension that a spring got by turning from a to b.

    It is (T(|b|) - T(a.b / |a|)) b.(d_j - d_i) / |b|.
    """
    ax, ay, az = x0[0, j] - x0[0, i], x0[1, j] - x0[1, i], x0[2, j] - x0[2, i]
    bx, by, bz = x[0, j] - x[0, i], x[1, j] - x[1, i], x[2, j] - x[2, i]
    a, b = np.sqrt(ax * ax + ay * ay + az * az), np.sqrt(bx * bx + by * by + bz * bz)
    if a == 0.0 or b == 0.0:
        return 0.0
    length = (ax * bx + ay * by + az * bz) / a
    tension = constants[0, c] * (b - length)
    if locks is not None:
        tension += constants[3, c] * (max(b - constants[4, c], 0.0) - max(length - constants[4, c], 0.0))
    return float(tension * (bx * (d[0, j] - d[0, i]) + by * (d[1, j] - d[1, i]) + bz * (d[2, j] - d[2, i])) / b)


@kernel
def turning_of_runs(runs: SpringRuns, x0: Float, x: Float, d: Float) -> float:
    """Return the sum of `turning` over springs in runs, each once: by the task that adds to its first end."""
    total, task, constants = 0.0, runs.task, runs.constants
    for t in range(task.shape[0]):
        if task[t, 4] & 1:
            for q in range(task[t, 2]):
                c = task[t, 3] if runs.each is None else task[t, 3] + q
                total += turning(x0, x, d, task[t, 0] + q, task[t, 1] + q, constants, c, runs.locks)
    return total


@kernel
def turning_of_lists(lists: SpringLists, x0: Float, x: Float, d: Float) -> float:
    """Return the sum of `turning` over listed springs, each once: by its first end's block."""
    total, ends, constants = 0.0, lists.ends, lists.constants
    for block in range(lists.start.shape[0] - 1):
        for c in range(lists.start[block], lists.start[block + 1]):
            if ends[0, c] // BLOCK == block:
                total += turning(x0, x, d, ends[0, c], ends[1, c], constants, c, lists.locks)
    return total


def stiffest(springs: SpringRuns | SpringLists) -> float:
    """Return the greatest stiffness of any spring [N/m]."""
    constants = springs.constants
    k = constants[0] if constants.shape[0] == 3 else constants[0] + np.maximum(constants[3], 0.0)
    return float(k.max(initial=0.0))
