"""Springs and hinges made linear at a state: the symmetric positive matrix that implicit methods solve with.

A spring's stiffness is alpha (I - d^ d^T) + k d^ d^T with alpha = k max(0, 1 - L/|d|): without the
maximum a compressed spring is indefinite across its direction (Choi & Ko 2002, ACM Trans. Graph. 21,
604-611); that is the `floor` 0, and a lower one leaves the spring's exact derivative. Its damping adds
c d^ d^T times the rate dv/dx of the method. Both are kept as alpha and w, K = alpha I + w w^T. A hinge is
kept as g g^T with g = sqrt(k cos(angle - rest)) times the gradient of its angle: Gauss and Newton's
matrix, which leaves out the moment times the angle's second derivative, and nothing beyond a right angle.

Every block keeps copies of its own for the elements that cross its border, as the forces do.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.blocks import Long
from nuno_kernels.hinges import (
    FLAT,
    LONGEST,
    HingeLists,
    HingeRuns,
    cross,
    dot,
    listed_corner,
    minus,
    run_corner,
    times,
)
from nuno_kernels.simd import WIDTH, add_at, gather, load, read, root, splat, store, write
from nuno_kernels.simd_choose import higher, where_greater, where_not_zero
from nuno_kernels.springs import FAR, SpringLists, SpringRuns
from nuno_kernels.springs import LONGEST as LONGEST_SPRINGS
from nuno_schemas.fabric import Float, Int

SPRING_ROWS, HINGE_ROWS = 4, 9


class LinearRuns(NamedTuple):
    """Runs of springs or hinges: their tasks, each with the column of its first element, and (4 or 9, c) rows."""

    start: Long
    task: Long
    column: Long
    rows: Float


class LinearLists(NamedTuple):
    """Listed springs or hinges: their indices and (4 or 9, p) rows."""

    start: Long
    indices: Int
    rows: Float


@kernel
def spring_rows(dx: Any, dy: Any, dz: Any, k: Any, rest: Any, damping: Any, floor: float) -> Any:
    """alpha and w of eight springs; `damping` is c times the rate. All are 0 at length 0."""
    square = dx * dx + dy * dy + dz * dz
    inverse = where_not_zero(square, 1.0 / root(square))
    # A spring of length 0 has no entries, like its force: with any, vertices that lie together would have
    # different rows, and rounding alone would part them, whereupon the spring throws them apart.
    across = where_not_zero(square, higher(k * (1.0 - rest * inverse), splat(floor)))
    size = root(k - across + damping) * inverse
    return across, size * dx, size * dy, size * dz


@kernel
def fill_spring_runs(block: int, x: Any, runs: Any, linear: Any, rate: float, floor: float) -> None:
    """Write the rows of a block's runs at x (3, n)."""
    task, constants, rows = runs.task, runs.constants, linear.rows
    for t in range(runs.start[block], runs.start[block + 1]):
        i, j, count, at = task[t, 0], task[t, 1], task[t, 2], task[t, 3]
        for q in range(0, count, WIDTH):
            m = min(WIDTH, count - q)
            dx = read(x, 0, j + q, m) - read(x, 0, i + q, m)
            dy = read(x, 1, j + q, m) - read(x, 1, i + q, m)
            dz = read(x, 2, j + q, m) - read(x, 2, i + q, m)
            k = splat(constants[0, at]) if runs.each is None else read(constants, 0, at + q, m)
            rest = splat(constants[1, at]) if runs.each is None else read(constants, 1, at + q, m)
            c = splat(constants[2, at]) if runs.each is None else read(constants, 2, at + q, m)
            found = spring_rows(dx, dy, dz, k, rest, rate * c, floor)
            for row in range(SPRING_ROWS):
                write(rows, row, linear.column[t] + q, m, found[row])


@kernel
def fill_spring_lists(block: int, x: Any, lists: Any, linear: Any, rate: float, floor: float) -> None:
    """Write the rows of a block's listed springs at x (3, n)."""
    ends, constants = lists.ends, lists.constants
    for p in range(lists.start[block], lists.start[block + 1], WIDTH):
        dx = gather(x, 0, ends, 1, p) - gather(x, 0, ends, 0, p)
        dy = gather(x, 1, ends, 1, p) - gather(x, 1, ends, 0, p)
        dz = gather(x, 2, ends, 1, p) - gather(x, 2, ends, 0, p)
        k, rest, c = load(constants, 0, p), load(constants, 1, p), load(constants, 2, p)
        found = spring_rows(dx, dy, dz, k, rest, rate * c, floor)
        for row in range(SPRING_ROWS):
            store(linear.rows, row, p, found[row])


@kernel
def spring_product(a: Any, wx: Any, wy: Any, wz: Any, dx: Any, dy: Any, dz: Any) -> Any:
    """(alpha I + w w^T) d of eight springs."""
    s = wx * dx + wy * dy + wz * dz
    return a * dx + wx * s, a * dy + wy * s, a * dz + wz * s


