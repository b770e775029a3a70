"""Tension that passes along yarns: its force, and its part of an implicit step's matrix."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.forces.linear import LinearLists, linear_lists, listed_elements, slope_at
from nuno_kernels.forces.springs import listed_difference, listed_lock, spring_constants, tensions
from nuno_kernels.lanes import (
    WIDTH,
    Lanes,
    Triple,
    add_at,
    dot,
    edge,
    higher,
    load,
    load_triple,
    root,
    splat,
    store,
    where_not_zero,
)
from nuno_kernels.step.blocks import BLOCK, Long, is_small, list_copies
from nuno_kernels.terms import register
from nuno_schemas.fabric import Float, Int, Springs, Yarns

# Tension that passes along a yarn: T'_n = T_n + mu (T_(n-1) + T_(n+1)), T_n = k_n (|d_n| - L_n) + c_n d|d_n|/dt.
#
# T_n itself is the spring's and stands in nuno_kernels.forces.springs; here is the rest, pair by pair of links that
# follow each other. Of points i, j, l on a yarn, with a = x_j - x_i and b = x_l - x_j, the pair adds
#
#     F_a = mu T_b a^ on i and -F_a on j,    F_b = mu T_a b^ on j and -F_b on l,
#
# so that every link gets both its neighbours' tension, momentum is kept exactly, and, each force lying along its own
# link, angular momentum too. With one k on both links the pair's energy is mu k e_a e_b, e the elongation. A yarn's
# energy sum(k e_n^2 / 2 + mu k e_n e_(n+1)) has a matrix k (1 + mu A) with A the path's, whose eigenvalues fill
# (-2, 2): positive definite for any length of yarn just for mu < 1/2. Where k changes along a yarn no energy exists.
#
# A link of zero length has no direction and no tension: it neither gives nor takes. By pairs two roots are taken
# where a link by link sum would take three, and no array of tensions has to be finished before the forces begin.


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
    d = edge(x, i, j)
    length = math.sqrt(dot(d, d))
    return length - rest if length > 0.0 else 0.0


def _pull_by_velocity(yarns: YarnLists) -> bool:
    return yarns.damped is not None and bool(yarns.constants[[2, 5]].any())


register(
    YarnLists, "yarns", lags=False, reads_velocity=_pull_by_velocity, block=add_yarns, rows="yarns:linear_yarns",
    elements=listed_elements(3), fill="yarns:fill_yarns", diagonal="yarns:sum_yarns", multiply="yarns:multiply_yarns",
    assemble="yarns:assemble_yarns", turning="yarns:turning_of_yarns", energy=measure_yarns,
)  # fmt: skip


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


# Tension passing along yarns, linearised at a state: the part of an implicit step's matrix that couples three
# vertices.
#
# Of links a (i to j) and b (j to l) that follow each other, with unit vectors a^, b^ and y the vertices' displacements,
# let s_a = a^.(y_j - y_i) and s_b = b^.(y_l - y_j) be the links' elongations. The pair's force
# is mu T_b along a and mu T_a along b, and its derivative
#
#     on i  -f_a,  on j  f_a - f_b,  on l  f_b,    f_a = m_a s_b a^ + alpha_a (I - a^ a^T)(y_j - y_i),
#                                                  f_b = m_b s_a b^ + alpha_b (I - b^ b^T)(y_l - y_j)
#
# with alpha_a = mu T_b / |a|, what the tension taken over adds across the link, and m_a = mu k_b, m_b = mu k_a along
# them. Where the pair has one k both are equal and the matrix is symmetric: a yarn's own springs and its pairs are
# along it G^T k (1 + mu A) G, G taking displacements to elongations and A the path's matrix, whose eigenvalues lie in
# (-2, 2). That is positive for mu < 1/2. Across links, negative alpha are left out as those of springs are, each by
# itself: under tension throughout, nothing is left out.
#
# Where k changes along a yarn, or a link has locked and its neighbour has not, no energy exists and the derivative (1 +
# mu A) K, K the diagonal of all k, is not symmetric. Here m is then mu sqrt(k_a k_b), so that yarns have K^(1/2) (1 +
# mu A) K^(1/2): symmetric, positive for the same mu, and of the same eigenvalues. Newton's method converges linearly
# with it; measured in the norm of K, the step from s = sqrt(k_a / k_b) leaves mu (s - 1) / sqrt(s) of the error, 0.026
# at k's ratio of 1.3 and 0.3 at 20, both at mu = 0.2. The mean (k_a + k_b) / 2 would leave mu (s - 1 / s) / 2 and be
# indefinite where s is large. Damping acts along links like k, by c times the rate dv/dx of the method.

YARN_ROWS = 9
"""a^, b^, m, alpha_a and alpha_b of a pair"""


linear_yarns = linear_lists(YARN_ROWS, "corners")


@kernel
def link_rows(d: Triple, d0: Triple, follow: float) -> tuple[Lanes, Lanes]:
    """Return 1 / |d|, 0 at length 0, and the expected length of eight links (see
    nuno_kernels.forces.linear.spring_rows).
    """
    square, length0 = dot(d, d), root(dot(d0, d0))
    expected = length0 + follow * where_not_zero(length0, dot(d0, d) / length0 - length0)
    return where_not_zero(square, 1.0 / root(square)), expected


@kernel
def fill_yarns(
    yarns: YarnLists, linear: LinearLists, block: int, x: Float, before: Float, rate: float, floor: float, follow: float
) -> None:
    """Write the rows of a block's pairs at x (3, n), after a step from `before`; `floor` is the least alpha."""
    corners, constants, rows = yarns.corners, yarns.constants, linear.rows
    for p in range(yarns.start[block], yarns.start[block + 1], WIDTH):
        a, a0 = listed_difference(x, corners, 0, p), listed_difference(before, corners, 0, p)
        b, b0 = listed_difference(x, corners, 1, p), listed_difference(before, corners, 1, p)
        inverse_a, length_a = link_rows(a, a0, follow)
        inverse_b, length_b = link_rows(b, b0, follow)
        k_a, k_b = load(constants, 0, p), load(constants, 3, p)
        # A link of length 0 takes no part: each factor below has the inverse lengths of both.
        both = where_not_zero(inverse_a, where_not_zero(inverse_b, splat(1.0)))
        lock_a = listed_lock(p, constants, 6, yarns.locks)
        lock_b = listed_lock(p, constants, 8, yarns.locks)
        pull_a = tensions(length_a, k_a, load(constants, 1, p), lock_a, yarns.locks)
        pull_b = tensions(length_b, k_b, load(constants, 4, p), lock_b, yarns.locks)
        slope_a = slope_at(root(dot(a, a)), k_a, lock_a, yarns.locks) + rate * load(constants, 2, p)
        slope_b = slope_at(root(dot(b, b)), k_b, lock_b, yarns.locks) + rate * load(constants, 5, p)
        for row in range(3):
            store(rows, row, p, inverse_a * a[row])
            store(rows, 3 + row, p, inverse_b * b[row])
        store(rows, 6, p, both * root(slope_a * slope_b))
        store(rows, 7, p, higher(both * pull_b * inverse_a, splat(floor)))
        store(rows, 8, p, higher(both * pull_a * inverse_b, splat(floor)))


