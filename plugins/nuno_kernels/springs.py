"""Damped springs: f_i += (k (|d| - L) + c (v_j - v_i).d^) d^ and the reverse on j, d = x_j - x_i.

A spring of zero length has no direction and exerts no force. Runs of springs whose vertices
follow each other are read straight from the arrays, the rest through lists of indices; either
way eight springs are computed at a time, each once per block that owns one of its ends.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.blocks import (
    SHORTEST,
    Long,
    assign_runs,
    block_count,
    choose_runs,
    cut_runs,
    local_targets,
    owned_copies,
    pad_lists,
)
from nuno_kernels.simd import WIDTH, add_at, gather, load, read, root, splat, store, write
from nuno_kernels.simd_choose import where_not_zero
from nuno_schemas.fabric import Bool, Float, Int, Springs

LONGEST = 256
"""Springs of a piece of a run: its forces wait in a buffer of 6 kB."""

FAR = 32
"""Vertices between the ends from which both ends can be updated in one pass: nearer, a read
would overlap the write just before it and wait for it."""


class SpringRuns(NamedTuple):
    """Runs of springs whose vertices follow each other.

    start     (blocks + 1,) int64  tasks of each block
    task      (m, 5) int64         first vertex i, first vertex j, springs, column of the constants, and
                                   the ends to add to (1 the i end, 2 the j end, 3 both)
    constants (3, r) or (3, s)     k [N/m], rest [m], c [N s/m], one column per run or per spring
    each      True where there is one column per spring, else None
    damped    True where any c is not 0, else None
    """

    start: Long
    task: Long
    constants: Float
    each: bool | None
    damped: bool | None


class SpringLists(NamedTuple):
    """Springs by index, padded to whole vectors by springs from a vertex to itself.

    start     (blocks + 1,) int64  places of each block's springs
    ends      (4, p) int32         vertices i and j, then their columns in the block's forces
    constants (3, p) float64       k [N/m], rest [m], c [N s/m]
    damped    as in SpringRuns
    """

    start: Long
    ends: Int
    constants: Float
    damped: bool | None


@kernel
def pull(dx: Any, dy: Any, dz: Any, k: Any, rest: Any) -> Any:
    """k (|d| - L) / |d|: exactly 0 at the rest length, which k - k L / |d| is not."""
    square = dx * dx + dy * dy + dz * dz
    length = root(square)
    return where_not_zero(square, k * (length - rest) / length)


@kernel
def damped_pull(dx: Any, dy: Any, dz: Any, approach: Any, k: Any, rest: Any, c: Any) -> Any:
    """(k (|d| - L) + c approach / |d|) / |d| with approach = (v_j - v_i).d."""
    square = dx * dx + dy * dy + dz * dz
    length = root(square)
    inverse = 1.0 / length
    return where_not_zero(square, (k * (length - rest) + c * (approach * inverse)) * inverse)


@kernel
def run_forces(x: Any, v: Any, i: int, j: int, m: int, at: int, constants: Any, each: Any, damped: Any) -> Any:
    """Forces on the i ends of up to eight springs of a run."""
    dx = read(x, 0, j, m) - read(x, 0, i, m)
    dy = read(x, 1, j, m) - read(x, 1, i, m)
    dz = read(x, 2, j, m) - read(x, 2, i, m)
    k = splat(constants[0, at]) if each is None else read(constants, 0, at, m)
    rest = splat(constants[1, at]) if each is None else read(constants, 1, at, m)
    if damped is None:
        w = pull(dx, dy, dz, k, rest)
    else:
        c = splat(constants[2, at]) if each is None else read(constants, 2, at, m)
        approach = (
            (read(v, 0, j, m) - read(v, 0, i, m)) * dx
            + (read(v, 1, j, m) - read(v, 1, i, m)) * dy
            + (read(v, 2, j, m) - read(v, 2, i, m)) * dz
        )
        w = damped_pull(dx, dy, dz, approach, k, rest, c)
    return w * dx, w * dy, w * dz


@kernel
def add_runs(
    block: int, origin: int, x: Any, v: Any, force: Any,
    start: Any, task: Any, constants: Any, each: Any, damped: Any,
) -> None:  # fmt: skip
    """Add a block's runs to its forces (3, w); `origin` is the block's first vertex."""
    wait = np.empty((3, LONGEST + WIDTH))
    for t in range(start[block], start[block + 1]):
        i, j, count, at, side = task[t, 0], task[t, 1], task[t, 2], task[t, 3], task[t, 4]
        near = side == 3 and j - i < FAR
        for q in range(0, count, WIDTH):
            m = min(WIDTH, count - q)
            where = at if each is None else at + q
            f = run_forces(x, v, i + q, j + q, m, where, constants, each, damped)
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
def add_lists(block: int, x: Any, v: Any, force: Any, start: Any, ends: Any, constants: Any, damped: Any) -> None:
    """Add a block's listed springs to its forces (3, w)."""
    for p in range(start[block], start[block + 1], WIDTH):
        dx = gather(x, 0, ends, 1, p) - gather(x, 0, ends, 0, p)
        dy = gather(x, 1, ends, 1, p) - gather(x, 1, ends, 0, p)
        dz = gather(x, 2, ends, 1, p) - gather(x, 2, ends, 0, p)
        k = load(constants, 0, p)
        rest = load(constants, 1, p)
        if damped is None:
            w = pull(dx, dy, dz, k, rest)
        else:
            approach = (
                (gather(v, 0, ends, 1, p) - gather(v, 0, ends, 0, p)) * dx
                + (gather(v, 1, ends, 1, p) - gather(v, 1, ends, 0, p)) * dy
                + (gather(v, 2, ends, 1, p) - gather(v, 2, ends, 0, p)) * dz
            )
            w = damped_pull(dx, dy, dz, approach, k, rest, load(constants, 2, p))
        fx, fy, fz = w * dx, w * dy, w * dz
        add_at(force, 0, ends, 2, p, fx)
        add_at(force, 1, ends, 2, p, fy)
        add_at(force, 2, ends, 2, p, fz)
        add_at(force, 0, ends, 3, p, 0.0 - fx)
        add_at(force, 1, ends, 3, p, 0.0 - fy)
        add_at(force, 2, ends, 3, p, 0.0 - fz)


