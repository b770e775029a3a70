"""Friction between the yarns of cloth that is bent: why the loop of moment over curvature does not close."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_kernels import block_kernel, kernel
from nuno_kernels.forces.linear import LinearLists, linear_lists
from nuno_kernels.lanes import (
    WIDTH,
    Lanes,
    Triple,
    add_at,
    cross,
    dot,
    gather_triple,
    load,
    load_triple,
    lower,
    minus,
    plus,
    read,
    root,
    splat,
    store,
    times,
    where_greater,
    write,
)
from nuno_kernels.step.blocks import BLOCK, PADDING, Long, list_copies
from nuno_kernels.terms import over_blocks, register
from nuno_schemas.fabric import BendingFriction, Float, Int

# Friction between the yarns of cloth that is bent: why the loop of moment over curvature does not close.
#
# Round each vertex the surface's tangents t_w, t_f and second derivatives d_w, d_f, d_t are linear in its patch's
# vertices. With the normal n = t_w x t_f / |t_w x t_f| the curvatures are k_a = d_a.n. Beside the elastic moment there
# is that of an elastic element that slips: with k' where it would be at rest, e = (k - k') / k_s, and H_w, H_f the
# moments per width at which yarns slip (H_t their geometric mean),
#
#     m_w = H_w e_w,  m_f = H_f e_f,  m_t = H_t e_t,    |e|^2 = e_w^2 + e_f^2 + 2 e_t^2 <= 1,
#
# the norm that does not depend on directions. Where |e| would be above 1, k' follows, so that |e| is 1: cloth bent by
# far more than k_s has the moment B k + H on its way there and B k - H on the way back, keeps the curvature H / B
# without load, and loses 4 H (k_max - k_s) in every cycle between -k_max and k_max. k' moves after each whole step.
#
# A vertex of area A has the work A (m_w dk_w + m_f dk_f + 2 m_t dk_t). With g = sum of m_a d_a, g' what of it is along
# the surface and q = g' / |t_w x t_f| the force on a vertex with the shares s_w, s_f and s_a of these derivatives is
#
#     -A ((sum of m_a s_a) n + s_w t_f x q + s_f q x t_w),
#
# the exact derivative with m held: no momentum comes of it, whatever the mesh.
#
# Not chosen: a friction that follows the sign of the curvature's rate, which has no moment at rest and so keeps no
# crease; one of the second derivatives themselves, which would resist strain that differs from place to place.

ROWS = 6
"""rows of the matrix: the normal, and the stiffness of each curvature"""
PARTS = 5
"""rows of shares for each vertex: of t_w, t_f [1/m], d_w, d_f and d_t [1/m^2]"""


class FrictionLists(NamedTuple):
    """Patches of k vertices, the first in the middle, padded to whole vectors by patches of one vertex.

    start      (blocks + 1,) int64   places of each block's patches
    corners    (2 k, p) int32        vertices, then their columns in the block's forces
    shares     (5 (k - 1), p)        of all vertices but the first, which has minus their sum
    constants  (4, p)                A H_w, A H_f and 2 A H_t [N m^2], and 1 / k_s [m]
    rested     (3, p)                k' [1/m], of warp, weft and twist
    """

    start: Long
    corners: Int
    shares: Float
    constants: Float
    rested: Float


class HeldFriction(NamedTuple):
    """The same, with a force that is held over several steps; see `hold`.

    start, corners, shares, constants, rested  as above
    force      (3, n)  [N]
    clock      (4,)    for how long the force is still held, or NOT_HELD; when that was asked last, by the interval's
                       own time; how long an interval takes; how long a force may be held [s]
    """

    start: Long
    corners: Int
    shares: Float
    constants: Float
    rested: Float
    force: Float
    clock: Float


Five = tuple[Triple, Triple, Triple, Triple, Triple]


@kernel
def derivatives(lists: FrictionLists | HeldFriction, x: Float, p: int) -> Five:
    """Return t_w, t_f, d_w, d_f and d_t of eight patches, or other quantities linear in their vertices (3, n)."""
    corners, shares, zero = lists.corners, lists.shares, splat(0.0)
    own, none = gather_triple(x, corners, 0, p), (zero, zero, zero)
    a, b, c, d, e = none, none, none, none, none
    for j in range(1, corners.shape[0] // 2):
        away, at = minus(gather_triple(x, corners, j, p), own), PARTS * (j - 1)
        a, b = plus(a, times(load(shares, at, p), away)), plus(b, times(load(shares, at + 1, p), away))
        c, d = plus(c, times(load(shares, at + 2, p), away)), plus(d, times(load(shares, at + 3, p), away))
        e = plus(e, times(load(shares, at + 4, p), away))
    return a, b, c, d, e


@kernel
def normal(derived: Five) -> tuple[Triple, Lanes]:
    """Return unit normals of eight patches and 1 / |t_w x t_f|; both 0 if there is none."""
    across = cross(derived[0], derived[1])
    square = dot(across, across)
    inverse = where_greater(square, splat(0.0), 1.0 / root(square))
    return times(inverse, across), inverse


@kernel
def held(lists: FrictionLists | HeldFriction, derived: Five, n: Triple, p: int) -> tuple[Triple, Lanes]:
    """Return e of eight patches, before any slips, and the factor on each that limits |e| to 1."""
    e = times(
        load(lists.constants, 3, p),
        minus((dot(derived[2], n), dot(derived[3], n), dot(derived[4], n)), load_triple(lists.rested, 0, p)),
    )
    square = e[0] * e[0] + e[1] * e[1] + 2.0 * (e[2] * e[2])
    return e, lower(1.0 / root(square), splat(1.0))


@kernel
def spread_patch(
    lists: FrictionLists | HeldFriction, p: int, force: Float, on: Triple, warp: Triple, weft: Triple, m: Triple
) -> None:
    """Add minus s_w `warp` + s_f `weft` + (sum of m_a s_a) `on` of eight patches to a block's forces (3, w)."""
    corners, shares, zero = lists.corners, lists.shares, splat(0.0)
    k, total = corners.shape[0] // 2, (zero, zero, zero)
    for j in range(1, k):
        at = PARTS * (j - 1)
        size = m[0] * load(shares, at + 2, p) + m[1] * load(shares, at + 3, p) + m[2] * load(shares, at + 4, p)
        pull = plus(times(load(shares, at, p), warp), times(load(shares, at + 1, p), weft))
        pull = plus(pull, times(size, on))
        total = plus(total, pull)
        for row in range(3):
            add_at(force, row, corners, k + j, p, 0.0 - pull[row])
    for row in range(3):
        add_at(force, row, corners, k, p, total[row])


