"""Bending of a triangle mesh by a constant matrix: force_i = sum over j of w_ij (x_j - x_i).

The second derivatives of a surface that does not stretch are its curvatures times its normal, so that where they are
linear in the vertices the energy of bending is a quadratic form, the same along x, y and z (Bergou, Wardetzky, Harmon,
Zorin & Grinspun 2006, SGP, 227-230). Its matrix has rows that sum to 0, and is kept as the weights of pairs, of either
sign: springs of length 0, some of which push. Rigid motions, and strain that is the same everywhere, leave no force.

Each vertex gathers from those that it is coupled to, eight vertices beside each other: nothing is added in two places,
and a pair's two forces are each other's negative to the last bit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.forces.linear import LinearLists
from nuno_kernels.lanes import (
    WIDTH,
    Triple,
    dot,
    edge,
    gather_triple,
    load,
    minus,
    plus,
    read,
    read_triple,
    splat,
    times,
    write,
)
from nuno_kernels.step.blocks import BLOCK, Long
from nuno_kernels.terms import register
from nuno_schemas.fabric import Bending, Float, Int


class BendingRows(NamedTuple):
    """Rows of the matrix, eight side by side, padded by couplings of a vertex to itself.

    start    (groups + 1,) int64  places of the couplings of each eight vertices
    partner  (1, p) int32         vertices
    weight   (1, p) float64       [N/m]
    """

    start: Long
    partner: Int
    weight: Float


@kernel
def weighted_differences(rows: BendingRows, group: int, x: Float) -> Triple:
    """Return the sums of w (x_j - x_i) over the partners j of eight vertices i."""
    vertices = read_triple(x, 0, group * WIDTH, min(WIDTH, x.shape[1] - group * WIDTH))
    total = (splat(0.0), splat(0.0), splat(0.0))
    for p in range(rows.start[group], rows.start[group + 1], WIDTH):
        total = plus(total, times(load(rows.weight, 0, p), minus(gather_triple(x, rows.partner, 0, p), vertices)))
    return total


@kernel
def add_drawn(rows: BendingRows, block: int, origin: int, sign: float, x: Float, out: Float) -> None:
    """Add `sign` times these sums to a block's (3, w)."""
    end = min(origin + BLOCK, x.shape[1])
    for i in range(origin, end, WIDTH):
        m, at, found = min(WIDTH, end - i), i - origin, weighted_differences(rows, i // WIDTH, x)
        for row in range(3):
            write(out, row, at, m, read(out, row, at, m) + sign * found[row])


@kernel
def add_bending(rows: BendingRows, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add a block's forces to (3, w)."""
    add_drawn(rows, block, origin, 1.0, x, force)


@kernel
def measure_bending(rows: BendingRows, x: Float) -> float:
    """Return the energy [J]: the sum of w |x_j - x_i|^2 / 2 over pairs, each of which is listed from both ends."""
    energy = 0.0
    for group in range(rows.start.shape[0] - 1):
        for p in range(rows.start[group], rows.start[group + 1]):
            if rows.weight[0, p] != 0.0:
                d = edge(x, group * WIDTH + p % WIDTH, rows.partner[0, p])
                energy += 0.25 * rows.weight[0, p] * dot(d, d)
    return max(energy, 0.0)  # but for rounding it is not negative


def rows_of_bending(rows: BendingRows) -> LinearLists:
    """Return the pairs, each once, and their weights: the matrix is constant."""
    group = np.repeat(np.arange(len(rows.start) - 1), np.diff(rows.start))
    vertex = group * WIDTH + np.arange(len(group)) % WIDTH
    once = vertex < rows.partner[0]
    pairs = np.stack([vertex[once].astype(np.int32), rows.partner[0, once]])
    return LinearLists(rows.start, pairs, np.ascontiguousarray(rows.weight[:, once]))


def elements_of_bending(linear: LinearLists) -> tuple[Long, Long]:
    """Return columns (p,) and vertices (2, p) of the pairs."""
    return np.arange(linear.indices.shape[1]), linear.indices.astype(np.int64)


@kernel
def multiply_bending(rows: BendingRows, linear: LinearLists, block: int, origin: int, u: Float, out: Float) -> None:
    """Add the products of a block's rows with u (3, n) to `out` (3, w)."""
    add_drawn(rows, block, origin, -1.0, u, out)


@kernel
def sum_bending(rows: BendingRows, linear: LinearLists, block: int, origin: int, out: Float) -> None:
    """Add the diagonal blocks of a block's rows to (6, w)."""
    for group in range(origin // WIDTH, min((origin + BLOCK) // WIDTH, rows.start.shape[0] - 1)):
        for p in range(rows.start[group], rows.start[group + 1]):
            for row in range(3):
                out[row, group * WIDTH + p % WIDTH - origin] += rows.weight[0, p]


@kernel
def assemble_bending(linear: LinearLists, places: Any, diagonal: Float, values: Float) -> None:
    """Add the pairs to a matrix that is to be factorised: see nuno_kernels.forces.linear."""
    for p in range(places.column.shape[0]):
        w, at, width = linear.rows[0, places.column[p]], places.at[0, p], abs(places.width[0, p])
        for row in range(3):
            for end in range(2):
                diagonal[row, places.vertices[end, p]] += w
            if at >= 0:
                values[0, at + row * width + row] -= w


def pack_bending(bending: Bending | None, vertices: int) -> tuple[BendingRows, ...]:
    """Return the kernel layout of a fabric's bending; () without any."""
    if bending is None or bending.number == 0:
        return ()
    first, second = (np.concatenate([bending.pairs[:, k], bending.pairs[:, 1 - k]]) for k in (0, 1))
    order = np.lexsort((second, first)).astype(np.int32)
    first, second, weight = first[order], second[order], bending.weight[order % bending.number]
    groups = -(-vertices // WIDTH)
    count = np.bincount(first, minlength=groups * WIDTH)
    longest = count.reshape(groups, WIDTH).max(axis=1)
    start = np.concatenate([[0], np.cumsum(longest * WIDTH)]).astype(np.int64)
    place = np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
    at = start[first // WIDTH] + place * WIDTH + first % WIDTH
    own = np.repeat(np.arange(groups) * WIDTH, longest * WIDTH) + np.arange(start[-1]) % WIDTH
    partner = np.minimum(own, vertices - 1).astype(np.int32)
    partner[at], found = second, np.zeros(int(start[-1]))
    found[at] = weight
    return (BendingRows(start, partner[None], found[None]),)


register(
    BendingRows, "bending", block=add_bending, rows=rows_of_bending, elements=elements_of_bending,
    diagonal=sum_bending, multiply=multiply_bending, assemble=assemble_bending, energy=measure_bending,
)  # fmt: skip