def pack_springs(springs: Springs | None, vertices: int) -> tuple[SpringRuns | None, SpringLists | None]:
    """Kernel layout of a fabric's springs; either part is None where it would be empty.

    Long runs with constants per run are taken as they are. All other springs are written out and
    sorted by the distance of their ends, then by vertex, which finds the runs of any net.
    """
    if springs is None or springs.number == 0:
        return None, None
    blocks = block_count(vertices)
    per_run = springs.k.shape == springs.rest.shape == springs.c.shape == springs.count.shape
    direct = per_run & choose_runs(springs.count, springs.stride)
    first = np.sort(springs.first[direct], axis=1).astype(np.int64)
    runs = np.column_stack([first, springs.count[direct], np.arange(first.shape[0])])
    named = (springs.k, springs.rest, springs.c)
    constants = np.stack([values[direct] for values in named]) if per_run else np.empty((3, 0))
    if direct.all():
        return _pack_runs(runs, constants, False, blocks), None
    # Constants per spring are most of a net's memory: from here on they are copied once.
    pairs, order = _sort_pairs(springs, direct)
    each = np.empty((3, order.shape[0]))
    for row, values in zip(each, named, strict=True):
        np.take(springs.per_spring(values), order, out=row)
    del order
    return _pack_pairs(pairs, each, runs, constants, vertices)


def _sort_pairs(springs: Springs, direct: Bool) -> tuple[Int, Long]:
    """Springs outside of the runs marked (m,), by distance of their ends, then by vertex: (s, 2) and
    where each stands among all springs.
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
) -> tuple[SpringRuns | None, SpringLists | None]:
    """Find the runs in sorted pairs (s, 2) with constants (3, s); join them to the `runs` there are.

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
    lists = _pack_lists(pairs[listed].astype(np.int64), each[:, listed], vertices) if listed.size else None
    runs = np.concatenate([runs, found])
    if runs.shape[0] == 0:
        return None, lists
    joined = np.concatenate([constants, each], axis=1) if constants.shape[1] else each
    return _pack_runs(runs, joined, varied, block_count(vertices)), lists


def _long_share(follows: Bool) -> float:
    """Share of springs that lie in runs of at least SHORTEST."""
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
    return SpringRuns(start, task, np.ascontiguousarray(constants), each or None, damped)


def _pack_lists(pairs: Long, constants: Float, vertices: int) -> SpringLists:
    """Lists per block of (s, 2) springs in the order of their vertices."""
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    ends, constants = pairs[order].T, constants[:, order]
    element, bounds = owned_copies(ends, block_count(vertices))
    element, start = pad_lists(element, bounds, WIDTH)
    filled = element >= 0
    ends = np.where(filled, ends[:, element], 0)
    target = local_targets(np.where(filled, ends, -1), start, vertices)
    constants = np.where(filled, constants[:, element], 0.0)
    damped = True if constants[2].any() else None
    table = np.concatenate([ends, target]).astype(np.int32)
    return SpringLists(start, np.ascontiguousarray(table), np.ascontiguousarray(constants), damped)
