"""The linear system of an implicit step, and conjugate gradients on it.

    A u = D u + sum over springs (alpha I + w w^T) (u_i - u_j) + sum over hinges g (g.u),

D (6, n) holding each vertex's own symmetric 3 x 3 block: mass over the squared step, damping, contact.
Preconditioned with the inverses of A's diagonal 3 x 3 blocks. Sums are taken block by block and then in
the blocks' order, so that the result does not depend on the number of threads.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import prange

from nuno_kernels import kernel, parallel_kernel
from nuno_kernels.acceleration import Packed
from nuno_kernels.blocks import BLOCK, PADDING, block_count
from nuno_kernels.linear import (
    LinearLists,
    LinearRuns,
    fill_hinge_lists,
    fill_hinge_runs,
    fill_spring_lists,
    fill_spring_runs,
    linear_hinges,
    linear_springs,
    multiply_hinge_lists,
    multiply_hinge_runs,
    multiply_spring_lists,
    multiply_spring_runs,
)
from nuno_schemas.fabric import Float

LOWEST = 1e300
"""Below anything that a spring's stiffness can be."""


class Linear(NamedTuple):
    """The matrix A and what solving with it needs.

    own, inverse  (6, n) xx, yy, zz, xy, xz, yz: D, and the inverse of A's diagonal blocks, 0 where pinned
    sums          (blocks,) scratch
    x, r, z, p, q (3, n) solution, residual, preconditioned residual, direction, A times direction
    """

    own: Float
    inverse: Float
    inverse_mass: Float
    runs: LinearRuns | None
    lists: LinearLists | None
    hinge_runs: LinearRuns | None
    hinge_lists: LinearLists | None
    sums: Float
    x: Float
    r: Float
    z: Float
    p: Float
    q: Float


def make_linear(packed: Packed) -> Linear:
    """Room for the matrix of a packed system and for solving with it."""
    n = packed.inverse_mass.shape[0]
    runs, lists = linear_springs(packed.runs, packed.lists)
    hinge_runs, hinge_lists = linear_hinges(packed.hinge_runs, packed.hinge_lists)
    sums = np.zeros(block_count(n))
    own, inverse = np.zeros((2, 6, n))
    return Linear(
        own,
        inverse,
        packed.inverse_mass,
        runs,
        lists,
        hinge_runs,
        hinge_lists,
        sums,
        *(np.zeros((3, n)) for _ in "xrzpq"),
    )


@kernel
def fill_block(
    block: int, x: Any, rate: float, floor: float, inverse_mass: Any, own: Any, inverse: Any,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any,
    to_runs: Any, to_lists: Any, to_hinge_runs: Any, to_hinge_lists: Any,
) -> None:  # fmt: skip
    """Linearise a block's springs and hinges at x (3, n) and invert its diagonal blocks."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    diagonal = np.zeros((6, high - low + PADDING))
    if runs is not None:
        fill_spring_runs(block, x, runs, to_runs, rate, floor)
        sum_spring_runs(block, low, to_runs, diagonal)
    if lists is not None:
        fill_spring_lists(block, x, lists, to_lists, rate, floor)
        sum_spring_lists(block, to_lists, diagonal)
    if hinge_runs is not None:
        fill_hinge_runs(block, x, hinge_runs, to_hinge_runs)
        sum_hinge_runs(block, low, to_hinge_runs, diagonal)
    if hinge_lists is not None:
        fill_hinge_lists(block, x, hinge_lists, to_hinge_lists)
        sum_hinge_lists(block, to_hinge_lists, diagonal)
    for v in range(low, high):
        if inverse_mass[v] > 0.0:
            invert(own, inverse, v, diagonal, v - low)


@kernel
def add_outer(out: Any, at: int, across: float, x: float, y: float, z: float) -> None:
    """Add across I + (x, y, z) (x, y, z)^T to column `at` of (6, w), nothing negative of it."""
    across = max(across, 0.0)
    out[0, at] += across + x * x
    out[1, at] += across + y * y
    out[2, at] += across + z * z
    out[3, at] += x * y
    out[4, at] += x * z
    out[5, at] += y * z


@kernel
def sum_spring_runs(block: int, origin: int, linear: Any, out: Any) -> None:
    """Add the diagonal blocks of a block's runs to (6, w)."""
    task, rows = linear.task, linear.rows
    for t in range(linear.start[block], linear.start[block + 1]):
        for q in range(task[t, 2]):
            c = linear.column[t] + q
            if task[t, 4] & 1:
                add_outer(out, task[t, 0] + q - origin, rows[0, c], rows[1, c], rows[2, c], rows[3, c])
            if task[t, 4] & 2:
                add_outer(out, task[t, 1] + q - origin, rows[0, c], rows[1, c], rows[2, c], rows[3, c])


