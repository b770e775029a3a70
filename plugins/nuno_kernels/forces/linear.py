"""Springs and hinges linearised at a state: the rows, products, diagonal blocks and assembly of an implicit step's
matrix.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.forces.hinges import LONGEST, HingeLists, HingeRuns, add_waiting, hinge_shape
from nuno_kernels.forces.springs import (
    FAR,
    Lock,
    SpringLists,
    SpringRuns,
    listed_difference,
    listed_lock,
    run_constant,
    run_difference,
    run_lock,
    tensions,
)
from nuno_kernels.forces.springs import LONGEST as LONGEST_SPRINGS
from nuno_kernels.lanes import (
    WIDTH,
    Lanes,
    Triple,
    add_at,
    dot,
    gather_triple,
    higher,
    load,
    load_triple,
    minus,
    plus,
    read,
    read_triple,
    root,
    splat,
    store,
    times,
    where_greater,
    where_not_zero,
    write,
)
from nuno_kernels.step.blocks import BLOCK, Long
from nuno_schemas.fabric import Float, Int

# The layout of the rows of linear springs and hinges.

SPRING_ROWS, HINGE_ROWS = 4, 9
Rows = tuple[Lanes, ...]
"""rows of eight springs or hinges"""


@by_reference
class LinearRuns(NamedTuple):
    """Runs of springs or hinges: their tasks, each with the column of its first element, and (4 or 9, c) rows."""

    start: Long
    task: Long
    column: Long
    rows: Float


@by_reference
class LinearLists(NamedTuple):
    """Listed springs or hinges: their indices and (4 or 9, p) rows."""

    start: Long
    indices: Int
    rows: Float


Linear = LinearRuns | LinearLists


def linear_runs(rows: int, counts: int) -> Callable[[SpringRuns | HingeRuns], LinearRuns]:
    """Return a function that allocates the rows of runs, whose tasks hold their length in column `counts`."""

    def make(runs: SpringRuns | HingeRuns) -> LinearRuns:
        ends = np.cumsum(runs.task[:, counts])
        return LinearRuns(runs.start, runs.task, ends - runs.task[:, counts], np.zeros((rows, int(ends[-1]) + WIDTH)))

    return make


def linear_lists(rows: int, name: str) -> Callable[[Any], LinearLists]:
    """Return a function that allocates the rows of lists, whose indices are in the field `name`."""

    def make(lists: Any) -> LinearLists:
        indices = getattr(lists, name)
        return LinearLists(lists.start, indices, np.zeros((rows, indices.shape[1])))

    return make


def run_elements(corners: int) -> Callable[[LinearRuns], tuple[Long, Long]]:
    """Return a function that finds columns (p,) and vertices (corners, p) of elements in runs, each once."""

    def find(runs: LinearRuns) -> tuple[Long, Long]:
        block = np.repeat(np.arange(runs.start.shape[0] - 1), np.diff(runs.start))
        once = runs.task[:, 0] // BLOCK == block
        task, column = runs.task[once], runs.column[once]
        count = task[:, corners]
        step = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        return np.repeat(column, count) + step, np.repeat(task[:, :corners], count, axis=0).T + step

    return find


def listed_elements(corners: int) -> Callable[[LinearLists], tuple[Long, Long]]:
    """Return the same for lists, whose padding is at one vertex only."""

    def find(lists: LinearLists) -> tuple[Long, Long]:
        block = np.repeat(np.arange(lists.start.shape[0] - 1), np.diff(lists.start))
        vertices = lists.indices[:corners]
        once = (vertices[0] // BLOCK == block) & (vertices != vertices[0]).any(axis=0)
        return np.flatnonzero(once), vertices[:, once].astype(np.int64)

    return find


# The 3 x 3 blocks of springs and hinges on the diagonal of an implicit step's matrix.


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


# Linearised springs and hinges, added to the entries of a factorisation: a term's role `assemble`.


@kernel
def assemble_springs(linear: Linear, places: Any, diagonal: Float, values: Float) -> None:
    """Add springs, alpha I + w w^T each."""
    rows, vertices = linear.rows, places.vertices
    block = np.empty(6)
    for p in range(places.column.shape[0]):
        c = places.column[p]
        alpha, x, y, z = rows[0, c], rows[1, c], rows[2, c], rows[3, c]
        block[0], block[1], block[2] = alpha + x * x, alpha + y * y, alpha + z * z
        block[3], block[4], block[5] = x * y, x * z, y * z
        for end in range(2):
            for row in range(6):
                diagonal[row, vertices[end, p]] += block[row]
        at, width = places.at[0, p], abs(places.width[0, p])
        if at >= 0:
            values[0, at] -= block[0]
            values[0, at + 1] -= block[3]
            values[0, at + 2] -= block[4]
            values[0, at + width] -= block[3]
            values[0, at + width + 1] -= block[1]
            values[0, at + width + 2] -= block[5]
            values[0, at + 2 * width] -= block[4]
            values[0, at + 2 * width + 1] -= block[5]
            values[0, at + 2 * width + 2] -= block[2]


@kernel
def assemble_hinges(linear: Linear, places: Any, diagonal: Float, values: Float) -> None:
    """Add hinges, g g^T each; the rows hold g at corner 1, -g at 2 and at 3, and corner 0 balances them."""
    rows, vertices = linear.rows, places.vertices
    g = np.empty((4, 3))
    for p in range(places.column.shape[0]):
        c = places.column[p]
        for axis in range(3):
            g[1, axis], g[2, axis], g[3, axis] = rows[axis, c], -rows[3 + axis, c], -rows[6 + axis, c]
            g[0, axis] = -(g[1, axis] + g[2, axis] + g[3, axis])
        for corner in range(4):
            add_outer(diagonal, vertices[corner, p], 0.0, g[corner, 0], g[corner, 1], g[corner, 2])
        pair = 0
        for i in range(4):
            for j in range(i + 1, 4):
                at, width = places.at[pair, p], places.width[pair, p]
                first, second = (i, j) if width > 0 else (j, i)
                if at >= 0:
                    for row in range(3):
                        for column in range(3):
                            values[0, at + row * abs(width) + column] += g[first, row] * g[second, column]
                pair += 1


# Springs and hinges linearised at a state: the symmetric positive matrix that implicit methods solve with.
#
# A spring's stiffness is alpha (I - d^ d^T) + k d^ d^T with alpha = k max(0, 1 - L/|d|). For one that has locked alpha
# is max(0, T / |d|), and dT / d|d| stands in the place of k. Without the maximum a compressed spring is indefinite
# across its direction (Choi & Ko 2002, ACM Trans. Graph. 21, 604-611); that is the `floor` 0, and a lower one leaves
# the spring's exact derivative. Its damping adds c d^ d^T times the rate dv/dx of the method. Both are kept as alpha
# and w, K = alpha I + w w^T. A hinge is kept as g g^T with g = sqrt(k cos(angle - rest)) times the gradient of its
# angle: Gauss and Newton's matrix, which leaves out the moment times the angle's second derivative, and nothing beyond
# a right angle.
#
# Every block keeps copies of its own for the elements that cross its border, as the forces do.


@kernel
def slope_at(length: Lanes, k: Lanes, lock: Lock, locks: bool | None) -> Lanes:
    """Return dT / d|d| of eight springs."""
    return k if locks is None else k + where_greater(length, lock[1], lock[0])


@kernel
def spring_rows(
    d: Triple, d0: Triple, k: Lanes, rest: Lanes, damping: Lanes, lock: Lock, locks: bool | None, floor: float,
    follow: float,
) -> Rows:  # fmt: skip
    """Return alpha and w of eight springs along d, which were along d0; `damping` is c times the rate; 0 at length 0.

    alpha is by the expected tension, at the length d0.d / |d0|, or |d0| if `follow` is 0.
    """
    square, square0 = dot(d, d), dot(d0, d0)
    inverse = where_not_zero(square, 1.0 / root(square))
    length0 = root(square0)
    expected = length0 + follow * where_not_zero(square0, dot(d0, d) / length0 - length0)
    # A spring of length 0 has no entries, like its force: with any, vertices at one place would have
    # different rows, and rounding alone would separate them, whereupon the spring throws them apart.
    across = where_not_zero(square, higher(tensions(expected, k, rest, lock, locks) * inverse, splat(floor)))
    slope = slope_at(root(square), k, lock, locks)
    across = slope - higher(slope - across, splat(0.0))
    size = root(slope - across + damping) * inverse
    return across, size * d[0], size * d[1], size * d[2]


@kernel
def fill_spring_runs(
    runs: SpringRuns, linear: LinearRuns, block: int, x: Float, before: Float, rate: float, floor: float, follow: float
) -> None:
    """Write the rows of a block's runs at x (3, n), after a step from `before`."""
    task, constants, rows = runs.task, runs.constants, linear.rows
    for t in range(runs.start[block], runs.start[block + 1]):
        i, j, count, at = task[t, 0], task[t, 1], task[t, 2], task[t, 3]
        for q in range(0, count, WIDTH):
            m = min(WIDTH, count - q)
            place = at if runs.each is None else at + q
            k, rest = run_constant(0, place, m, constants, runs.each), run_constant(1, place, m, constants, runs.each)
            c = run_constant(2, place, m, constants, runs.each)
            lock = run_lock(place, m, constants, runs.each, runs.locks)
            d, d0 = run_difference(x, i + q, j + q, m), run_difference(before, i + q, j + q, m)
            found = spring_rows(d, d0, k, rest, rate * c, lock, runs.locks, floor, follow)
            for row in range(SPRING_ROWS):
                write(rows, row, linear.column[t] + q, m, found[row])


