"""Leaves of a distance field beside larger ones: corners that lie on a larger leaf's face, and what that does."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange

from nuno_contact.fields.sample import blend, find_leaf
from nuno_kernels import kernel, parallel_kernel

BLOCK = 256


@kernel
def leaf_at(i: int, j: int, k: int, deepest: int, shape: Any, child: Any) -> tuple[int, int]:
    """(leaf, its level) of the cell i, j, k of the deepest level; -1 outside of the box."""
    if min(i, j, k) < 0 or i >> deepest >= shape[0] or j >> deepest >= shape[1] or k >> deepest >= shape[2]:
        return -1, 0
    at = child[((i >> deepest) * shape[1] + (j >> deepest)) * shape[2] + (k >> deepest)]
    level = 0
    while at >= 0:
        level += 1
        down = deepest - level
        at = child[at + 4 * (i >> down & 1) + 2 * (j >> down & 1) + (k >> down & 1)]
    return -1 - at, level


@kernel
def largest_round(x: int, y: int, z: int, own: int, deepest: int, shape: Any, child: Any) -> tuple[int, int]:
    """(leaf, its level) of the largest leaf whose face or edge the corner x, y, z of a leaf of level `own` lies on,
    without being its corner; -1 where there is none.
    """
    found, least = -1, own
    for turn in range(8):
        leaf, level = leaf_at(x - turn // 4, y - turn // 2 % 2, z - turn % 2, deepest, shape, child)
        if leaf >= 0 and level < least and (x | y | z) & ((1 << (deepest - level)) - 1):
            found, least = leaf, level
    return found, least


@kernel
def join_leaf(leaf: int, at: Any, own: int, deepest: int, shape: Any, child: Any, corners: Any) -> None:
    """Give a leaf's corners that lie on larger leaves those leaves' values."""
    for c in range(8):
        x = (at[leaf, 0] + c // 4) << (deepest - own)
        y = (at[leaf, 1] + c // 2 % 2) << (deepest - own)
        z = (at[leaf, 2] + c % 2) << (deepest - own)
        larger, level = largest_round(x, y, z, own, deepest, shape, child)
        if larger < 0:
            continue
        edge = 1 << (deepest - level)
        u, v, w = x / edge - at[larger, 0], y / edge - at[larger, 1], z / edge - at[larger, 2]
        for part in range(4):
            corners[leaf, 4 * c + part] = blend(corners, np.uint64(larger), np.uint64(part), u, v, w)


@parallel_kernel
def join_leaves(at: Any, level: Any, deepest: int, shape: Any, child: Any, corners: Any) -> None:
    """Join all leaves (l, 3) of levels (l,), from large to small: what a leaf takes is done by then."""
    for own in range(1, deepest + 1):
        for block in prange((at.shape[0] + BLOCK - 1) // BLOCK):
            for leaf in range(block * BLOCK, min((block + 1) * BLOCK, at.shape[0])):
                if level[leaf] == own:
                    join_leaf(leaf, at, own, deepest, shape, child, corners)


@kernel
def to_blame(
    leaf: Any, tests: Any, allowed: float, at: Any, level: Any, deepest: int, shape: Any, child: Any, corners: Any
) -> Any:
    """The leaf to cut where one is off: the larger one beside it whose error at one of its corners is more than
    `allowed`, or itself.
    """
    worst, which, own = allowed, leaf, level[leaf]
    for c in range(8):
        x = (at[leaf, 0] + c // 4) << (deepest - own)
        y = (at[leaf, 1] + c // 2 % 2) << (deepest - own)
        z = (at[leaf, 2] + c % 2) << (deepest - own)
        off = abs(corners[leaf, 4 * c] - tests[leaf, 18 * (c // 4) + 6 * (c // 2 % 2) + 2 * (c % 2)])
        if off > worst:
            worst, which = off, largest_round(x, y, z, own, deepest, shape, child)[0]
    return which


@kernel
def check_places(
    tests: Any, allowed: Any, x: Any, at_vertices: float, at: Any, level: Any, deepest: int, shape: Any, head: Any,
    child: Any, corners: Any, bad: Any,
) -> None:  # fmt: skip
    """bad (l,): leaves to cut because some are off by more than allowed (l,) from tests (l, 27) in their lattices,
    or by more than `at_vertices` from 0 at places x (n, 3).
    """
    for leaf in range(tests.shape[0]):
        off = 0.0
        for p in range(27):
            value = blend(corners, np.uint64(leaf), np.uint64(0), 0.5 * (p // 9), 0.5 * (p // 3 % 3), 0.5 * (p % 3))
            off = max(off, abs(value - tests[leaf, p]))
        if off > allowed[leaf]:
            bad[to_blame(leaf, tests, 0.667 * allowed[leaf], at, level, deepest, shape, child, corners)] = True
    for i in range(x.shape[0]):
        place, u, v, w, _ = find_leaf(x[i, 0], x[i, 1], x[i, 2], 0, head, child)
        if abs(blend(corners, place, np.uint64(0), u, v, w)) > at_vertices:
            bad[to_blame(np.int64(place), tests, 0.667 * at_vertices, at, level, deepest, shape, child, corners)] = True
