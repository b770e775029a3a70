"""Conjugate gradients on the matrix of an implicit step (nuno_kernels.matrix).

Preconditioned with the inverses of its diagonal 3 x 3 blocks. Sums are taken block by block and then in
the blocks' order, so that the result does not depend on the number of threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange

from nuno_kernels import kernel, parallel_kernel
from nuno_kernels.blocks import BLOCK, PADDING
from nuno_kernels.linear import (
    multiply_hinge_lists,
    multiply_hinge_runs,
    multiply_spring_lists,
    multiply_spring_runs,
)
from nuno_kernels.linear_yarns import multiply_yarns
from nuno_kernels.matrix import Linear
from nuno_schemas.fabric import Float


@kernel
def multiply_block(
    block: int, inverse_mass: Any, own: Any, u: Any, out: Any,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any, yarns: Any,
) -> float:  # fmt: skip
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
    if yarns is not None:
        multiply_yarns(block, u, local, yarns)
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
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any, yarns: Any,
) -> None:  # fmt: skip
    """p = z + turn p, then q = A p, on several threads: a product reads its neighbours' p."""
    for block in prange(sums.shape[0]):
        turn_block(block, z, p, turn)
    for block in prange(sums.shape[0]):
        sums[block] = multiply_block(block, inverse_mass, own, p, q, runs, lists, hinge_runs, hinge_lists, yarns)


@parallel_kernel
def descend_parallel(sums: Any, inverse: Any, x: Any, r: Any, z: Any, p: Any, q: Any, step: float) -> None:
    """All blocks on several threads."""
    for block in prange(sums.shape[0]):
        sums[block] = descend_block(block, inverse, x, r, z, p, q, step)


@kernel
def turn_and_multiply(
    sums: Any, turn: float, z: Any, p: Any, q: Any, inverse_mass: Any, own: Any,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any, yarns: Any, threads: Any,
) -> float:  # fmt: skip
    """p = z + turn p and q = A p; p.q."""
    if threads is None:
        for block in range(sums.shape[0]):
            turn_block(block, z, p, turn)
        for block in range(sums.shape[0]):
            sums[block] = multiply_block(block, inverse_mass, own, p, q, runs, lists, hinge_runs, hinge_lists, yarns)
    else:
        multiply_parallel(sums, turn, z, p, q, inverse_mass, own, runs, lists, hinge_runs, hinge_lists, yarns)
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
    inverse: Any, runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any, yarns: Any, threads: Any,
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
            sums, turn, z, p, q, inverse_mass, own, runs, lists, hinge_runs, hinge_lists, yarns, threads
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
        a.runs, a.lists, a.hinge_runs, a.hinge_lists, a.yarns, threads,
    )  # fmt: skip
    return int(count)


def multiply(a: Linear, u: Float, threads: int | None) -> Float:
    """A u (3, n), 0 where pinned."""
    a.p[...], a.z[...] = u, 0.0
    turn_and_multiply(
        a.sums,
        1.0,
        a.z,
        a.p,
        a.q,
        a.inverse_mass,
        a.own,
        a.runs,
        a.lists,
        a.hinge_runs,
        a.hinge_lists,
        a.yarns,
        threads,
    )
    return a.q.copy()
