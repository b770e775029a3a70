"""Damped springs: f_i += (k (|d| - L) + c (v_j - v_i).d^) d^ and the reverse on j, d = x_j - x_i.

A spring that locks at the strain e has k' from there on: (k' - k) (|d| - (1 + e) L) is added where it is positive.
A spring of zero length has no direction and exerts no force. Runs of springs whose vertices
follow each other are read straight from the arrays, the rest through lists of indices; either
way eight springs are computed at a time, each once per block that owns one of its ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.lanes.choose import higher, where_not_zero
from nuno_kernels.lanes.simd import WIDTH, Lanes, Triple, add_at, load, read, root, splat, store, write
from nuno_kernels.lanes.triples import dot, gather_triple, minus, read_triple, times
from nuno_kernels.step.blocks import Long
from nuno_kernels.terms import register
from nuno_schemas.fabric import Float, Int

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
    pull = k * (length - rest)
    return pull if locks is None else pull + lock[0] * higher(length - lock[1], splat(0.0))


@kernel
def tension_at(length: float, constants: Float, c: int, locks: bool | None) -> float:
    """Return the tension [N] of the spring of this length [m] whose constants stand in column c."""
    pull = constants[0, c] * (length - constants[1, c])
    if locks is not None:
        pull += constants[3, c] * max(length - constants[4, c], 0.0)
    return float(pull)


@kernel
def pull(d: Triple, k: Lanes, rest: Lanes, lock: Lock, locks: bool | None) -> Lanes:
    """Return k (|d| - L) / |d|: exactly 0 at the rest length, which k - k L / |d| is not."""
    square = dot(d, d)
    length = root(square)
    return where_not_zero(square, tensions(length, k, rest, lock, locks) / length)


@kernel
def damped_pull(d: Triple, approach: Lanes, k: Lanes, rest: Lanes, c: Lanes, lock: Lock, locks: bool | None) -> Lanes:
    """Return (k (|d| - L) + c approach / |d|) / |d| with approach = (v_j - v_i).d."""
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
        return times(pull(d, k, rest, lock, locks), d)
    approach = dot(run_difference(v, ends[0], ends[1], m), d)
    return times(damped_pull(d, approach, k, rest, run_constant(2, at, m, constants, each), lock, locks), d)


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
        return times(pull(d, k, rest, lock, locks), d)
    approach = dot(listed_difference(v, ends, 0, p), d)
    return times(damped_pull(d, approach, k, rest, load(constants, 2, p), lock, locks), d)


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
        _kind,
        name="springs",
        block=_add,
        reads_velocity=damps,
        energy=f"nuno_kernels.forces.energy:measure_spring_{_layout}",
        tension=f"nuno_kernels.forces.tension:tension_of_{_layout}",
        turning=f"nuno_kernels.forces.tension:turning_of_{_layout}",
        stiffest="nuno_kernels.forces.tension:stiffest",
        rows=f"nuno_kernels.forces.linear:rows_of_spring_{_layout}",
        elements=f"nuno_kernels.forces.linear:elements_of_spring_{_layout}",
        constraints=f"nuno_kernels.forces.constraint_packing:constraints_of_spring_{_layout}",
        fill=f"nuno_kernels.forces.linear:fill_spring_{_layout}",
        diagonal=f"nuno_kernels.forces.diagonal:sum_spring_{_layout}",
        multiply=f"nuno_kernels.forces.linear:multiply_spring_{_layout}",
        assemble="nuno_kernels.forces.assembly:assemble_springs",
    )