@kernel
def multiply_yarns(yarns: YarnLists, linear: LinearLists, block: int, origin: int, u: Float, out: Float) -> None:
    """Add the products of a block's pairs with u (3, n) to `out` (3, w)."""
    corners, rows = linear.indices, linear.rows
    for p in range(linear.start[block], linear.start[block + 1], WIDTH):
        a, b = load_triple(rows, 0, p), load_triple(rows, 3, p)
        m, across_a, across_b = load(rows, 6, p), load(rows, 7, p), load(rows, 8, p)
        to_a, to_b = listed_difference(u, corners, 0, p), listed_difference(u, corners, 1, p)
        s_a, s_b = dot(a, to_a), dot(b, to_b)
        along_a, along_b = m * s_b - across_a * s_a, m * s_a - across_b * s_b
        for row in range(3):
            f_a, f_b = across_a * to_a[row] + along_a * a[row], across_b * to_b[row] + along_b * b[row]
            add_at(out, row, corners, 3, p, 0.0 - f_a)
            add_at(out, row, corners, 4, p, f_a - f_b)
            add_at(out, row, corners, 5, p, f_b)


@kernel
def pair_block(rows: Float, c: int, first: int, second: int, block: Float) -> None:
    """Compute the 3 x 3 block of corners `first` and `second`, 0 to 2 for i, j, l, of the pair in column c."""
    # Corner's share of link a: -1 at i, 1 at j; of link b: -1 at j, 1 at l.
    a1, b1 = (-1.0, 1.0, 0.0)[first], (0.0, -1.0, 1.0)[first]
    a2, b2 = (-1.0, 1.0, 0.0)[second], (0.0, -1.0, 1.0)[second]
    m, across_a, across_b = rows[6, c], rows[7, c], rows[8, c]
    for row in range(3):
        for column in range(3):
            a, b = rows[row, c], rows[3 + row, c]
            one = 1.0 if row == column else 0.0
            value = across_a * a1 * a2 * (one - a * rows[column, c]) + across_b * b1 * b2 * (
                one - b * rows[3 + column, c]
            )
            block[row, column] = value + m * (a1 * b2 * a * rows[3 + column, c] + b1 * a2 * b * rows[column, c])


