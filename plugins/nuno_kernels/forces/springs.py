"""Damped springs: their force, their layout in runs and lists, and their tension for Newton's method."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.lanes import (
    WIDTH,
    Lanes,
    Triple,
    add_at,
    dot,
    edge,
    gather_triple,
    higher,
    load,
    minus,
    read,
    read_triple,
    root,
    splat,
    store,
    times,
    where_not_zero,
    write,
)
from nuno_kernels.step.blocks import (
    BLOCK,
    SHORTEST,
    Long,
    assign_runs,
    block_count,
    choose_runs,
    cut_runs,
    is_small,
    list_copies,
)
from nuno_kernels.terms import register
from nuno_schemas.fabric import Bool, Float, Int, Springs

# Damped springs: f_i += (k (|d| - L) + c (v_j - v_i).d^) d^ and the reverse on j, d = x_j - x_i.
#
# A spring that locks at the strain e has k' from there on: (k' - k) (|d| - (1 + e) L) is added where it is positive.
# A spring of zero length has no direction and exerts no force. Runs of springs whose vertices
# follow each other are read straight from the arrays, the rest through lists of indices; either
# way eight springs are computed at a time, each once per block that owns one of its ends.

LONGEST = 256
"""springs of a piece of a run: its forces wait in a buffer of 6 kB"""

FAR = 32
"""vertices between the ends from which both ends can be updated in one pass: nearer, a read would overlap the write
just before it and wait for it"""


class SpringRuns(NamedTuple):
    """Runs of springs whose vertices follow each other.

    start     (blocks + 1,) int64  tasks of each block
    task      (m, 5) int64         first vertex i, first vertex j, springs, column of the constants, and
                                   the ends to add to (1 the i end, 2 the j end, 3 both)
    constants (3, r) or (3, s)     k [N/m], rest [m], c [N s/m], one column per run or per spring; where any locks,
                                   (5, .) with what k grows by [N/m] and the length from which it does [m]
    each      True where there is one column per spring, else None
    damped    True where any c is not 0, else None
    locks     True where any locks, else None
    """

    start: Long
    task: Long
    constants: Float
    each: bool | None
    damped: bool | None
    locks: bool | None


class SpringLists(NamedTuple):
    """Springs by index, padded to whole vectors by springs from a vertex to itself.

    start     (blocks + 1,) int64  places of each block's springs
    ends      (4, p) int32         vertices i and j, then their columns in the block's forces
    constants (3, p) or (5, p)     as in SpringRuns
    damped, locks                  as in SpringRuns
    """

    start: Long
    ends: Int
    constants: Float
    damped: bool | None
    locks: bool | None


Lock = tuple[Lanes, Lanes]
"""the growth of k, and the length from which it holds, of eight springs"""


@kernel
def tensions(length: Lanes, k: Lanes, rest: Lanes, lock: Lock, locks: bool | None) -> Lanes:
    """Return tensions of eight springs: k (|d| - L), and beyond the lock the growth of k times the rest of |d|."""
    tension = k * (length - rest)
    return tension if locks is None else tension + lock[0] * higher(length - lock[1], splat(0.0))


@kernel
def tension_at(length: float, constants: Float, c: int, locks: bool | None) -> float:
    """Return the tension [N] of the spring of this length [m] whose constants stand in column c."""
    tension = constants[0, c] * (length - constants[1, c])
    if locks is not None:
        tension += constants[3, c] * max(length - constants[4, c], 0.0)
    return float(tension)


@kernel
def tension_over_length(d: Triple, k: Lanes, rest: Lanes, lock: Lock, locks: bool | None) -> Lanes:
    """Return k (|d| - L) / |d| [N/m], of undamped springs: exactly 0 at the rest length, which k - k L / |d| is not.

    The force on a spring's first vertex is this times d = x_j - x_i; `run_forces` and `listed_forces` add it.
    """
    square = dot(d, d)
    length = root(square)
    return where_not_zero(square, tensions(length, k, rest, lock, locks) / length)


@kernel
def damped_over_length(
    d: Triple, approach: Lanes, k: Lanes, rest: Lanes, c: Lanes, lock: Lock, locks: bool | None
) -> Lanes:
    """Return (k (|d| - L) + c approach / |d|) / |d| [N/m] with approach = (v_j - v_i).d: the same of damped springs."""
    square = dot(d, d)
    length = root(square)
    inverse = 1.0 / length
    return where_not_zero(square, (tensions(length, k, rest, lock, locks) + c * (approach * inverse)) * inverse)


@kernel
def run_constant(row: int, at: int, m: int, constants: Float, each: bool | None) -> Lanes:
    """Return one constant of up to eight springs of a run."""
    return splat(constants[row, at]) if each is None else read(constants, row, at, m)


@kernel
def run_lock(at: int, m: int, constants: Float, each: bool | None, locks: bool | None) -> Lock:
    """Return the lock of up to eight springs of a run: zeros if none locks.

    Not None, which numba would make an optional: unread values cost nothing.
    """
    if locks is None:
        return splat(0.0), splat(0.0)
    return run_constant(3, at, m, constants, each), run_constant(4, at, m, constants, each)


@kernel
def listed_lock(p: int, constants: Float, row: int, locks: bool | None) -> Lock:
    """Return the lock of eight listed springs, from this row of their constants on."""
    if locks is None:
        return splat(0.0), splat(0.0)
    return load(constants, row, p), load(constants, row + 1, p)


@kernel
def run_difference(x: Float, i: int, j: int, m: int) -> Triple:
    """Return x[:, j] - x[:, i] of up to eight consecutive ones."""
    return minus(read_triple(x, 0, j, m), read_triple(x, 0, i, m))


@kernel
def listed_difference(x: Float, indices: Int, which: int, p: int) -> Triple:
    """Return x at the indices in row `which` + 1 minus x at those in row `which`, of eight from place p on."""
    return minus(gather_triple(x, indices, which + 1, p), gather_triple(x, indices, which, p))


@kernel
def run_forces(
    x: Float, v: Float, ends: tuple[int, int], m: int, at: int, constants: Float, each: bool | None,
    damped: bool | None, locks: bool | None,
) -> Triple:  # fmt: skip
    """Return forces on the i ends of up to eight springs of a run, whose first has the `ends` i and j."""
    d = run_difference(x, ends[0], ends[1], m)
    k, rest = run_constant(0, at, m, constants, each), run_constant(1, at, m, constants, each)
    lock = run_lock(at, m, constants, each, locks)
    if damped is None:
        return times(tension_over_length(d, k, rest, lock, locks), d)
    approach = dot(run_difference(v, ends[0], ends[1], m), d)
    return times(damped_over_length(d, approach, k, rest, run_constant(2, at, m, constants, each), lock, locks), d)


@kernel
def add_runs(runs: SpringRuns, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add a block's runs to its forces (3, w); `origin` is the block's first vertex."""
    start, task, constants, each = runs.start, runs.task, runs.constants, runs.each
    wait = np.empty((3, LONGEST + WIDTH))
    for t in range(start[block], start[block + 1]):
        i, j, count, at, side = task[t, 0], task[t, 1], task[t, 2], task[t, 3], task[t, 4]
        near = side == 3 and j - i < FAR
        for q in range(0, count, WIDTH):
            m = min(WIDTH, count - q)
            where = at if each is None else at + q
            f = run_forces(x, v, (i + q, j + q), m, where, constants, each, runs.damped, runs.locks)
            for row in range(3):
                g = f[row]
                if side & 1:
                    write(force, row, i + q - origin, m, read(force, row, i + q - origin, m) + g)
                if near:
                    store(wait, row, q, g)
                elif side & 2:
                    write(force, row, j + q - origin, m, read(force, row, j + q - origin, m) - g)
        if near:
            for q in range(0, count, WIDTH):
                m = min(WIDTH, count - q)
                for row in range(3):
                    p = j + q - origin
                    write(force, row, p, m, read(force, row, p, m) - load(wait, row, q))


