"""Tension that passes along a yarn: T'_n = T_n + mu (T_(n-1) + T_(n+1)), T_n = k_n (|d_n| - L_n) + c_n d|d_n|/dt.

T_n itself is the spring's and stands in nuno_kernels.forces.springs; here is the rest, pair by pair of links that
follow each other. Of points i, j, l on a yarn, with a = x_j - x_i and b = x_l - x_j, the pair adds

    F_a = mu T_b a^ on i and -F_a on j,    F_b = mu T_a b^ on j and -F_b on l,

so that every link gets both its neighbours' tension, momentum is kept exactly, and, each force lying along its own
link, angular momentum too. With one k on both links the pair's energy is mu k e_a e_b, e the elongation. A yarn's
energy sum(k e_n^2 / 2 + mu k e_n e_(n+1)) has a matrix k (1 + mu A) with A the path's, whose eigenvalues fill
(-2, 2): positive definite for any length of yarn just for mu < 1/2. Where k changes along a yarn no energy exists.

A link of zero length has no direction and no tension: it neither gives nor takes. By pairs two roots are taken
where a link by link sum would take three, and no array of tensions has to be finished before the forces begin.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.forces.linear_layout import listed_elements
from nuno_kernels.forces.spring_packing import spring_constants
from nuno_kernels.forces.springs import listed_difference, listed_lock, tensions
from nuno_kernels.lanes.choose import where_not_zero
from nuno_kernels.lanes.simd import WIDTH, add_at, load, root
from nuno_kernels.lanes.triples import dot
from nuno_kernels.step.blocks import BLOCK, Long, is_small, list_copies
from nuno_kernels.terms import register
from nuno_schemas.fabric import Float, Int, Springs, Yarns


class YarnLists(NamedTuple):
    """Pairs of links that follow each other, padded to whole vectors by pairs at one vertex.

    start     (blocks + 1,) int64  places of each block's pairs
    corners   (6, p) int32         vertices i, j, l, then their columns in the block's forces
    constants (6, p) float64       mu k [N/m], rest [m], mu c [N s/m] of link i-j, then of link j-l; where any locks,
                                   (10, p) with what mu k grows by and the length from which it does, of either
    damped    True where any mu c is not 0 or the links are few, else None
    locks     True where any locks, else None
    """

    start: Long
    corners: Int
    constants: Float
    damped: bool | None
    locks: bool | None


@kernel
def add_yarns(yarns: YarnLists, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add the tension that passes along a block's yarns to its forces (3, w)."""
    corners, constants = yarns.corners, yarns.constants
    for p in range(yarns.start[block], yarns.start[block + 1], WIDTH):
        a, b = listed_difference(x, corners, 0, p), listed_difference(x, corners, 1, p)
        square_a, square_b = dot(a, a), dot(b, b)
        long_a, long_b = root(square_a), root(square_b)
        lock_a = listed_lock(p, constants, 6, yarns.locks)
        lock_b = listed_lock(p, constants, 8, yarns.locks)
        pull_a = tensions(long_a, load(constants, 0, p), load(constants, 1, p), lock_a, yarns.locks)
        pull_b = tensions(long_b, load(constants, 3, p), load(constants, 4, p), lock_b, yarns.locks)
        if yarns.damped is not None:
            pull_a = pull_a + load(constants, 2, p) * (dot(listed_difference(v, corners, 0, p), a) / long_a)
            pull_b = pull_b + load(constants, 5, p) * (dot(listed_difference(v, corners, 1, p), b) / long_b)
        along_a = where_not_zero(square_a, where_not_zero(square_b, pull_b) / long_a)
        along_b = where_not_zero(square_b, where_not_zero(square_a, pull_a) / long_b)
        for row in range(3):
            on_a, on_b = along_a * a[row], along_b * b[row]
            add_at(force, row, corners, 3, p, on_a)
            add_at(force, row, corners, 4, p, on_b - on_a)
            add_at(force, row, corners, 5, p, 0.0 - on_b)


