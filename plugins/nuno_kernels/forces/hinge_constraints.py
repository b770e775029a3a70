"""Hinges as compliant constraints, solved one after another in the order of nuno_kernels.forces.constraints."""

from __future__ import annotations

from typing import NamedTuple

from nuno_kernels import block_kernel, kernel
from nuno_kernels.forces.constraints import forget_kept
from nuno_kernels.forces.hinges import hinge_shape
from nuno_kernels.lanes.simd import WIDTH, Lanes, Triple, add_at, gather, load, root, store
from nuno_kernels.lanes.triples import dot, gather_triple, load_triple, minus, plus, times
from nuno_kernels.step.blocks import Long
from nuno_kernels.terms import Displaced, register
from nuno_schemas.fabric import Float, Int


class HingeBatches(NamedTuple):
    """Hinges by index, in whole vectors without a common vertex.

    start     (batches + 1,) int64  columns of each batch
    ends      (4, p) int32
    constants (3, p)                k cos(rest), k sin(rest), k [N m]
    kept      (9, p)                forces [N] as `sweep_hinges` says; None as above
    """

    start: Long
    ends: Int
    constants: Float
    kept: Float | None


Parts = tuple[Lanes, Triple, Triple, Triple, Triple]


@kernel
def hinge_parts(x0: Triple, x1: Triple, x2: Triple, x3: Triple, k_cos: Lanes, k_sin: Lanes) -> Parts:
    """Moments k sin(angle - rest) of eight hinges, and at x0 and x1 minus, at x2 and x3 plus the angle's gradient.

    r is 0 for a triangle without area: see nuno_kernels.forces.hinges.hinge_shape.
    """
    n1, n2, d3, ee, q1, q2, r, t2, t3 = hinge_shape(x0, x1, x2, x3)
    sine, cosine = dot(n1, d3) * (ee * root(r)), dot(n1, n2) * root(r * ee)
    size = root(ee) * (ee * r)
    g2, g3 = times(size * q2, n1), times(size * q1, n2)
    g1 = plus(times(t2, g2), times(t3, g3))
    return k_cos * sine - k_sin * cosine, minus(plus(g2, g3), g1), g1, g2, g3


@kernel
def moved_corner(x: Float, u: Float, ends: Int, which: int, p: int) -> Triple:
    """Positions x + u of one corner of eight hinges."""
    return plus(gather_triple(x, ends, which, p), gather_triple(u, ends, which, p))


@block_kernel
def sweep_hinges(batch: int, moved: Displaced, hinges: HingeBatches, kept: Float | None) -> None:
    """Solve a batch's hinges in their order, in place in the displacements; `kept` is the hinges'.

    Forces are f0 and f1 on x0 and x1, minus f2 and f3 on x2 and x3, with f0 = f2 + f3 - f1; (9, p) are kept.
    """
    x, u, mobility = moved.x, moved.u, moved.mobility
    start, ends, constants = hinges.start, hinges.ends, hinges.constants
    for p in range(start[batch], start[batch + 1], WIDTH):
        m0, m1 = gather(mobility, 0, ends, 0, p), gather(mobility, 0, ends, 1, p)
        m2, m3 = gather(mobility, 0, ends, 2, p), gather(mobility, 0, ends, 3, p)
        moment, g0, g1, g2, g3 = hinge_parts(
            moved_corner(x, u, ends, 0, p), moved_corner(x, u, ends, 1, p), moved_corner(x, u, ends, 2, p),
            moved_corner(x, u, ends, 3, p), load(constants, 0, p), load(constants, 1, p),
        )  # fmt: skip
        k = load(constants, 2, p)
        all_k = 1.0 + k * (m0 * dot(g0, g0) + m1 * dot(g1, g1) + m2 * dot(g2, g2) + m3 * dot(g3, g3))
        if kept is None:
            moment = moment / all_k
            f1, f2, f3 = times(moment, g1), times(moment, g2), times(moment, g3)
        else:
            f1 = minus(times(moment, g1), load_triple(kept, 0, p))
            f2 = minus(times(moment, g2), load_triple(kept, 3, p))
            f3 = minus(times(moment, g3), load_triple(kept, 6, p))
            f0 = minus(plus(f2, f3), f1)
            along = k * (m0 * dot(g0, f0) + m1 * dot(g1, f1) + m2 * dot(g2, f2) + m3 * dot(g3, f3)) / all_k
            f1, f2, f3 = minus(f1, times(along, g1)), minus(f2, times(along, g2)), minus(f3, times(along, g3))
            for row in range(3):
                store(kept, row, p, load(kept, row, p) + f1[row])
                store(kept, 3 + row, p, load(kept, 3 + row, p) + f2[row])
                store(kept, 6 + row, p, load(kept, 6 + row, p) + f3[row])
        for row in range(3):
            add_at(u, row, ends, 0, p, m0 * (f2[row] + f3[row] - f1[row]))
            add_at(u, row, ends, 1, p, m1 * f1[row])
            add_at(u, row, ends, 2, p, 0.0 - m2 * f2[row])
            add_at(u, row, ends, 3, p, 0.0 - m3 * f3[row])


@kernel
def solve_hinges(hinges: HingeBatches, batch: int, moved: Displaced) -> None:
    """Solve a batch's hinges."""
    sweep_hinges(batch, moved, hinges, hinges.kept)


register(HingeBatches, name="hinges", sweep=solve_hinges, forget=forget_kept)