@kernel
def add_hinge(out: Any, corner: int, at: int, g: Any, c: int) -> None:
    """Add one corner's block of the hinge in column `c` of g (9, .) to column `at` of (6, w)."""
    if corner == 0:
        add_outer(out, at, 0.0, g[3, c] + g[6, c] - g[0, c], g[4, c] + g[7, c] - g[1, c], g[5, c] + g[8, c] - g[2, c])
    else:
        row = 3 * (corner - 1)
        add_outer(out, at, 0.0, g[row, c], g[row + 1, c], g[row + 2, c])


@kernel
def sum_hinge_runs(block: int, origin: int, linear: Any, out: Any) -> None:
    """Add the diagonal blocks of a block's hinge runs to (6, w)."""
    task = linear.task
    for t in range(linear.start[block], linear.start[block + 1]):
        for corner in range(4):
            if (task[t, 6] >> corner) & 1:
                for q in range(task[t, 4]):
                    add_hinge(out, corner, task[t, corner] + q - origin, linear.rows, linear.column[t] + q)


@kernel
def sum_spring_lists(block: int, linear: Any, out: Any) -> None:
    """Add the diagonal blocks of a block's listed springs to (6, w)."""
    rows = linear.rows
    for c in range(linear.start[block], linear.start[block + 1]):
        for end in range(2):
            add_outer(out, linear.indices[2 + end, c], rows[0, c], rows[1, c], rows[2, c], rows[3, c])


@kernel
def sum_hinge_lists(block: int, linear: Any, out: Any) -> None:
    """Add the diagonal blocks of a block's listed hinges to (6, w)."""
    for c in range(linear.start[block], linear.start[block + 1]):
        for corner in range(4):
            add_hinge(out, corner, linear.indices[4 + corner, c], linear.rows, c)


@kernel
def invert(own: Any, inverse: Any, v: int, diagonal: Any, at: int) -> None:
    """Inverse of vertex v's diagonal block, by cofactors."""
    xx, yy, zz = own[0, v] + diagonal[0, at], own[1, v] + diagonal[1, at], own[2, v] + diagonal[2, at]
    xy, xz, yz = own[3, v] + diagonal[3, at], own[4, v] + diagonal[4, at], own[5, v] + diagonal[5, at]
    c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    scale = 1.0 / (xx * c0 + xy * c1 + xz * c2)
    inverse[0, v], inverse[3, v], inverse[4, v] = scale * c0, scale * c1, scale * c2
    inverse[1, v], inverse[5, v] = scale * (xx * zz - xz * xz), scale * (xy * xz - xx * yz)
    inverse[2, v] = scale * (xx * yy - xy * xy)