@kernel
def measure_yarns(yarns: YarnLists, x: Float) -> float:
    """Return the sum of mu k e_a e_b over all pairs [J], each counted where its first vertex is at home.

    Where k changes along a yarn, or one of two links has locked, there is no energy, and this takes the mean of mu T_a
    e_b and mu T_b e_a.
    """
    total, corners, constants = 0.0, yarns.corners, yarns.constants
    for block in range(yarns.start.shape[0] - 1):
        width = min(BLOCK, x.shape[1] - block * BLOCK)
        for p in range(yarns.start[block], yarns.start[block + 1]):
            if corners[3, p] < width:
                a = elongation(x, corners[0, p], corners[1, p], constants[1, p])
                b = elongation(x, corners[1, p], corners[2, p], constants[4, p])
                pull_a, pull_b = constants[0, p] * a, constants[3, p] * b
                if yarns.locks is not None:
                    pull_a += constants[6, p] * max(a + constants[1, p] - constants[7, p], 0.0)
                    pull_b += constants[8, p] * max(b + constants[4, p] - constants[9, p], 0.0)
                total += 0.5 * (pull_a * b + pull_b * a)
    return total


@kernel
def elongation(x: Float, i: int, j: int, rest: float) -> float:
    """Return |d| - L, 0 if |d| is 0: such a link takes no part."""
    dx, dy, dz = x[0, j] - x[0, i], x[1, j] - x[1, i], x[2, j] - x[2, i]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    return length - rest if length > 0.0 else 0.0


def _pull_by_velocity(yarns: YarnLists) -> bool:
    return yarns.damped is not None and bool(yarns.constants[[2, 5]].any())


register(
    YarnLists,
    name="yarns",
    lags=False,
    block=add_yarns,
    reads_velocity=_pull_by_velocity,
    energy=measure_yarns,
    turning="nuno_kernels.forces.linear_yarns:turning_of_yarns",
    rows="nuno_kernels.forces.linear_yarns:linear_yarns",
    elements=listed_elements(3),
    fill="nuno_kernels.forces.linear_yarns:fill_yarns",
    diagonal="nuno_kernels.forces.linear_yarns:sum_yarns",
    multiply="nuno_kernels.forces.linear_yarns:multiply_yarns",
    assemble="nuno_kernels.forces.linear_yarns:assemble_yarns",
)


def pair_corners(pairs: Int, neighbours: Int) -> Int:
    """Return vertices i, j, l (3, p) of neighbouring links (p, 2), which are springs of vertices (s, 2)."""
    first, second = pairs[neighbours[:, 0]], pairs[neighbours[:, 1]]
    # The shared vertex is the first link's end that the second has too.
    ends = (first[:, 1] == second[:, 0]) | (first[:, 1] == second[:, 1])
    middle = np.where(ends, first[:, 1], first[:, 0])
    last = np.where(second[:, 0] == middle, second[:, 1], second[:, 0])
    return np.stack([first.sum(axis=1) - middle, middle, last]).astype(np.int32)


def pack_yarns(yarns: Yarns, springs: Springs, vertices: int) -> YarnLists | None:
    """Return the kernel layout of a fabric's yarns; None if no tension passes (mu = 0, or single links)."""
    neighbours, yarn = yarns.neighbours()
    passing = yarns.mu[yarn] > 0.0
    if not passing.any():
        return None
    neighbours, yarn = neighbours[passing], yarn[passing]
    corners = pair_corners(springs.pairs(), neighbours)
    order = np.lexsort((corners.max(axis=0), corners.min(axis=0)))
    corners = corners[:, order]
    element, start, table = list_copies(corners, vertices)
    filled = element >= 0
    del corners
    # Constants are most of a knit's memory: each row is written once, in its place.
    named = spring_constants(springs)
    constants = np.zeros((2 * len(named), element.shape[0]))
    pair, mu = order[element[filled]], yarns.mu[yarn]
    for row, values in enumerate(named):
        for link in (0, 1):
            own = springs.per_spring(values)[neighbours[pair, link]]
            # Of k, rest, c and the lock's rows, lengths are not shared.
            at = 3 * link + row if row < 3 else 3 + 2 * link + row
            constants[at, filled] = own if row in (1, 4) else mu[pair] * own
    damped = True if is_small(springs.number) or constants[[2, 5]].any() else None
    return YarnLists(start, table, constants, damped, True if len(named) > 3 else None)
