"""Leaves of a distance field beside larger ones: continuity across their common faces, and its error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from nuno_contact.fields.sample import Fields, blend, find_leaf
from nuno_kernels import kernel, parallel_kernel
from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Bool, Float, Int

BLOCK = 256


class Grid(NamedTuple):
    """The l leaves of one field among its cells."""

    at: Long
    """(l, 3) place of each, in units of its size"""
    level: Long
    """(l,) how often a whole cell was halved"""
    deepest: int
    """The greatest level."""
    shape: Int
    """(3,) whole cells along x, y, z"""
    child: Int
    corners: NDArray[np.float32]
    """`child` and `corners` are as in DistanceField."""


@kernel
def leaf_at(i: int, j: int, k: int, grid: Grid) -> tuple[int, int]:
    """Return (leaf, its level) of the cell i, j, k of the deepest level; -1 outside of the box."""
    shape, child, deepest = grid.shape, grid.child, grid.deepest
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
def corner_at(leaf: int | np.int64, c: int, grid: Grid) -> tuple[int, int, int]:
    """Return corner c of a leaf, in cells of the deepest level."""
    at, down = grid.at[leaf], grid.deepest - grid.level[leaf]
    return (at[0] + c // 4) << down, (at[1] + c // 2 % 2) << down, (at[2] + c % 2) << down


@kernel
def largest_round(corner: tuple[int, int, int], own: int, grid: Grid) -> tuple[int, int]:
    """Return (leaf, its level) of the largest leaf whose face or edge a corner of a leaf of level `level` lies on,
    without being its corner; -1 if there is none.
    """
    x, y, z = corner
    found, least = -1, own
    for turn in range(8):
        leaf, level = leaf_at(x - turn // 4, y - turn // 2 % 2, z - turn % 2, grid)
        if leaf >= 0 and level < least and (x | y | z) & ((1 << (grid.deepest - level)) - 1):
            found, least = leaf, level
    return found, least


@kernel
def join_leaf(leaf: int, grid: Grid) -> None:
    """Set a leaf's corners that lie on larger leaves to those leaves' values."""
    for c in range(8):
        corner = corner_at(leaf, c, grid)
        larger, level = largest_round(corner, grid.level[leaf], grid)
        if larger < 0:
            continue
        edge, at = 1 << (grid.deepest - level), grid.at[larger]
        u, v, w = corner[0] / edge - at[0], corner[1] / edge - at[1], corner[2] / edge - at[2]
        for part in range(4):
            grid.corners[leaf, 4 * c + part] = blend(grid.corners, np.uint64(larger), np.uint64(part), u, v, w)


@parallel_kernel
def join_leaves(grid: Grid) -> None:
    """Join all leaves, from large to small: a leaf's source is done before it."""
    for own in range(1, grid.deepest + 1):
        for block in prange((grid.at.shape[0] + BLOCK - 1) // BLOCK):
            for leaf in range(block * BLOCK, min((block + 1) * BLOCK, grid.at.shape[0])):
                if grid.level[leaf] == own:
                    join_leaf(leaf, grid)


@kernel
def to_blame(leaf: int | np.int64, tests: NDArray[np.float32], allowed: float, grid: Grid) -> int:
    """Return the leaf to cut if `leaf` is inaccurate: the largest neighbour at the corner with the largest error above
    `allowed`, or `leaf` itself if there is none.
    """
    worst, which = allowed, int(leaf)
    for c in range(8):
        off = abs(grid.corners[leaf, 4 * c] - tests[leaf, 18 * (c // 4) + 6 * (c // 2 % 2) + 2 * (c % 2)])
        if off > worst:
            worst, which = off, largest_round(corner_at(leaf, c, grid), grid.level[leaf], grid)[0]
    return which


@kernel
def check_places(
    tests: NDArray[np.float32], allowed: Float, x: Float, at_vertices: float, grid: Grid, field: Fields, bad: Bool
) -> None:
    """Mark in bad (l,) the leaves to cut because some are off by more than allowed (l,) from tests (l, 27) in their
    lattices, or by more than `at_vertices` from 0 at places x (n, 3).
    """
    corners = grid.corners
    for leaf in range(tests.shape[0]):
        off = 0.0
        for p in range(27):
            value = blend(corners, np.uint64(leaf), np.uint64(0), 0.5 * (p // 9), 0.5 * (p // 3 % 3), 0.5 * (p % 3))
            off = max(off, abs(value - tests[leaf, p]))
        if off > allowed[leaf]:
            bad[to_blame(leaf, tests, 0.667 * allowed[leaf], grid)] = True
    for i in range(x.shape[0]):
        place, u, v, w, _ = find_leaf(x[i, 0], x[i, 1], x[i, 2], 0, field)
        if abs(blend(corners, place, np.uint64(0), u, v, w)) > at_vertices:
            bad[to_blame(np.int64(place), tests, 0.667 * at_vertices, grid)] = True