@kernel
def fill_spring_lists(
    lists: SpringLists, linear: LinearLists, block: int, x: Float, before: Float, rate: float, floor: float,
    follow: float,
) -> None:  # fmt: skip
    """Write the rows of a block's listed springs at x (3, n), after a step from `before`."""
    ends, constants = lists.ends, lists.constants
    for p in range(lists.start[block], lists.start[block + 1], WIDTH):
        d, d0 = listed_difference(x, ends, 0, p), listed_difference(before, ends, 0, p)
        k, rest, c = load(constants, 0, p), load(constants, 1, p), load(constants, 2, p)
        lock = listed_lock(p, constants, 3, lists.locks)
        rows = spring_rows(d, d0, k, rest, rate * c, lock, lists.locks, floor, follow)
        for row in range(SPRING_ROWS):
            store(linear.rows, row, p, rows[row])


@kernel
def spring_product(alpha: Lanes, w: Triple, d: Triple) -> Triple:
    """Return (alpha I + w w^T) d of eight springs."""
    return plus(times(alpha, d), times(dot(w, d), w))


@kernel
def multiply_spring_runs(runs: SpringRuns, linear: LinearRuns, block: int, origin: int, u: Float, out: Float) -> None:
    """Add the products of a block's runs with u (3, n) to `out` (3, w)."""
    task, rows = linear.task, linear.rows
    wait = np.empty((3, LONGEST_SPRINGS + WIDTH))
    for t in range(linear.start[block], linear.start[block + 1]):
        i, j, count, side, at = task[t, 0], task[t, 1], task[t, 2], task[t, 4], linear.column[t]
        near = side == 3 and j - i < FAR
        for q in range(0, count, WIDTH):
            m = min(WIDTH, count - q)
            d = run_difference(u, j + q, i + q, m)
            f = spring_product(read(rows, 0, at + q, m), read_triple(rows, 1, at + q, m), d)
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
def multiply_spring_lists(
    lists: SpringLists, linear: LinearLists, block: int, origin: int, u: Float, out: Float
) -> None:
    """Add the products of a block's listed springs with u (3, n) to `out` (3, w)."""
    ends, rows = linear.indices, linear.rows
    for p in range(linear.start[block], linear.start[block + 1], WIDTH):
        d = minus(gather_triple(u, ends, 0, p), gather_triple(u, ends, 1, p))
        f = spring_product(load(rows, 0, p), load_triple(rows, 1, p), d)
        for row in range(3):
            add_at(out, row, ends, 2, p, f[row])
            add_at(out, row, ends, 3, p, 0.0 - f[row])


