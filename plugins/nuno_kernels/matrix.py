"""The matrix of an implicit step, linearised at a state; it is never assembled here.

    A u = D u + sum over springs (alpha I + w w^T) (u_i - u_j) + sum over hinges g (g.u) + sum over pairs of a yarn,

D (6, n) holding each vertex's own symmetric 3 x 3 block: mass over the squared step, damping, contact. What links
of a yarn add that follow each other is in nuno_kernels.linear_yarns.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import prange

from nuno_kernels import kernel, parallel_kernel
from nuno_kernels.acceleration import Packed
from nuno_kernels.blocks import BLOCK, PADDING, block_count
from nuno_kernels.diagonal import invert, sum_hinge_lists, sum_hinge_runs, sum_spring_lists, sum_spring_runs
from nuno_kernels.linear import fill_hinge_lists, fill_hinge_runs, fill_spring_lists, fill_spring_runs
from nuno_kernels.linear_layout import LinearLists, LinearRuns, linear_hinges, linear_springs
from nuno_kernels.linear_yarns import fill_yarns, linear_yarns, sum_yarns
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
    yarns: LinearLists | None
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
        linear_yarns(packed.yarns),
        sums,
        *(np.zeros((3, n)) for _ in "xrzpq"),
    )


@kernel
def fill_block(
    block: int, x: Any, before: Any, rate: float, floor: float, follow: float,
    inverse_mass: Any, own: Any, inverse: Any,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any, yarns: Any,
    to_runs: Any, to_lists: Any, to_hinge_runs: Any, to_hinge_lists: Any, to_yarns: Any,
) -> None:  # fmt: skip
    """Linearise a block's springs, hinges and yarns at x (3, n) and invert its diagonal blocks."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    diagonal = np.zeros((6, high - low + PADDING))
    if runs is not None:
        fill_spring_runs(block, x, before, runs, to_runs, rate, floor, follow)
        sum_spring_runs(block, low, to_runs, diagonal)
    if lists is not None:
        fill_spring_lists(block, x, before, lists, to_lists, rate, floor, follow)
        sum_spring_lists(block, to_lists, diagonal)
    if hinge_runs is not None:
        fill_hinge_runs(block, x, hinge_runs, to_hinge_runs)
        sum_hinge_runs(block, low, to_hinge_runs, diagonal)
    if hinge_lists is not None:
        fill_hinge_lists(block, x, hinge_lists, to_hinge_lists)
        sum_hinge_lists(block, to_hinge_lists, diagonal)
    if yarns is not None:
        fill_yarns(block, x, before, yarns, to_yarns, rate, floor, follow)
        sum_yarns(block, to_yarns, diagonal)
    for v in range(low, high):
        if inverse_mass[v] > 0.0:
            invert(own, inverse, v, diagonal, v - low)


@parallel_kernel
def fill_parallel(
    x: Any, before: Any, rate: float, floor: float, follow: float, inverse_mass: Any, own: Any, inverse: Any,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any, yarns: Any,
    to_runs: Any, to_lists: Any, to_hinge_runs: Any, to_hinge_lists: Any, to_yarns: Any,
) -> None:  # fmt: skip
    """All blocks on several threads."""
    for block in prange((x.shape[1] + BLOCK - 1) // BLOCK):
        fill_block(
            block, x, before, rate, floor, follow, inverse_mass, own, inverse, runs, lists, hinge_runs, hinge_lists,
            yarns, to_runs, to_lists, to_hinge_runs, to_hinge_lists, to_yarns,
        )  # fmt: skip


@kernel
def fill_blocks(
    x: Any, before: Any, rate: float, floor: float, follow: float, inverse_mass: Any, own: Any, inverse: Any,
    runs: Any, lists: Any, hinge_runs: Any, hinge_lists: Any, yarns: Any,
    to_runs: Any, to_lists: Any, to_hinge_runs: Any, to_hinge_lists: Any, to_yarns: Any,
) -> None:  # fmt: skip
    """All blocks on one thread."""
    for block in range((x.shape[1] + BLOCK - 1) // BLOCK):
        fill_block(
            block, x, before, rate, floor, follow, inverse_mass, own, inverse, runs, lists, hinge_runs, hinge_lists,
            yarns, to_runs, to_lists, to_hinge_runs, to_hinge_lists, to_yarns,
        )  # fmt: skip


def fill(
    x: Float, rate: float, p: Packed, a: Linear, exact: bool = False, before: Float | None = None, follow: bool = True
) -> None:
    """Linearise at x (3, n), with dv/dx = `rate` [1/s]; a.own holds D already.

    The matrix is positive unless it is `exact`; its preconditioner is in either case. Springs have the tension
    that a linear step from `before` (3, n) to x leads to, or the one that they had there where not `follow`.
    """
    floor = -LOWEST if exact else 0.0
    call = fill_blocks if p.threads is None else fill_parallel
    call(
        x, x if before is None else before, rate, floor, float(follow), a.inverse_mass, a.own, a.inverse,
        p.runs, p.lists, p.hinge_runs, p.hinge_lists, p.yarns, a.runs, a.lists, a.hinge_runs, a.hinge_lists, a.yarns,
    )  # fmt: skip
