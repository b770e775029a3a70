"""Conjugate gradients on the matrix of an implicit step (nuno_integrators.implicit.matrix).

Preconditioned with the inverses of its diagonal 3 x 3 blocks. Sums are taken block by block and then in
the blocks' order, so that the result does not depend on the number of threads.

Weighed: SciPy's cg. It leaves the order of sums to BLAS, which depends on threads and processor, and wants a matrix
assembled where this one is a product of every force's own rows.
"""

from __future__ import annotations

import numpy as np

from nuno_integrators.explicit.updates import add
from nuno_integrators.implicit.matrix import Linear, invert
from nuno_kernels import block_kernel
from nuno_kernels.step.blocks import BLOCK, PADDING
from nuno_kernels.terms import each, over_blocks
from nuno_schemas.fabric import Float

multiply_forces = each("multiply", "block, origin, u, out", linear=True)


@block_kernel
def along(r: Float, d: Float) -> float:
    """Return r.d of (3, n) arrays."""
    total = 0.0
    for row in range(3):
        for p in range(r.shape[1]):
            total += r[row, p] * d[row, p]
    return total


@block_kernel
def multiply_block(block: int, a: Linear) -> None:
    """Compute q = A p on a block's vertices, 0 where pinned; its part of p.A p into sums."""
    own, u, out, inverse_mass = a.own, a.p, a.q, a.inverse_mass
    origin = block * BLOCK
    width = min(BLOCK, u.shape[1] - origin)
    local = np.zeros((3, width + PADDING))
    multiply_forces(a.forces, a.forces_on, block, origin, u, local)
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
    a.sums[block] = total


@block_kernel
def descend_block(
    block: int, step: float, inverse: Float, x: Float, r: Float, z: Float, p: Float, q: Float, sums: Float
) -> None:
    """Compute x += step p, r -= step q, z = A's inverse diagonal blocks times r; the block's part of r.z into sums."""
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
    sums[block] = total


multiply_blocks = over_blocks(multiply_block, "a")
descend_blocks = over_blocks(descend_block, "step, inverse, x, r, z, p, q, sums")


@block_kernel
def turn_and_multiply(turn: float, a: Linear, threads: int | None) -> float:
    """Set p = z + turn p and q = A p; returns p.q."""
    # Before a product, which reads its neighbours' p.
    add(a.p, a.z, turn, a.p, threads)
    multiply_blocks(a, a.sums.shape[0], threads)
    return float(a.sums.sum())


@block_kernel
def descend(
    step: float, inverse: Float, x: Float, r: Float, z: Float, p: Float, q: Float, sums: Float, threads: int | None
) -> float:
    """Compute x += step p, r -= step q, z = M r, with M the inverses of the diagonal blocks; return r.z.

    The matrix is no argument: each kind of one would have a version compiled.
    """
    descend_blocks(step, inverse, x, r, z, p, q, sums, sums.shape[0], threads)
    return float(sums.sum())


@block_kernel
def iterate(tolerance: float, most: int, a: Linear, threads: int | None) -> int:
    """Iterate conjugate gradients from x = 0; see `solve`."""
    a.x[:] = 0.0
    a.p[:] = 0.0
    a.q[:] = 0.0
    rz = descend(0.0, a.inverse, a.x, a.r, a.z, a.p, a.q, a.sums, threads)
    target = tolerance * tolerance * rz
    turn = 0.0
    for iteration in range(most):
        if not rz > target:
            return iteration
        curvature = turn_and_multiply(turn, a, threads)
        if not curvature > 0.0:
            return -1 - iteration
        before = rz
        rz = descend(rz / curvature, a.inverse, a.x, a.r, a.z, a.p, a.q, a.sums, threads)
        turn = rz / before
    return most


@block_kernel
def find_way(inverse_mass: Float, own: Float, r: Float, total: Float, way: Float) -> bool:
    """Write the sum of the residual r (3, n) into total (3,), and the common displacement that cancels it into way
    (3,); return False if a vertex is pinned, or there is none.
    """
    part, inverse = np.zeros((6, 1)), np.zeros((6, 1))
    for v in range(r.shape[1]):
        if inverse_mass[v] == 0.0:
            return False
        for row in range(6):
            part[row, 0] += own[row, v]
        for row in range(3):
            total[row] += r[row, v]
    if r.shape[1] == 0:
        return False
    invert(part, inverse, 0, np.zeros((6, 1)), 0)
    way[0] = inverse[0, 0] * total[0] + inverse[3, 0] * total[1] + inverse[4, 0] * total[2]
    way[1] = inverse[3, 0] * total[0] + inverse[1, 0] * total[1] + inverse[5, 0] * total[2]
    way[2] = inverse[4, 0] * total[0] + inverse[5, 0] * total[1] + inverse[2, 0] * total[2]
    return True


@block_kernel
def spread(way: Float, z: Float) -> None:
    """Set every column of z (3, n) to way (3,)."""
    for row in range(3):
        for v in range(z.shape[1]):
            z[row, v] = way[row]


@block_kernel
def move_along(way: Float, share: float, x: Float) -> None:
    """Add a share of way (3,) to every column of x (3, n)."""
    for row in range(3):
        for v in range(x.shape[1]):
            x[row, v] += share * way[row]


@block_kernel
def keep_momentum(a: Linear, threads: int | None) -> None:
    """Move all of a.x by the displacement that cancels the residual's sum, if no vertex is pinned.

    Conjugate gradients leave a residual of any sum: a force from nowhere. Forces between vertices do not resist a
    translation, so that A's part along one is the sum of D, and 3 equations give the one that leaves no sum. Where
    cloth meets a body A is stiffer: the step along their solution goes as far as the residual falls. Masses without
    forces between them keep their momentum each.
    """
    if len(a.forces) == 0:
        return
    total, way = np.zeros(3), np.empty(3)
    if not find_way(a.inverse_mass, a.own, a.r, total, way):
        return
    spread(way, a.z)
    curvature = turn_and_multiply(0.0, a, threads)
    if curvature > 0.0:
        move_along(way, (way[0] * total[0] + way[1] * total[1] + way[2] * total[2]) / curvature, a.x)


def solve(a: Linear, tolerance: float, most: int, threads: int | None) -> int:
    """Compute a.x = A^-1 a.r until sqrt(r.z) has fallen to `tolerance` of its start; return the iterations.

    Stops early, and says so by -1 - iterations, at a direction without positive curvature: the matrix is not positive,
    or rounding has eaten it. a.r holds what is left.
    """
    return int(iterate(tolerance, most, a, threads))


def multiply(a: Linear, u: Float, threads: int | None) -> Float:
    """Return A u (3, n), 0 where pinned."""
    a.p[...], a.z[...] = u, 0.0
    turn_and_multiply(1.0, a, threads)
    return a.q.copy()