@kernel
def hinge_rows(x0: Triple, x1: Triple, x2: Triple, x3: Triple, k_cos: Lanes, k_sin: Lanes) -> Rows:
    """Return sqrt(k cos(angle - rest)) times the gradient of eight hinges' angles at x1, x2 (negative) and x3
    (negative).

    |e| / (|n1|^2 |n2|^2) = |e| |e|^2 r, with r of nuno_kernels.forces.hinges.hinge_shape.
    """
    n1, n2, d3, ee, q1, q2, r, t2, t3 = hinge_shape(x0, x1, x2, x3)
    cosine, sine = dot(n1, n2) * root(r * ee), dot(n1, d3) * (ee * root(r))
    k = higher(k_cos * cosine + k_sin * sine, splat(0.0))
    size = root(k * ee) * (ee * r)
    f2, f3 = times(size * q2, n1), times(size * q1, n2)
    return plus(times(t2, f2), times(t3, f3)) + f2 + f3


@kernel
def fill_hinge_runs(
    runs: HingeRuns, linear: LinearRuns, block: int, x: Float, before: Float, rate: float, floor: float, follow: float
) -> None:
    """Write the rows of a block's hinge runs at x (3, n)."""
    task, constants = runs.task, runs.constants
    for t in range(runs.start[block], runs.start[block + 1]):
        at = task[t, 5]
        for q in range(0, task[t, 4], WIDTH):
            m = min(WIDTH, task[t, 4] - q)
            found = hinge_rows(
                read_triple(x, 0, task[t, 0] + q, m), read_triple(x, 0, task[t, 1] + q, m),
                read_triple(x, 0, task[t, 2] + q, m), read_triple(x, 0, task[t, 3] + q, m),
                splat(constants[0, at]), splat(constants[1, at]),
            )  # fmt: skip
            for row in range(HINGE_ROWS):
                write(linear.rows, row, linear.column[t] + q, m, found[row])


