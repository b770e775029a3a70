"""The membrane as compliant constraints, three a triangle, in the order of nuno_kernels.forces.constraints.

Strains e = (e_w, e_f, g) have the gradients J (3, 9), stresses s = A (C e + D de/dt), and vertices the mobilities M.
Solved alone, a triangle has s = (1 + K N)^-1 A (C e + D de/dt), with K = A (C + D / h), N = J M J^T and strains taken
without s.
Where sweeps are repeated, what is kept is its force, and brought to the force F(x + u) that it exerts:
dF = r - J^T (1 + K N)^-1 K J M r with r = F(x + u) - F, cut down by the stress across the yarns, which is not in K.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_kernels import block_kernel, kernel
from nuno_kernels.forces.constraints import ListElements, zero_forces
from nuno_kernels.forces.membrane import (
    MembraneLists,
    Stresses,
    Yarns,
    at_corners,
    direction,
    drags,
    growth,
    pulls,
    sides,
    stresses,
    stretched,
)
from nuno_kernels.lanes import (
    WIDTH,
    Triple,
    add_at,
    dot,
    gather,
    higher,
    load,
    load_triple,
    minus,
    plus,
    splat,
    store,
    times,
    where_not_zero,
)
from nuno_kernels.step.blocks import BLOCK, Long
from nuno_kernels.terms import Displaced, register
from nuno_schemas.fabric import Float, Int


class MembraneBatches(NamedTuple):
    """Triangles by index, in whole vectors without a common vertex.

    start     (batches + 1,) int64  columns of each batch
    ends      (3, p) int32
    constants (11, p)               as in nuno_kernels.forces.membrane.MembraneLists
    forces    (6, p)                forces [N] at x1 and x2; None where one sweep needs no memory
    """

    start: Long
    ends: Int
    constants: Float
    forces: Float | None


def constraints_of_membrane(lists: MembraneLists, vertices: int) -> tuple[ListElements, ...]:
    """Return every triangle once."""
    block = np.repeat(np.arange(lists.start.shape[0] - 1), np.diff(lists.start))
    columns = lists.corners[3] < np.minimum(BLOCK, vertices - block * BLOCK)
    at = np.flatnonzero(columns & (lists.corners[0] != lists.corners[1]))
    return (ListElements(MembraneBatches, lists.corners[:3, at].T.astype(np.int64), lists.constants[:, at]),)


@kernel
def solve_three(rows: tuple[Triple, Triple, Triple], b: Triple) -> Triple:
    """Solve eight systems of three equations, by cofactors."""
    m, n, o = rows
    c0 = n[1] * o[2] - n[2] * o[1], n[2] * o[0] - n[0] * o[2], n[0] * o[1] - n[1] * o[0]
    c1 = m[2] * o[1] - m[1] * o[2], m[0] * o[2] - m[2] * o[0], m[1] * o[0] - m[0] * o[1]
    c2 = m[1] * n[2] - m[2] * n[1], m[2] * n[0] - m[0] * n[2], m[0] * n[1] - m[1] * n[0]
    inverse = 1.0 / dot(m, c0)
    return (
        inverse * (c0[0] * b[0] + c1[0] * b[1] + c2[0] * b[2]),
        inverse * (c0[1] * b[0] + c1[1] * b[1] + c2[1] * b[2]),
        inverse * (c0[2] * b[0] + c1[2] * b[1] + c2[2] * b[2]),
    )


@kernel
def responses(unit: Yarns, yarns: Yarns, mobile: Triple) -> tuple[Triple, Triple, Triple]:
    """Return N = J M J^T of eight triangles; `mobile` are the sums over corners of their mobility times w w, w f and f
    f, w and f being how they move F_w and F_f.
    """
    ww, wf, ff = mobile
    between = wf * dot(unit[0], unit[1])
    warp = ww * dot(unit[0], yarns[1]) + wf * dot(unit[0], yarns[0])
    weft = wf * dot(unit[1], yarns[1]) + ff * dot(unit[1], yarns[0])
    shear = ww * dot(yarns[1], yarns[1]) + 2.0 * (wf * dot(yarns[0], yarns[1])) + ff * dot(yarns[0], yarns[0])
    return (ww, between, warp), (between, ff, weft), (warp, weft, shear)


@kernel
def stiffened(e: Triple, rate: float, constants: Float, p: int) -> Stresses:
    """Return K e of eight triangles, `rate` 1 / h."""
    return plus(stresses(e, constants, p), times(splat(rate), drags(e, constants, p)))


@kernel
def solve_stresses(s: Stresses, n: tuple[Triple, Triple, Triple], rate: float, constants: Float, p: int) -> Stresses:
    """Return (1 + K N)^-1 s of eight triangles."""
    c0, c1 = stiffened(n[0], rate, constants, p), stiffened(n[1], rate, constants, p)
    c2 = stiffened(n[2], rate, constants, p)
    rows = (1.0 + c0[0], c1[0], c2[0]), (c0[1], 1.0 + c1[1], c2[1]), (c0[2], c1[2], 1.0 + c2[2])
    return solve_three(rows, s)


@block_kernel
def sweep_membrane(batch: int, moved: Displaced, lists: MembraneBatches, forces: Float | None) -> None:
    """Solve a batch's triangles in their order, in place in the displacements; `forces` is the lists'."""
    x, u, mobility, rate = moved.x, moved.u, moved.mobility, moved.inverse_step
    start, ends, constants = lists.start, lists.ends, lists.constants
    for p in range(start[batch], start[batch + 1], WIDTH):
        m0, m1, m2 = gather(mobility, 0, ends, 0, p), gather(mobility, 0, ends, 1, p), gather(mobility, 0, ends, 2, p)
        w1, w2, f1, f2 = load(constants, 0, p), load(constants, 1, p), load(constants, 2, p), load(constants, 3, p)
        w0, f0 = w1 + w2, f1 + f2
        mobile = (
            m0 * w0 * w0 + m1 * w1 * w1 + m2 * w2 * w2,
            m0 * w0 * f0 + m1 * w1 * f1 + m2 * w2 * f2,
            m0 * f0 * f0 + m1 * f1 * f1 + m2 * f2 * f2,
        )
        rates = stretched(*sides(u, ends, p), constants, p)
        still = stretched(*sides(x, ends, p), constants, p)
        yarns = plus(still[0], rates[0]), plus(still[1], rates[1])
        (warp, long), (weft, wide) = direction(yarns[0]), direction(yarns[1])
        unit = warp, weft
        s = stresses((long - 1.0, wide - 1.0, dot(yarns[0], yarns[1])), constants, p)
        s = plus(s, times(splat(rate), drags(growth(rates, unit, yarns), constants, p)))
        n = responses(unit, yarns, mobile)
        if forces is None:
            s = solve_stresses(s, n, rate, constants, p)
        first, second = at_corners(pulls(s, unit, yarns), constants, p)
        first, second = times(-1.0, first), times(-1.0, second)
        if forces is not None:
            first, second = minus(first, load_triple(forces, 0, p)), minus(second, load_triple(forces, 3, p))
            total = plus(first, second)
            on_warp = plus(times(m0 * w0, total), plus(times(m1 * w1, first), times(m2 * w2, second)))
            on_weft = plus(times(m0 * f0, total), plus(times(m1 * f1, first), times(m2 * f2, second)))
            z = stiffened(growth((on_warp, on_weft), unit, yarns), rate, constants, p)
            z = solve_stresses(z, n, rate, constants, p)
            taken = at_corners(pulls(z, unit, yarns), constants, p)
            across = (
                where_not_zero(long, higher(s[0], splat(0.0)) / long) * mobile[0]
                + where_not_zero(wide, higher(s[1], splat(0.0)) / wide) * mobile[2]
            )
            part = 1.0 / (1.0 + across)
            first, second = times(part, minus(first, taken[0])), times(part, minus(second, taken[1]))
            for row in range(3):
                store(forces, row, p, load(forces, row, p) + first[row])
                store(forces, 3 + row, p, load(forces, 3 + row, p) + second[row])
        for row in range(3):
            add_at(u, row, ends, 0, p, 0.0 - m0 * (first[row] + second[row]))
            add_at(u, row, ends, 1, p, m1 * first[row])
            add_at(u, row, ends, 2, p, m2 * second[row])


@kernel
def solve_membrane(lists: MembraneBatches, batch: int, moved: Displaced) -> None:
    """Solve a batch's triangles."""
    sweep_membrane(batch, moved, lists, lists.forces)


register(MembraneBatches, name="membrane", sweep=solve_membrane, forget=zero_forces)
