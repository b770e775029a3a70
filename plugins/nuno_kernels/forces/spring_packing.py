"""Springs in the layout of their kernels: runs of consecutive vertices, and lists of the rest."""

from __future__ import annotations

import numpy as np

from nuno_kernels.forces.springs import LONGEST, SpringLists, SpringRuns
from nuno_kernels.step.blocks import (
    SHORTEST,
    Long,
    assign_runs,
    block_count,
    choose_runs,
    cut_runs,
    is_small,
    list_copies,
)
from nuno_schemas.fabric import Bool, Float, Int, Springs


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
