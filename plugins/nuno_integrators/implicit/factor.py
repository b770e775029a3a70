"""Sparse Cholesky factorisation of an implicit step's matrix, A = U^T U, front by front.

A front's rows are kept in one piece, each beginning at column 0 though only the columns from its own on are
meaningful; on the diagonal stands the reciprocal of U's. The work is in `subtract`, on tiles that stay in
registers. Everything runs in one order on one thread, so that the result is the same for any number.

Weighed: SciPy's SuperLU, which takes several times as long for a sheet's matrix, since it factorises L and U, orders
anew every time and knows no 3 x 3 blocks; CHOLMOD, whose fronts are under the GPL. Neither promises the same bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_integrators.implicit.matrix import Linear
from nuno_integrators.implicit.plan import TILE, Elements, Fronts, Plan
from nuno_kernels import block_kernel, kernel
from nuno_kernels.lanes import WIDTH, fused, load, splat, store
from nuno_kernels.step.blocks import copy_rows
from nuno_kernels.terms import kernels_of
from nuno_schemas.fabric import Float

PANEL = 24
"""rows that are eliminated together: those before them are subtracted by tiles, these one by one"""


class Factor(NamedTuple):
    """A plan and the factor's entries.

    diagonal  (6, n) xx, yy, zz, xy, xz, yz: A's diagonal blocks
    values    (1, entries) the fronts' own rows: A's at first, then U's
    scratch   (1, .) what fronts leave to their parents
    local     (1, .) one front's part of a vector
    """

    plan: Plan
    diagonal: Float
    values: Float
    scratch: Float
    local: Float


def make_factor(plan: Plan, n: int) -> Factor:
    """Allocate a factor of a matrix of n vertices."""
    local = int(plan.fronts.width.max(initial=WIDTH))
    values, scratch = (np.zeros((1, size + WIDTH)) for size in (plan.entries, plan.scratch))
    return Factor(plan, np.zeros((6, n)), values, scratch, np.zeros((1, local)))


def compile_factor(a: Linear) -> None:
    """Compile what a factor of this matrix needs, by one without vertices."""
    none = np.zeros(0, np.int64)
    empty = Elements(none, *np.zeros((3, 1, 0), np.int64))
    elements = tuple(
        None if rows is None or kernels_of(term).find("assemble") is None else empty
        for term, rows in zip(a.forces, a.forces.rows, strict=True)
    )
    factor = make_factor(Plan(Fronts(*(none for _ in Fronts._fields)), 0, 0, elements), a.own.shape[1])
    factorise(factor, a)
    solve_factored(factor, a.r, a.x)


@block_kernel
def add_diagonal(fronts: Fronts, diagonal: Float, values: Float) -> None:
    """Write the diagonal blocks of the vertices that each front eliminates to their places."""
    for f in range(fronts.own.shape[0]):
        width = fronts.width[f]
        for q in range(fronts.own[f]):
            v, at = fronts.vertices[fronts.start[f] + q], fronts.panel[f] + 3 * q * (width + 1)
            values[0, at] += diagonal[0, v]
            values[0, at + 1] += diagonal[3, v]
            values[0, at + 2] += diagonal[4, v]
            values[0, at + width + 1] += diagonal[1, v]
            values[0, at + width + 2] += diagonal[5, v]
            values[0, at + 2 * width + 2] += diagonal[2, v]


class Rows(NamedTuple):
    """Rows of a matrix in a flat array: row k begins at values[0, at + k width]."""

    values: Float
    at: int
    width: int


@kernel
def subtract(rows: Rows, depth: int, low: int, high: int, end: int, to: Rows) -> None:
    """to[c - low, r - low] -= sum over k < depth of rows[k, c] rows[k, r] for low <= c < high and c <= r < end.

    Whole tiles are computed; entries left of the diagonal or beyond `end` have no meaning.
    """
    u, at, width = rows.values, rows.at, rows.width
    out, reach = to.values, to.width
    for r in range(low, end, 2 * WIDTH):
        for c in range(low, min(high, r + 2 * WIDTH), TILE):
            a0 = b0 = c0 = d0 = a1 = b1 = c1 = d1 = splat(0.0)
            for k in range(depth):
                row = at + k * width
                left, right = load(u, 0, row + r), load(u, 0, row + r + WIDTH)
                a, b = splat(u[0, row + c]), splat(u[0, row + c + 1])
                g, d = splat(u[0, row + c + 2]), splat(u[0, row + c + 3])
                a0, a1 = fused(a, left, a0), fused(a, right, a1)
                b0, b1 = fused(b, left, b0), fused(b, right, b1)
                c0, c1 = fused(g, left, c0), fused(g, right, c1)
                d0, d1 = fused(d, left, d0), fused(d, right, d1)
            place = to.at + (c - low) * reach + r - low
            store(out, 0, place, load(out, 0, place) - a0)
            store(out, 0, place + WIDTH, load(out, 0, place + WIDTH) - a1)
            place += reach
            store(out, 0, place, load(out, 0, place) - b0)
            store(out, 0, place + WIDTH, load(out, 0, place + WIDTH) - b1)
            place += reach
            store(out, 0, place, load(out, 0, place) - c0)
            store(out, 0, place + WIDTH, load(out, 0, place + WIDTH) - c1)
            place += reach
            store(out, 0, place, load(out, 0, place) - d0)
            store(out, 0, place + WIDTH, load(out, 0, place + WIDTH) - d1)


@block_kernel
def eliminate(u: Float, at: int, width: int, own: int, size: int) -> bool:
    """Turn a front's own rows of A into rows of U; return False at a pivot that is not positive."""
    for first in range(0, own, PANEL):
        last = min(first + PANEL, own)
        subtract(Rows(u, at, width), first, first, last, size, Rows(u, at + first * width + first, width))
        for k in range(first, last):
            row = at + k * width
            for r in range(k, size, WIDTH):
                value = load(u, 0, row + r)
                for j in range(first, k):
                    value = fused(splat(-u[0, at + j * width + k]), load(u, 0, at + j * width + r), value)
                store(u, 0, row + r, value)
            pivot = u[0, row + k]
            if not pivot > 0.0:
                return False
            scale = 1.0 / np.sqrt(pivot)
            for r in range(k, size, WIDTH):
                store(u, 0, row + r, splat(scale) * load(u, 0, row + r))
            u[0, row + k] = scale
    return True