@kernel
def listed_forces(
    x: Float, v: Float, ends: Int, p: int, constants: Float, damped: bool | None, locks: bool | None
) -> Triple:
    """Return forces on the i ends of eight listed springs."""
    d, k, rest = listed_difference(x, ends, 0, p), load(constants, 0, p), load(constants, 1, p)
    lock = listed_lock(p, constants, 3, locks)
    if damped is None:
        return times(tension_over_length(d, k, rest, lock, locks), d)
    approach = dot(listed_difference(v, ends, 0, p), d)
    return times(damped_over_length(d, approach, k, rest, load(constants, 2, p), lock, locks), d)


@kernel
def add_lists(lists: SpringLists, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add a block's listed springs to its forces (3, w)."""
    start, ends, constants = lists.start, lists.ends, lists.constants
    for p in range(start[block], start[block + 1], WIDTH):
        f = listed_forces(x, v, ends, p, constants, lists.damped, lists.locks)
        for row in range(3):
            add_at(force, row, ends, 2, p, f[row])
            add_at(force, row, ends, 3, p, 0.0 - f[row])


def damps(springs: SpringRuns | SpringLists) -> bool:
    """Whether any spring has a damper."""
    return springs.damped is not None and bool(springs.constants[2].any())


for _kind, _add, _layout in ((SpringRuns, add_runs, "runs"), (SpringLists, add_lists, "lists")):
    register(
        _kind, "springs", reads_velocity=damps, block=_add, rows=f"linear:rows_of_spring_{_layout}",
        elements=f"linear:elements_of_spring_{_layout}", fill=f"linear:fill_spring_{_layout}",
        diagonal=f"linear:sum_spring_{_layout}", multiply=f"linear:multiply_spring_{_layout}",
        assemble="linear:assemble_springs", tension=f"springs:tension_of_{_layout}",
        turning=f"springs:turning_of_{_layout}", stiffest="springs:stiffest",
        constraints=f"constraints:constraints_of_spring_{_layout}", energy=f"energy:measure_spring_{_layout}",
    )  # fmt: skip


# Springs in the layout of their kernels: runs of consecutive vertices, and lists of the rest.


def pack_springs(springs: Springs | None, vertices: int) -> tuple[SpringRuns | SpringLists, ...]:
    """Return the kernel layout of a fabric's springs, runs before lists, without empty ones.

    Long runs with constants per run are taken as they are. All other springs are written out and sorted by the distance
    of their ends, then by vertex, which finds the runs of any net.
    """
    if springs is None or springs.number == 0:
        return ()
    blocks = block_count(vertices)
    per_run = springs.per_run
    direct = per_run & choose_runs(springs.count, springs.stride)
    first = np.sort(springs.first[direct], axis=1).astype(np.int64)
    runs = np.column_stack([first, springs.count[direct], np.arange(first.shape[0])])
    named = spring_constants(springs)
    constants = np.stack([values[direct] for values in named]) if per_run else np.empty((len(named), 0))
    if direct.all():
        return (_pack_runs(runs, constants, False, blocks),)
    # Constants per spring are most of a net's memory: from here on they are copied once.
    pairs, order = _sort_pairs(springs, direct)
    each = np.empty((len(named), order.shape[0]))
    for row, values in zip(each, named, strict=True):
        np.take(springs.per_spring(values), order, out=row)
    del order
    if is_small(springs.number):
        return (_pack_lists(pairs.astype(np.int64), each, vertices, general=True),)
    return _pack_pairs(pairs, each, runs, constants, vertices)


def spring_constants(springs: Springs) -> tuple[Float, ...]:
    """Return the rows of SpringRuns.constants, per run if all are so."""
    if springs.lock is None or springs.k_lock is None:
        return springs.k, springs.rest, springs.c
    constants = (springs.k, springs.rest, springs.c, springs.lock, springs.k_lock)
    k, rest, c, lock, k_lock = constants if springs.per_run else (springs.per_spring(values) for values in constants)
    return k, rest, c, k_lock - k, rest * (1.0 + lock)


def _sort_pairs(springs: Springs, direct: Bool) -> tuple[Int, Long]:
    """Return springs outside of the runs marked (m,), by distance of their ends, then by vertex: (s, 2) and their
    numbers among all springs.
    """
    pairs = springs.pairs()
    pairs.sort(axis=1)
    key = (pairs[:, 1] - pairs[:, 0]).astype(np.int64)
    key <<= 32
    key |= pairs[:, 0]
    key[np.repeat(direct, springs.count)] = np.iinfo(np.int64).max
    order = np.argsort(key, kind="stable")[: key.shape[0] - int(springs.count[direct].sum())]
    return pairs[order], order


def _pack_pairs(
    pairs: Int, each: Float, runs: Long, constants: Float, vertices: int
) -> tuple[SpringRuns | SpringLists, ...]:
    """Find the runs in sorted pairs (s, 2) with constants (3 or 5, s); join them to the `runs` there are.

    Constants per spring are kept only where runs of equal constants would cover much less.
    """
    follows = (np.diff(pairs, axis=0) == 1).all(axis=1)
    alike = follows.copy()
    for row in each:
        alike &= row[1:] == row[:-1]
    varied = runs.shape[0] == 0 and _long_share(alike) < 0.9 * _long_share(follows)
    first = np.flatnonzero(np.concatenate([[True], ~(follows if varied else alike)]))
    count = np.diff(np.concatenate([first, [pairs.shape[0]]]))
    long = count >= SHORTEST
    found = np.column_stack([pairs[first], count, first + constants.shape[1]])[long]
    listed = np.flatnonzero(np.repeat(~long, count))
    lists = (_pack_lists(pairs[listed].astype(np.int64), each[:, listed], vertices),) if listed.size else ()
    runs = np.concatenate([runs, found])
    if runs.shape[0] == 0:
        return lists
    joined = np.concatenate([constants, each], axis=1) if constants.shape[1] else each
    return _pack_runs(runs, joined, varied, block_count(vertices)), *lists


def _long_share(follows: Bool) -> float:
    """Return the share of springs that lie in runs of at least SHORTEST."""
    first = np.flatnonzero(np.concatenate([[True], ~follows]))
    count = np.diff(np.concatenate([first, [follows.shape[0] + 1]]))
    return float(count[count >= SHORTEST].sum() / (follows.shape[0] + 1))


def _pack_runs(runs: Long, constants: Float, each: bool, blocks: int) -> SpringRuns:
    """Cut (m, 4) runs at the blocks' borders; one task per block that owns an end."""
    cut = cut_runs(runs, LONGEST)
    if not each:
        used, source = np.unique(runs[:, 3], return_inverse=True)
        cut[:, 3] = source[cut[:, 4]]
        constants = constants[:, used]
    task, start = assign_runs(cut[:, :4], blocks)
    damped = True if constants[2].any() else None
    return SpringRuns(start, task, np.ascontiguousarray(constants), each or None, damped, locking(constants))


def locking(constants: Float) -> bool | None:
    """Return the mark of constants with rows for locks."""
    return True if constants.shape[0] > 3 else None


def _pack_lists(pairs: Long, constants: Float, vertices: int, general: bool = False) -> SpringLists:
    """Return lists per block of (s, 2) springs in the order of their vertices; `general` ones count as damped."""
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    constants = constants[:, order]
    element, start, ends = list_copies(pairs[order].T, vertices)
    constants = np.ascontiguousarray(np.where(element >= 0, constants[:, element], 0.0))
    damped = True if general or constants[2].any() else None
    return SpringLists(start, ends, constants, damped, locking(constants))


# Tension for Newton's method: the largest force, and the part that comes of turning.


@kernel
def size_of_tension(x: Float, i: int, j: int, constants: Float, c: int, locks: bool | None) -> float:
    """Return the size of a spring's tension [N], |k (|d| - L)| if it has not locked."""
    d = edge(x, i, j)
    return abs(tension_at(np.sqrt(dot(d, d)), constants, c, locks))


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
    before, now = edge(x0, i, j), edge(x, i, j)
    a, b = np.sqrt(dot(before, before)), np.sqrt(dot(now, now))
    if a == 0.0 or b == 0.0:
        return 0.0
    length = dot(before, now) / a
    tension = constants[0, c] * (b - length)
    if locks is not None:
        tension += constants[3, c] * (max(b - constants[4, c], 0.0) - max(length - constants[4, c], 0.0))
    return float(tension * dot(now, edge(d, i, j)) / b)


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