@kernel
def add_friction(
    lists: FrictionLists | HeldFriction, block: int, origin: int, x: Float, v: Float, force: Float
) -> None:
    """Add a block's patches to its forces (3, w)."""
    for p in range(lists.start[block], lists.start[block + 1], WIDTH):
        derived = derivatives(lists, x, p)
        n, inverse = normal(derived)
        e, kept = held(lists, derived, n, p)
        m = kept * e[0] * load(lists.constants, 0, p), kept * e[1] * load(lists.constants, 1, p)
        moment = m[0], m[1], kept * e[2] * load(lists.constants, 2, p)
        pull = plus(plus(times(moment[0], derived[2]), times(moment[1], derived[3])), times(moment[2], derived[4]))
        along = times(inverse, minus(pull, times(dot(pull, n), n)))
        spread_patch(lists, p, force, n, cross(derived[1], along), cross(along, derived[0]), moment)


@kernel
def stick(lists: FrictionLists, x: Float) -> None:
    """Set k' to the present curvature at x (3, n): no patch slips on a short way from there."""
    for p in range(0, lists.corners.shape[1], WIDTH):
        derived = derivatives(lists, x, p)
        n, _ = normal(derived)
        for row in range(3):
            store(lists.rested, row, p, dot((derived[2], derived[3], derived[4])[row], n))


@block_kernel
def settle_block(block: int, x: Float, lists: FrictionLists | HeldFriction) -> None:
    """Move k' of a block's patches that slip."""
    for p in range(lists.start[block], lists.start[block + 1], WIDTH):
        derived = derivatives(lists, x, p)
        e, kept = held(lists, derived, normal(derived)[0], p)
        gone = (1.0 - kept) / load(lists.constants, 3, p)
        for row in range(3):
            store(lists.rested, row, p, load(lists.rested, row, p) + gone * e[row])


settle_each = over_blocks(settle_block, "x, lists")


@kernel
def settle_friction(lists: FrictionLists, x: Float, v: Float, s: float, threads: int | None) -> None:
    """Move k' of patches that slip."""
    settle_each(x, lists, lists.start.shape[0] - 1, threads)