@kernel
def pass_on(f: int, fronts: Fronts, values: Float, scratch: Float) -> None:
    """Add a front's remainder to its parent's."""
    above = fronts.parent[f]
    own, width, reach = fronts.own[above], fronts.width[above], fronts.reach[above]
    for a in range(fronts.size[f] - fronts.own[f]):
        i = fronts.place[fronts.start[f] + fronts.own[f] + a]
        for row in range(3):
            source = fronts.rest[f] + (3 * a + row) * fronts.reach[f]
            for b in range(a, fronts.size[f] - fronts.own[f]):
                j = fronts.place[fronts.start[f] + fronts.own[f] + b]
                for column in range(3):
                    value = scratch[0, source + 3 * b + column]
                    if i < own:
                        values[0, fronts.panel[above] + (3 * i + row) * width + 3 * j + column] += value
                    else:
                        scratch[0, fronts.rest[above] + (3 * (i - own) + row) * reach + 3 * (j - own) + column] += value


@kernel
def clear(f: int, fronts: Fronts, scratch: Float) -> None:
    """Zero a front's remainder."""
    rows = TILE * ((3 * (fronts.size[f] - fronts.own[f]) + TILE - 1) // TILE)
    scratch[0, fronts.rest[f] : fronts.rest[f] + rows * fronts.reach[f]] = 0.0


@block_kernel
def factorise_fronts(fronts: Fronts, values: Float, scratch: Float) -> bool:
    """Factorise all fronts, children before parents; return False at a pivot that is not positive."""
    for f in range(fronts.own.shape[0]):
        own, size, at, width = 3 * fronts.own[f], 3 * fronts.size[f], fronts.panel[f], fronts.width[f]
        if fronts.fresh[f] & 1:
            clear(f, fronts, scratch)
        if not eliminate(values, at, width, own, size):
            return False
        if size > own:
            left = Rows(scratch, fronts.rest[f], fronts.reach[f])
            subtract(Rows(values, at, width), own, own, size, size, left)
            if fronts.fresh[f] & 2:
                clear(fronts.parent[f], fronts, scratch)
            pass_on(f, fronts, values, scratch)
    return True


@block_kernel
def solve_fronts(fronts: Fronts, values: Float, local: Float, r: Float, x: Float) -> None:
    """Compute x (3, n) = A^-1 r: U^T y = r from the first front to the last, then U x = y back."""
    copy_rows(r, x)
    sums = np.empty((1, WIDTH))
    for f in range(fronts.own.shape[0]):
        own, size, width = 3 * fronts.own[f], 3 * fronts.size[f], fronts.width[f]
        collect(f, fronts, x, local)
        for k in range(own):
            row = fronts.panel[f] + k * width
            local[0, k] *= values[0, row + k]
            step = splat(-local[0, k])
            for c in range(k + 1, size, WIDTH):
                store(local, 0, c, fused(step, load(values, 0, row + c), load(local, 0, c)))
        distribute(f, fronts, local, x, fronts.size[f])
    for f in range(fronts.own.shape[0] - 1, -1, -1):
        own, size, width = 3 * fronts.own[f], 3 * fronts.size[f], fronts.width[f]
        collect(f, fronts, x, local)
        for k in range(own - 1, -1, -1):
            row = fronts.panel[f] + k * width
            total = splat(0.0)
            for c in range(k + 1, size, WIDTH):
                total = fused(load(values, 0, row + c), load(local, 0, c), total)
            store(sums, 0, 0, total)
            local[0, k] = (local[0, k] - sums[0].sum()) * values[0, row + k]
        distribute(f, fronts, local, x, fronts.own[f])


@kernel
def collect(f: int, fronts: Fronts, x: Float, local: Float) -> None:
    """Gather a front's part of x (3, n), and zeros after it."""
    for q in range(fronts.size[f]):
        for row in range(3):
            local[0, 3 * q + row] = x[row, fronts.vertices[fronts.start[f] + q]]
    local[0, 3 * fronts.size[f] : 3 * fronts.size[f] + WIDTH] = 0.0


@kernel
def distribute(f: int, fronts: Fronts, local: Float, x: Float, count: int) -> None:
    """Scatter the first `count` vertices of a front's part back into x (3, n)."""
    for q in range(count):
        for row in range(3):
            x[row, fronts.vertices[fronts.start[f] + q]] = local[0, 3 * q + row]


def factorise(factor: Factor, a: Linear) -> bool:
    """Factorise the matrix; return False if it is not positive, or rounding has made it so."""
    plan = factor.plan
    factor.values[...] = 0.0
    factor.diagonal[...] = a.own
    for term, rows, places in zip(a.forces, a.forces.rows, plan.elements, strict=True):
        if places is not None:
            kernels_of(term).find("assemble")(rows, places, factor.diagonal, factor.values)
    add_diagonal(plan.fronts, factor.diagonal, factor.values)
    return bool(factorise_fronts(plan.fronts, factor.values, factor.scratch))


def solve_factored(factor: Factor, r: Float, x: Float) -> None:
    """Compute x (3, n) = A^-1 r, 0 where pinned, with the factor of A."""
    solve_fronts(factor.plan.fronts, factor.values, factor.local, r, x)