@kernel
def multiply_spring_runs(block: int, origin: int, u: Any, out: Any, linear: Any) -> None:
    """Add the products of a block's runs with u (3, n) to `out` (3, w)."""
    task, rows = linear.task, linear.rows
    wait = np.empty((3, LONGEST_SPRINGS + WIDTH))
    for t in range(linear.start[block], linear.start[block + 1]):
        i, j, count, side, at = task[t, 0], task[t, 1], task[t, 2], task[t, 4], linear.column[t]
        near = side == 3 and j - i < FAR
        for q in range(0, count, WIDTH):
            m = min(WIDTH, count - q)
            f = spring_product(
                read(rows, 0, at + q, m), read(rows, 1, at + q, m), read(rows, 2, at + q, m), read(rows, 3, at + q, m),
                read(u, 0, i + q, m) - read(u, 0, j + q, m), read(u, 1, i + q, m) - read(u, 1, j + q, m),
                read(u, 2, i + q, m) - read(u, 2, j + q, m),
            )  # fmt: skip
            for row in range(3):
                if side & 1:
                    write(out, row, i + q - origin, m, read(out, row, i + q - origin, m) + f[row])
                if near:
                    store(wait, row, q, f[row])
                elif side & 2:
                    write(out, row, j + q - origin, m, read(out, row, j + q - origin, m) - f[row])
        if near:
            for q in range(0, count, WIDTH):
                m, p = min(WIDTH, count - q), j + q - origin
                for row in range(3):
                    write(out, row, p, m, read(out, row, p, m) - load(wait, row, q))


@kernel
def multiply_spring_lists(block: int, u: Any, out: Any, linear: Any) -> None:
    """Add the products of a block's listed springs with u (3, n) to `out` (3, w)."""
    ends, rows = linear.indices, linear.rows
    for p in range(linear.start[block], linear.start[block + 1], WIDTH):
        f = spring_product(
            load(rows, 0, p), load(rows, 1, p), load(rows, 2, p), load(rows, 3, p),
            gather(u, 0, ends, 0, p) - gather(u, 0, ends, 1, p), gather(u, 1, ends, 0, p) - gather(u, 1, ends, 1, p),
            gather(u, 2, ends, 0, p) - gather(u, 2, ends, 1, p),
        )  # fmt: skip
        for row in range(3):
            add_at(out, row, ends, 2, p, f[row])
            add_at(out, row, ends, 3, p, 0.0 - f[row])


@kernel
def hinge_rows(x0: Any, x1: Any, x2: Any, x3: Any, k_cos: Any, k_sin: Any) -> Any:
    """sqrt(k cos(angle - rest)) times the gradient of eight hinges' angles at x1, x2 (negative) and x3 (negative).

    With r = 1 / (q1 q2 e^2) as in nuno_kernels.hinges.hinge_forces: |e| / (q1 q2) = |e| e^2 r.
    """
    e, d2, d3 = minus(x1, x0), minus(x2, x0), minus(x3, x0)
    n1, n2 = cross(e, d2), cross(d3, e)
    ee, q1, q2 = dot(e, e), dot(n1, n1), dot(n2, n2)
    r = where_greater(q2, FLAT * ee * dot(d3, d3), 1.0 / (q1 * q2 * ee))
    r = where_greater(q1, FLAT * ee * dot(d2, d2), r)
    cosine, sine = dot(n1, n2) * root(r * ee), dot(n1, d3) * (ee * root(r))
    k = higher(k_cos * cosine + k_sin * sine, splat(0.0))
    size = root(k * ee) * (ee * r)
    f2, f3 = times(size * q2, n1), times(size * q1, n2)
    t2, t3 = dot(d2, e) * (r * q1 * q2), dot(d3, e) * (r * q1 * q2)
    return (
        t2 * f2[0] + t3 * f3[0], t2 * f2[1] + t3 * f3[1], t2 * f2[2] + t3 * f3[2],
        f2[0], f2[1], f2[2], f3[0], f3[1], f3[2],
    )  # fmt: skip


@kernel
def fill_hinge_runs(block: int, x: Any, runs: Any, linear: Any) -> None:
    """Write the rows of a block's hinge runs at x (3, n)."""
    task, constants = runs.task, runs.constants
    for t in range(runs.start[block], runs.start[block + 1]):
        at = task[t, 5]
        for q in range(0, task[t, 4], WIDTH):
            m = min(WIDTH, task[t, 4] - q)
            found = hinge_rows(
                run_corner(x, task[t, 0] + q, m), run_corner(x, task[t, 1] + q, m),
                run_corner(x, task[t, 2] + q, m), run_corner(x, task[t, 3] + q, m),
                splat(constants[0, at]), splat(constants[1, at]),
            )  # fmt: skip
            for row in range(HINGE_ROWS):
                write(linear.rows, row, linear.column[t] + q, m, found[row])


@kernel
def fill_hinge_lists(block: int, x: Any, lists: Any, linear: Any) -> None:
    """Write the rows of a block's listed hinges at x (3, n)."""
    corners, constants = lists.corners, lists.constants
    for p in range(lists.start[block], lists.start[block + 1], WIDTH):
        found = hinge_rows(
            listed_corner(x, corners, 0, p), listed_corner(x, corners, 1, p), listed_corner(x, corners, 2, p),
            listed_corner(x, corners, 3, p), load(constants, 0, p), load(constants, 1, p),
        )  # fmt: skip
        for row in range(HINGE_ROWS):
            store(linear.rows, row, p, found[row])