@kernel
def add_block(out: Float, at: int, block: Float) -> None:
    """Add a symmetric 3 x 3 block to column `at` of (6, w)."""
    for row in range(3):
        out[row, at] += block[row, row]
    out[3, at] += block[0, 1]
    out[4, at] += block[0, 2]
    out[5, at] += block[1, 2]


@kernel
def sum_yarns(yarns: YarnLists, linear: LinearLists, block: int, origin: int, out: Float) -> None:
    """Add the diagonal blocks of a block's pairs to (6, w).

    They subtract from a middle at most mu of what both links' springs have there.
    """
    part, rows = np.empty((3, 3)), linear.rows
    for c in range(linear.start[block], linear.start[block + 1]):
        for corner in range(3):
            pair_block(rows, c, corner, corner, part)
            add_block(out, linear.indices[3 + corner, c], part)


@kernel
def assemble_yarns(linear: LinearLists, places: Any, diagonal: Float, values: Float) -> None:
    """Add pairs to a matrix that is to be factorised: see nuno_kernels.forces.linear."""
    part, rows = np.empty((3, 3)), linear.rows
    for p in range(places.column.shape[0]):
        c, pair = places.column[p], 0
        for corner in range(3):
            pair_block(rows, c, corner, corner, part)
            add_block(diagonal, places.vertices[corner, p], part)
        for i in range(3):
            for j in range(i + 1, 3):
                at, width = places.at[pair, p], places.width[pair, p]
                first, second = (i, j) if width > 0 else (j, i)
                if at >= 0:
                    pair_block(rows, c, first, second, part)
                    for row in range(3):
                        for column in range(3):
                            values[0, at + row * abs(width) + column] += part[row, column]
                pair += 1


@kernel
def turning_of_yarns(yarns: YarnLists, x0: Float, x: Float, d: Float) -> float:
    """Return work along d (3, n) of the passed tension that links got by turning on their way from x0 to x [J]."""
    total, corners, constants = 0.0, yarns.corners, yarns.constants
    for block in range(yarns.start.shape[0] - 1):
        width = min(BLOCK, x.shape[1] - block * BLOCK)
        for p in range(yarns.start[block], yarns.start[block + 1]):
            if corners[3, p] < width:
                i, j, k = corners[0, p], corners[1, p], corners[2, p]
                length_a, expected_a, gone_a = turned(x0, x, d, i, j)
                length_b, expected_b, gone_b = turned(x0, x, d, j, k)
                pull_a = constants[0, p] * (length_a - expected_a)
                pull_b = constants[3, p] * (length_b - expected_b)
                if yarns.locks is not None:
                    locked_a, locked_b = constants[7, p], constants[9, p]
                    pull_a += constants[6, p] * (max(length_a - locked_a, 0.0) - max(expected_a - locked_a, 0.0))
                    pull_b += constants[8, p] * (max(length_b - locked_b, 0.0) - max(expected_b - locked_b, 0.0))
                total += pull_a * gone_b + pull_b * gone_a
    return total


@kernel
def turned(x0: Float, x: Float, d: Float, i: int, j: int) -> tuple[float, float, float]:
    """Return, for a link that turns from a to b: |b|, its length without turning, a.b / |a|, and b^.(d_j - d_i)."""
    before, now = edge(x0, i, j), edge(x, i, j)
    a, b = np.sqrt(dot(before, before)), np.sqrt(dot(now, now))
    if a == 0.0 or b == 0.0:
        return 0.0, 0.0, 0.0
    return b, dot(before, now) / a, dot(now, edge(d, i, j)) / b
