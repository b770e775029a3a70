"""The 3 x 3 blocks of springs and hinges on the diagonal of an implicit step's matrix."""

from __future__ import annotations

from nuno_kernels import kernel
from nuno_kernels.forces.hinges import HingeLists, HingeRuns
from nuno_kernels.forces.linear_layout import LinearLists, LinearRuns
from nuno_kernels.forces.springs import SpringLists, SpringRuns
from nuno_schemas.fabric import Float


@kernel
def add_outer(out: Float, at: int, across: float, x: float, y: float, z: float) -> None:
    """Add across I + (x, y, z) (x, y, z)^T to column `at` of (6, w), with negative `across` cut off."""
    across = max(across, 0.0)
    out[0, at] += across + x * x
    out[1, at] += across + y * y
    out[2, at] += across + z * z
    out[3, at] += x * y
    out[4, at] += x * z
    out[5, at] += y * z


@kernel
def sum_spring_runs(runs: SpringRuns, linear: LinearRuns, block: int, origin: int, out: Float) -> None:
    """Add the diagonal blocks of a block's runs to (6, w)."""
    task, rows = linear.task, linear.rows
    for t in range(linear.start[block], linear.start[block + 1]):
        for q in range(task[t, 2]):
            c = linear.column[t] + q
            if task[t, 4] & 1:
                add_outer(out, task[t, 0] + q - origin, rows[0, c], rows[1, c], rows[2, c], rows[3, c])
            if task[t, 4] & 2:
                add_outer(out, task[t, 1] + q - origin, rows[0, c], rows[1, c], rows[2, c], rows[3, c])


@kernel
def add_hinge(out: Float, corner: int, at: int, g: Float, c: int) -> None:
    """Add one corner's block of the hinge in column `c` of g (9, .) to column `at` of (6, w)."""
    if corner == 0:
        add_outer(out, at, 0.0, g[3, c] + g[6, c] - g[0, c], g[4, c] + g[7, c] - g[1, c], g[5, c] + g[8, c] - g[2, c])
    else:
        row = 3 * (corner - 1)
        add_outer(out, at, 0.0, g[row, c], g[row + 1, c], g[row + 2, c])


@kernel
def sum_hinge_runs(runs: HingeRuns, linear: LinearRuns, block: int, origin: int, out: Float) -> None:
    """Add the diagonal blocks of a block's hinge runs to (6, w)."""
    task = linear.task
    for t in range(linear.start[block], linear.start[block + 1]):
        for corner in range(4):
            if (task[t, 6] >> corner) & 1:
                for q in range(task[t, 4]):
                    add_hinge(out, corner, task[t, corner] + q - origin, linear.rows, linear.column[t] + q)


@kernel
def sum_spring_lists(lists: SpringLists, linear: LinearLists, block: int, origin: int, out: Float) -> None:
    """Add the diagonal blocks of a block's listed springs to (6, w)."""
    rows = linear.rows
    for c in range(linear.start[block], linear.start[block + 1]):
        for end in range(2):
            add_outer(out, linear.indices[2 + end, c], rows[0, c], rows[1, c], rows[2, c], rows[3, c])


@kernel
def sum_hinge_lists(lists: HingeLists, linear: LinearLists, block: int, origin: int, out: Float) -> None:
    """Add the diagonal blocks of a block's listed hinges to (6, w)."""
    for c in range(linear.start[block], linear.start[block + 1]):
        for corner in range(4):
            add_hinge(out, corner, linear.indices[4 + corner, c], linear.rows, c)