@kernel
def fill_friction(
    lists: FrictionLists, linear: LinearLists, block: int, x: Float, before: Float, rate: float, floor: float,
    follow: float,
) -> None:  # fmt: skip
    """Write the rows of a block's patches at x (3, n).

    A slipping patch has the moment over the whole change of curvature, not its derivative, which is 0 along that
    change: it is positive, and Newton's method meets no corner.
    """
    for p in range(lists.start[block], lists.start[block + 1], WIDTH):
        derived = derivatives(lists, x, p)
        n, _ = normal(derived)
        kept = held(lists, derived, n, p)[1] * load(lists.constants, 3, p)
        for row in range(3):
            store(linear.rows, row, p, n[row])
            store(linear.rows, 3 + row, p, kept * load(lists.constants, row, p))


@kernel
def multiply_friction(lists: FrictionLists, linear: LinearLists, block: int, origin: int, u: Float, out: Float) -> None:
    """Add the products of a block's patches with u (3, n) to `out` (3, w)."""
    zero = splat(0.0)
    none = zero, zero, zero
    for p in range(lists.start[block], lists.start[block + 1], WIDTH):
        found, n, stiff = derivatives(lists, u, p), load_triple(linear.rows, 0, p), load_triple(linear.rows, 3, p)
        m = stiff[0] * dot(found[2], n), stiff[1] * dot(found[3], n), stiff[2] * dot(found[4], n)
        spread_patch(lists, p, out, times(splat(-1.0), n), none, none, m)


@kernel
def sum_friction(lists: FrictionLists, linear: LinearLists, block: int, origin: int, out: Float) -> None:
    """Add the diagonal blocks of a block's patches to (6, w)."""
    rows, shares, k = linear.rows, lists.shares, lists.corners.shape[0] // 2
    for p in range(lists.start[block], lists.start[block + 1]):
        own = (0.0, 0.0, 0.0)
        for j in range(1, k + 1):
            if j < k:
                at = PARTS * (j - 1) + 2
                s = shares[at, p], shares[at + 1, p], shares[at + 2, p]
                own = minus(own, s)
            else:
                s = own
            size = rows[3, p] * s[0] * s[0] + rows[4, p] * s[1] * s[1] + rows[5, p] * s[2] * s[2]
            to, x, y, z = lists.corners[k + j % k, p], rows[0, p], rows[1, p], rows[2, p]
            out[0, to] += size * x * x
            out[1, to] += size * y * y
            out[2, to] += size * z * z
            out[3, to] += size * x * y
            out[4, to] += size * x * z
            out[5, to] += size * y * z


@kernel
def measure_friction(lists: FrictionLists | HeldFriction, x: Float) -> float:
    """Return the energy of what has not slipped [J], each patch counted where its first vertex is at home."""
    energy, c, k = 0.0, lists.constants, lists.corners.shape[0] // 2
    scratch = np.empty((3, WIDTH))
    for block in range(lists.start.shape[0] - 1):
        width = min(BLOCK, x.shape[1] - block * BLOCK)
        for p in range(lists.start[block], lists.start[block + 1], WIDTH):
            derived = derivatives(lists, x, p)
            e, kept = held(lists, derived, normal(derived)[0], p)
            for row in range(3):
                store(scratch, row, 0, kept * e[row])
            for q in range(WIDTH):
                if lists.corners[k, p + q] < width:
                    e0, e1, e2 = scratch[0, q], scratch[1, q], scratch[2, q]
                    stored = c[0, p + q] * e0 * e0 + c[1, p + q] * e1 * e1 + c[2, p + q] * e2 * e2
                    energy += 0.5 * stored / c[3, p + q]
    return energy


def pack_friction(friction: BendingFriction | None, vertices: int) -> tuple[FrictionLists, ...]:
    """Return the kernel layout of a fabric's friction; () without any."""
    if friction is None or friction.number == 0:
        return ()
    order = np.lexsort((friction.vertices.max(axis=1), friction.vertices.min(axis=1)))
    element, start, corners = list_copies(friction.vertices[order].T.astype(np.int64), vertices)
    warp, weft = friction.limit * friction.area
    constants = np.stack([warp, weft, 2.0 * np.sqrt(warp * weft), 1.0 / friction.slip])[:, order]
    shares = friction.shares[order][:, :, 1:].transpose(2, 1, 0).reshape(-1, len(order))
    there = element >= 0
    shares, constants = (np.where(there, values[:, element], 0.0) for values in (shares, constants))
    constants[3, ~there] = 1.0
    shares, constants = np.ascontiguousarray(shares), np.ascontiguousarray(constants)
    return (FrictionLists(start, corners, shares, constants, np.zeros((3, len(element)))),)