@kernel
def fill_hinge_lists(
    lists: HingeLists, linear: LinearLists, block: int, x: Float, before: Float, rate: float, floor: float,
    follow: float,
) -> None:  # fmt: skip
    """Write the rows of a block's listed hinges at x (3, n)."""
    corners, constants = lists.corners, lists.constants
    for p in range(lists.start[block], lists.start[block + 1], WIDTH):
        rows = hinge_rows(
            gather_triple(x, corners, 0, p), gather_triple(x, corners, 1, p), gather_triple(x, corners, 2, p),
            gather_triple(x, corners, 3, p), load(constants, 0, p), load(constants, 1, p),
        )  # fmt: skip
        for row in range(HINGE_ROWS):
            store(linear.rows, row, p, rows[row])


@kernel
def hinge_product(g: Rows, u0: Triple, u1: Triple, u2: Triple, u3: Triple) -> Lanes:
    """Return g.u of eight hinges, g given by its nine rows."""
    a, b, c = minus(u1, u0), minus(u0, u2), minus(u0, u3)
    return (
        g[0] * a[0] + g[1] * a[1] + g[2] * a[2] + g[3] * b[0] + g[4] * b[1] + g[5] * b[2]
        + g[6] * c[0] + g[7] * c[1] + g[8] * c[2]
    )  # fmt: skip


@kernel
def multiply_hinge_runs(runs: HingeRuns, linear: LinearRuns, block: int, origin: int, u: Float, out: Float) -> None:
    """Add the products of a block's hinge runs with u (3, n) to `out` (3, w); they wait as forces do."""
    task, rows = linear.task, linear.rows
    wait = np.empty((12, LONGEST + WIDTH))
    for t in range(linear.start[block], linear.start[block + 1]):
        at = linear.column[t]
        for q in range(0, task[t, 4], WIDTH):
            m, c = min(WIDTH, task[t, 4] - q), at + q
            g = read_triple(rows, 0, c, m) + read_triple(rows, 3, c, m) + read_triple(rows, 6, c, m)
            s = hinge_product(
                g, read_triple(u, 0, task[t, 0] + q, m), read_triple(u, 0, task[t, 1] + q, m),
                read_triple(u, 0, task[t, 2] + q, m), read_triple(u, 0, task[t, 3] + q, m),
            )  # fmt: skip
            for row in range(3):
                store(wait, row, q, s * (g[3 + row] + g[6 + row] - g[row]))
                store(wait, 3 + row, q, s * g[row])
                store(wait, 6 + row, q, 0.0 - s * g[3 + row])
                store(wait, 9 + row, q, 0.0 - s * g[6 + row])
        add_waiting(out, task, t, origin, wait)


@kernel
def multiply_hinge_lists(lists: HingeLists, linear: LinearLists, block: int, origin: int, u: Float, out: Float) -> None:
    """Add the products of a block's listed hinges with u (3, n) to `out` (3, w)."""
    corners, rows = linear.indices, linear.rows
    for p in range(linear.start[block], linear.start[block + 1], WIDTH):
        g = load_triple(rows, 0, p) + load_triple(rows, 3, p) + load_triple(rows, 6, p)
        s = hinge_product(
            g, gather_triple(u, corners, 0, p), gather_triple(u, corners, 1, p),
            gather_triple(u, corners, 2, p), gather_triple(u, corners, 3, p),
        )  # fmt: skip
        for row in range(3):
            add_at(out, row, corners, 4, p, s * (g[3 + row] + g[6 + row] - g[row]))
            add_at(out, row, corners, 5, p, s * g[row])
            add_at(out, row, corners, 6, p, 0.0 - s * g[3 + row])
            add_at(out, row, corners, 7, p, 0.0 - s * g[6 + row])


rows_of_spring_runs, elements_of_spring_runs = linear_runs(SPRING_ROWS, 2), run_elements(2)
rows_of_hinge_runs, elements_of_hinge_runs = linear_runs(HINGE_ROWS, 4), run_elements(4)
elements_of_spring_lists, elements_of_hinge_lists = listed_elements(2), listed_elements(4)
rows_of_spring_lists, rows_of_hinge_lists = linear_lists(SPRING_ROWS, "ends"), linear_lists(HINGE_ROWS, "corners")
