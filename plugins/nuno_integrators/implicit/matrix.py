"""The matrix of an implicit step, linearised at a state; it is never assembled here.

    A u = D u + sum over springs (alpha I + w w^T) (u_i - u_j) + sum over hinges g (g.u) + sum over pairs of a yarn,

D (6, n) holding each vertex's own symmetric 3 x 3 block: mass over the squared step, damping, contact. What links
of a yarn add that follow each other is in nuno_kernels.forces.yarns.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_kernels import block_kernel, kernel
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.step.acceleration import Packed
from nuno_kernels.step.blocks import BLOCK, PADDING, block_count
from nuno_kernels.terms import Terms, each, kernels_of, over_blocks
from nuno_schemas.fabric import Bool, Float

LOWEST = 1e300
"""less than any stiffness of a spring"""


fill_rows = each("fill", "block, x, before, rate, floor, follow", linear=True)
sum_diagonal = each("diagonal", "block, origin, out", linear=True)


@by_reference
class Linear(NamedTuple):
    """The matrix A and what solving with it needs.

    own, inverse  (6, n) xx, yy, zz, xy, xz, yz: D, and the inverse of A's diagonal blocks, 0 where pinned
    forces, forces_on   as in Packed, with the rows of each force's matrix (nuno_kernels.forces.linear), or None
    sums          (blocks,) scratch
    x, r, z, p, q (3, n) solution, residual, preconditioned residual, direction, A times direction
    """

    own: Float
    inverse: Float
    inverse_mass: Float
    forces: Terms
    forces_on: Bool
    sums: Float
    x: Float
    r: Float
    z: Float
    p: Float
    q: Float


def make_linear(packed: Packed) -> Linear:
    """Allocate the matrix of a packed system and the vectors to solve with it."""
    n = packed.inverse_mass.shape[0]
    makers = [kernels_of(term).find("rows") for term in packed.forces]
    rows = tuple(None if make is None else make(term) for make, term in zip(makers, packed.forces, strict=True))
    on = np.array([part is not None for part in rows], np.bool_)
    forces = Terms(packed.forces, ("fill", "diagonal", "multiply"), rows=rows)
    own, inverse = np.zeros((2, 6, n))
    sums = np.zeros(block_count(n))
    vectors = (np.zeros((3, n)) for _ in "xrzpq")
    return Linear(own, inverse, packed.inverse_mass.copy(), forces, on, sums, *vectors)


@kernel
def invert(own: Float, inverse: Float, v: int, diagonal: Float, at: int) -> None:
    """Compute the inverse of vertex v's diagonal block, by cofactors."""
    xx, yy, zz = own[0, v] + diagonal[0, at], own[1, v] + diagonal[1, at], own[2, v] + diagonal[2, at]
    xy, xz, yz = own[3, v] + diagonal[3, at], own[4, v] + diagonal[4, at], own[5, v] + diagonal[5, at]
    c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    scale = 1.0 / (xx * c0 + xy * c1 + xz * c2)
    inverse[0, v], inverse[3, v], inverse[4, v] = scale * c0, scale * c1, scale * c2
    inverse[1, v], inverse[5, v] = scale * (xx * zz - xz * xz), scale * (xy * xz - xx * yz)
    inverse[2, v] = scale * (xx * yy - xy * xy)


class Tangent(NamedTuple):
    """Parameters of the linearisation: dv/dx = `rate` [1/s], the least stiffness of a spring across its direction, and
    whether tensions follow the last Newton step (1) or are those before it (0).
    """

    rate: float
    floor: float
    follow: float


@block_kernel
def fill_block(block: int, x: Float, before: Float, tangent: Tangent, a: Linear) -> None:
    """Linearise a block's forces at x (3, n) and invert its diagonal blocks."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    diagonal = np.zeros((6, high - low + PADDING))
    fill_rows(a.forces, a.forces_on, block, x, before, tangent.rate, tangent.floor, tangent.follow)
    sum_diagonal(a.forces, a.forces_on, block, low, diagonal)
    for v in range(low, high):
        if a.inverse_mass[v] > 0.0:
            invert(a.own, a.inverse, v, diagonal, v - low)


fill_each = over_blocks(fill_block, "x, before, tangent, a")


@block_kernel
def fill_blocks(x: Float, before: Float, tangent: Tangent, a: Linear, threads: int | None) -> None:
    """Call `fill_block` for all blocks, on one thread or several."""
    fill_each(x, before, tangent, a, a.sums.shape[0], threads)


def fill(
    x: Float, rate: float, p: Packed, a: Linear, exact: bool = False, before: Float | None = None, follow: bool = True
) -> None:
    """Linearise at x (3, n), with dv/dx = `rate` [1/s]; a.own holds D already.

    The matrix is positive unless it is `exact`; its preconditioner is in either case. Springs have the tension that a
    linear step from `before` (3, n) to x predicts, or that at `before` if not `follow`.
    """
    tangent = Tangent(rate, -LOWEST if exact else 0.0, float(follow))
    fill_blocks(x, x if before is None else before, tangent, a, p.threads)