@parallel_kernel
def fill_parallel(
    x: Any, rate: float, floor: float, inverse_mass: Any, own: Any, inverse: Any,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any,
    to_runs: Any, to_lists: Any, to_hinge_runs: Any, to_hinge_lists: Any,
) -> None:  # fmt: skip
    """All blocks on several threads."""
    for block in prange((x.shape[1] + BLOCK - 1) // BLOCK):
        fill_block(
            block, x, rate, floor, inverse_mass, own, inverse, runs, lists, hinge_runs, hinge_lists,
            to_runs, to_lists, to_hinge_runs, to_hinge_lists,
        )  # fmt: skip


@kernel
def fill_blocks(
    x: Any, rate: float, floor: float, inverse_mass: Any, own: Any, inverse: Any,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any,
    to_runs: Any, to_lists: Any, to_hinge_runs: Any, to_hinge_lists: Any,
) -> None:  # fmt: skip
    """All blocks on one thread."""
    for block in range((x.shape[1] + BLOCK - 1) // BLOCK):
        fill_block(
            block, x, rate, floor, inverse_mass, own, inverse, runs, lists, hinge_runs, hinge_lists,
            to_runs, to_lists, to_hinge_runs, to_hinge_lists,
        )  # fmt: skip


def fill(x: Float, rate: float, p: Packed, a: Linear, exact: bool = False) -> None:
    """Linearise at x (3, n), with dv/dx = `rate` [1/s]; a.own holds D already.

    The matrix is positive unless it is `exact`; its preconditioner is in either case.
    """
    floor = -LOWEST if exact else 0.0
    call = fill_blocks if p.threads is None else fill_parallel
    call(
        x, rate, floor, a.inverse_mass, a.own, a.inverse, p.runs, p.lists, p.hinge_runs, p.hinge_lists,
        a.runs, a.lists, a.hinge_runs, a.hinge_lists,
    )  # fmt: skip


@kernel
def multiply_block(
    block: int, inverse_mass: Any, own: Any, u: Any, out: Any, runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any
) -> float:
    """out = A u on a block's vertices, 0 where pinned; returns its part of u.A u."""
    origin = block * BLOCK
    width = min(BLOCK, u.shape[1] - origin)
    local = np.zeros((3, width + PADDING))
    if runs is not None:
        multiply_spring_runs(block, origin, u, local, runs)
    if lists is not None:
        multiply_spring_lists(block, u, local, lists)
    if hinge_runs is not None:
        multiply_hinge_runs(block, origin, u, local, hinge_runs)
    if hinge_lists is not None:
        multiply_hinge_lists(block, u, local, hinge_lists)
    total = 0.0
    for c in range(width):
        v = origin + c
        if inverse_mass[v] > 0.0:
            x, y, z = u[0, v], u[1, v], u[2, v]
            fx = local[0, c] + own[0, v] * x + own[3, v] * y + own[4, v] * z
            fy = local[1, c] + own[3, v] * x + own[1, v] * y + own[5, v] * z
            fz = local[2, c] + own[4, v] * x + own[5, v] * y + own[2, v] * z
            out[0, v], out[1, v], out[2, v] = fx, fy, fz
            total += x * fx + y * fy + z * fz
        else:
            out[0, v], out[1, v], out[2, v] = 0.0, 0.0, 0.0
    return total


@kernel
def descend_block(block: int, inverse: Any, x: Any, r: Any, z: Any, p: Any, q: Any, step: float) -> float:
    """x += step p, r -= step q, z = A's inverse diagonal blocks times r; returns the block's part of r.z."""
    total = 0.0
    for v in range(block * BLOCK, min((block + 1) * BLOCK, x.shape[1])):
        for row in range(3):
            x[row, v] += step * p[row, v]
            r[row, v] -= step * q[row, v]
        rx, ry, rz = r[0, v], r[1, v], r[2, v]
        zx = inverse[0, v] * rx + inverse[3, v] * ry + inverse[4, v] * rz
        zy = inverse[3, v] * rx + inverse[1, v] * ry + inverse[5, v] * rz
        zz = inverse[4, v] * rx + inverse[5, v] * ry + inverse[2, v] * rz
        z[0, v], z[1, v], z[2, v] = zx, zy, zz
        total += rx * zx + ry * zy + rz * zz
    return total


@kernel
def turn_block(block: int, z: Any, p: Any, turn: float) -> None:
    """p = z + turn p."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, p.shape[1])
    for row in range(3):
        for v in range(low, high):
            p[row, v] = z[row, v] + turn * p[row, v]


@parallel_kernel
def multiply_parallel(
    sums: Any, turn: float, z: Any, p: Any, q: Any, inverse_mass: Any, own: Any,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any,
) -> None:  # fmt: skip
    """p = z + turn p, then q = A p, on several threads: a product reads its neighbours' p."""
    for block in prange(sums.shape[0]):
        turn_block(block, z, p, turn)
    for block in prange(sums.shape[0]):
        sums[block] = multiply_block(block, inverse_mass, own, p, q, runs, lists, hinge_runs, hinge_lists)


@parallel_kernel
def descend_parallel(sums: Any, inverse: Any, x: Any, r: Any, z: Any, p: Any, q: Any, step: float) -> None:
    """All blocks on several threads."""
    for block in prange(sums.shape[0]):
        sums[block] = descend_block(block, inverse, x, r, z, p, q, step)


@kernel
def turn_and_multiply(
    sums: Any, turn: float, z: Any, p: Any, q: Any, inverse_mass: Any, own: Any,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any, threads: Any,
) -> float:  # fmt: skip
    """p = z + turn p and q = A p; p.q."""
    if threads is None:
        for block in range(sums.shape[0]):
            turn_block(block, z, p, turn)
        for block in range(sums.shape[0]):
            sums[block] = multiply_block(block, inverse_mass, own, p, q, runs, lists, hinge_runs, hinge_lists)
    else:
        multiply_parallel(sums, turn, z, p, q, inverse_mass, own, runs, lists, hinge_runs, hinge_lists)
    return float(sums.sum())


@kernel
def descend(sums: Any, inverse: Any, x: Any, r: Any, z: Any, p: Any, q: Any, step: float, threads: Any) -> float:
    """x += step p, r -= step q, z = M r; r.z."""
    if threads is None:
        for block in range(sums.shape[0]):
            sums[block] = descend_block(block, inverse, x, r, z, p, q, step)
    else:
        descend_parallel(sums, inverse, x, r, z, p, q, step)
    return float(sums.sum())


@kernel
def iterate(
    tolerance: float, most: int, sums: Any, x: Any, r: Any, z: Any, p: Any, q: Any, inverse_mass: Any, own: Any,
    inverse: Any, runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any, threads: Any,
) -> int:  # fmt: skip
    """Conjugate gradients from x = 0; see `solve`."""
    x[:] = 0.0
    p[:] = 0.0
    q[:] = 0.0
    rz = descend(sums, inverse, x, r, z, p, q, 0.0, threads)
    target = tolerance * tolerance * rz
    turn = 0.0
    for iteration in range(most):
        if not rz > target:
            return iteration
        curvature = turn_and_multiply(
            sums, turn, z, p, q, inverse_mass, own, runs, lists, hinge_runs, hinge_lists, threads
        )
        if not curvature > 0.0:
            return -1 - iteration
        before = rz
        rz = descend(sums, inverse, x, r, z, p, q, rz / curvature, threads)
        turn = rz / before
    return most


def solve(a: Linear, tolerance: float, most: int, threads: int | None) -> int:
    """a.x = A^-1 a.r until sqrt(r.z) has fallen to `tolerance` of its start; the iterations it took.

    Stops early, and says so by -1 - iterations, at a direction without positive curvature: the matrix is
    not positive, or rounding has eaten it. a.r holds what is left.
    """
    count = iterate(
        tolerance, most, a.sums, a.x, a.r, a.z, a.p, a.q, a.inverse_mass, a.own, a.inverse,
        a.runs, a.lists, a.hinge_runs, a.hinge_lists, threads,
    )  # fmt: skip
    return int(count)


def multiply(a: Linear, u: Float, threads: int | None) -> Float:
    """A u (3, n), 0 where pinned."""
    a.p[...], a.z[...] = u, 0.0
    turn_and_multiply(
        a.sums, 1.0, a.z, a.p, a.q, a.inverse_mass, a.own, a.runs, a.lists, a.hinge_runs, a.hinge_lists, threads
    )
    return a.q.copy()