register(
    FrictionLists, "bending_friction", memory=("rested",), block=add_friction, settle=settle_friction, stick=stick,
    hold_over="bending_friction:hold", rows=linear_lists(ROWS, "corners"), fill=fill_friction, diagonal=sum_friction,
    multiply=multiply_friction, energy=measure_friction,
)  # fmt: skip


# Bending friction that is held over several steps, for methods of many small steps.
#
# Friction is far softer than tension, which sets their step. Its force is found where the cloth will be in the middle
# of the time T for which it is then held, x + v T / 2. An element that holds, x'' = -omega^2 x, goes over T by
#
#     x' = x + v T - (omega T)^2 (x + v T / 2) / 2,    v' = v - omega^2 T (x + v T / 2),
#
# whose determinant is 1: it neither grows nor fades for omega T < 2. Found at x, the force would lag and feed the
# swing. Leapfrog begins a step with the force of the last: looked for a step h further ahead, the swing fades a little
# with every method, by about omega^2 h / 2 at most, and is stable for (omega T)^2 (1 / 2 + h / T) < 2: with two steps
# at least, for omega T < sqrt(2).

NOT_HELD = -1.0
"""stands for the time for which the force is still held"""
LONGEST = 1.4
"""limit of T times omega"""


@kernel
def add_held(held: HeldFriction, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add the held force to a block's forces (3, w), or that at x if none is held."""
    if held.clock[0] < 0.0:
        add_friction(held, block, origin, x, v, force)
        return
    end = min(origin + BLOCK, x.shape[1])
    for row in range(3):
        for i in range(origin, end, WIDTH):
            m = min(WIDTH, end - i)
            write(force, row, i - origin, m, read(force, row, i - origin, m) + read(held.force, row, i, m))


@block_kernel
def find_block(block: int, held: HeldFriction, x: Float, ahead: Float) -> None:
    """Move k' of a block's patches that slip at x (3, n), and compute their force at `ahead` (3, n)."""
    origin, end = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    force = np.zeros((3, end - origin + PADDING))
    settle_block(block, x, held)
    add_friction(held, block, origin, ahead, ahead, force)
    for row in range(3):
        for i in range(origin, end):
            held.force[row, i] = force[row, i - origin]


find_each = over_blocks(find_block, "held, x, ahead")


@kernel
def settle_held(held: HeldFriction, x: Float, v: Float, s: float, threads: int | None) -> None:
    """Compute the force anew if it has been held for its time, for as many steps like the last as that has; if those
    are fewer than two, move k' of what slips, and hold nothing.
    """
    clock, blocks = held.clock, held.start.shape[0] - 1
    now = s * clock[2]
    step = now - clock[1]
    clock[1] = now
    if 2.0 * step > clock[3]:
        clock[0] = NOT_HELD
        settle_each(x, held, blocks, threads)
        return
    clock[0] = max(clock[0], 0.0) - step
    if clock[0] < 0.5 * step:
        clock[0] = step * np.floor(clock[3] / step)
        find_each(held, x, x + (0.5 * clock[0] + step) * v, blocks, threads)


def hold(lists: FrictionLists, inverse_mass: Float) -> HeldFriction:
    """Return patches whose force is held for LONGEST over omega, omega^2 bounding how fast vertices of these masses
    (n,) may oscillate, by the sums of the rows of the matrix if all stick (Gershgorin).
    """
    shares = lists.shares.reshape(-1, PARTS, lists.shares.shape[1])[:, 2:]
    shares = np.abs(np.concatenate([-shares.sum(axis=0, keepdims=True), shares]))
    rows = (shares * shares.sum(axis=0) * (lists.constants[:3] * lists.constants[3])).sum(axis=1)
    squared, corners = np.zeros(len(inverse_mass)), lists.corners[: len(rows)]
    np.add.at(squared, corners, rows * inverse_mass[corners])
    clock = np.array([NOT_HELD, 0.0, 0.0, LONGEST / np.sqrt(squared.max(initial=0.0) or 1.0)])
    return HeldFriction(*lists, np.zeros((3, len(inverse_mass))), clock)


def begin(held: HeldFriction, x: Float, span: float, threads: int | None) -> None:
    """Begin an interval of `span` [s], 0 if the state is only examined."""
    if span > 0.0:
        held.clock[1], held.clock[2] = 0.0, span


register(
    HeldFriction, "bending_friction", memory=("rested", "force", "clock"), block=add_held, settle=settle_held,
    begin=begin, energy=measure_friction,
)  # fmt: skip