@kernel
def hinge_product(g: Any, u0: Any, u1: Any, u2: Any, u3: Any) -> Any:
    """g.u of eight hinges, g given by its nine rows."""
    a, b, c = minus(u1, u0), minus(u0, u2), minus(u0, u3)
    return (
        g[0] * a[0] + g[1] * a[1] + g[2] * a[2] + g[3] * b[0] + g[4] * b[1] + g[5] * b[2]
        + g[6] * c[0] + g[7] * c[1] + g[8] * c[2]
    )  # fmt: skip


@kernel
def multiply_hinge_runs(block: int, origin: int, u: Any, out: Any, linear: Any) -> None:
    """Add the products of a block's hinge runs with u (3, n) to `out` (3, w); they wait as forces do."""
    task, rows = linear.task, linear.rows
    wait = np.empty((12, LONGEST + WIDTH))
    for t in range(linear.start[block], linear.start[block + 1]):
        at = linear.column[t]
        for q in range(0, task[t, 4], WIDTH):
            m, c = min(WIDTH, task[t, 4] - q), at + q
            g = (
                read(rows, 0, c, m), read(rows, 1, c, m), read(rows, 2, c, m), read(rows, 3, c, m), read(rows, 4, c, m),
                read(rows, 5, c, m), read(rows, 6, c, m), read(rows, 7, c, m), read(rows, 8, c, m),
            )  # fmt: skip
            s = hinge_product(
                g, run_corner(u, task[t, 0] + q, m), run_corner(u, task[t, 1] + q, m),
                run_corner(u, task[t, 2] + q, m), run_corner(u, task[t, 3] + q, m),
            )  # fmt: skip
            for row in range(3):
                store(wait, row, q, s * (g[3 + row] + g[6 + row] - g[row]))
                store(wait, 3 + row, q, s * g[row])
                store(wait, 6 + row, q, 0.0 - s * g[3 + row])
                store(wait, 9 + row, q, 0.0 - s * g[6 + row])
        for corner in range(4):
            if (task[t, 6] >> corner) & 1:
                for q in range(0, task[t, 4], WIDTH):
                    m, p = min(WIDTH, task[t, 4] - q), task[t, corner] + q - origin
                    for row in range(3):
                        write(out, row, p, m, read(out, row, p, m) + load(wait, 3 * corner + row, q))


@kernel
def multiply_hinge_lists(block: int, u: Any, out: Any, linear: Any) -> None:
    """Add the products of a block's listed hinges with u (3, n) to `out` (3, w)."""
    corners, rows = linear.indices, linear.rows
    for p in range(linear.start[block], linear.start[block + 1], WIDTH):
        g = (
            load(rows, 0, p), load(rows, 1, p), load(rows, 2, p), load(rows, 3, p), load(rows, 4, p),
            load(rows, 5, p), load(rows, 6, p), load(rows, 7, p), load(rows, 8, p),
        )  # fmt: skip
        s = hinge_product(
            g, listed_corner(u, corners, 0, p), listed_corner(u, corners, 1, p),
            listed_corner(u, corners, 2, p), listed_corner(u, corners, 3, p),
        )  # fmt: skip
        for row in range(3):
            add_at(out, row, corners, 4, p, s * (g[3 + row] + g[6 + row] - g[row]))
            add_at(out, row, corners, 5, p, s * g[row])
            add_at(out, row, corners, 6, p, 0.0 - s * g[3 + row])
            add_at(out, row, corners, 7, p, 0.0 - s * g[6 + row])


def linear_runs(runs: SpringRuns | HingeRuns | None, rows: int, counts: int) -> LinearRuns | None:
    """Room for the rows of runs, whose tasks hold their length in column `counts`."""
    if runs is None:
        return None
    ends = np.cumsum(runs.task[:, counts])
    return LinearRuns(runs.start, runs.task, ends - runs.task[:, counts], np.zeros((rows, int(ends[-1]) + WIDTH)))


def linear_lists(start: Long, indices: Int, rows: int) -> LinearLists:
    """Room for the rows of lists."""
    return LinearLists(start, indices, np.zeros((rows, indices.shape[1])))


def linear_springs(runs: SpringRuns | None, lists: SpringLists | None) -> tuple[LinearRuns | None, LinearLists | None]:
    """Room for the springs' rows."""
    found = None if lists is None else linear_lists(lists.start, lists.ends, SPRING_ROWS)
    return linear_runs(runs, SPRING_ROWS, 2), found


def linear_hinges(runs: HingeRuns | None, lists: HingeLists | None) -> tuple[LinearRuns | None, LinearLists | None]:
    """Room for the hinges' rows."""
    found = None if lists is None else linear_lists(lists.start, lists.corners, HINGE_ROWS)
    return linear_runs(runs, HINGE_ROWS, 4), found
