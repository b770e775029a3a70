"""Woven cloth in its plane, the membrane: its force, energy and tension, and its part of an implicit step's matrix."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.forces.linear import LinearLists, Rows, linear_lists, listed_elements
from nuno_kernels.lanes import (
    WIDTH,
    Lanes,
    Triple,
    add_at,
    dot,
    edge,
    gather_triple,
    higher,
    load,
    load_triple,
    lower,
    minus,
    plus,
    root,
    splat,
    store,
    times,
    where_not_zero,
)
from nuno_kernels.step.blocks import BLOCK, Long, is_small, list_copies
from nuno_kernels.terms import Measured, register
from nuno_schemas.fabric import Float, Int, Membrane

# Woven cloth in its plane: triangles of constant strain in the cloth's own directions, warp and weft.
#
# With the deformation gradient's columns F_w and F_f, what the unit vectors along warp and weft become, a triangle of
# area A at rest has the strains e_w = |F_w| - 1, e_f = |F_f| - 1, g = F_w.F_f and the energy
#
#     A (C_w e_w^2 + C_f e_f^2 + 2 C_wf e_w e_f + G g^2) / 2.
#
# For small strains these are the engineer's strains of any measure, and g the angle by which warp and weft have
# sheared. The stresses S_w = C_w e_w + C_wf e_f, S_f = C_f e_f + C_wf e_w and T = G g pull F_w with A (S_w w^ + T F_f)
# and F_f with A (S_f f^ + T F_w), w^ and f^ their directions. F is linear in the corners, F_w = a (x1 - x0) + b (x2 -
# x0), so is what acts on them. Damping adds D_w de_w/dt, D_f de_f/dt and D_g dg/dt to the stresses.
#
# Lengths of yarns, not Green's strains (|F_w|^2 - 1) / 2: these are stiffer by the square of the stretch, which costs
# steps, and softer where cloth is compressed: from 1 / sqrt(3) on it would give way and collapse. Shear alone is
# Green's, which needs no division: its stiffness is far below that of tension.


class MembraneLists(NamedTuple):
    """Triangles by index, padded to whole vectors by triangles of one vertex.

    start     (blocks + 1,) int64  places of each block's triangles
    corners   (6, p) int32         vertices x0, x1, x2, then their columns in the block's forces
    constants (11, p) float64      F_w and F_f by x1 - x0 and x2 - x0 [1/m], A times C_w, C_f, C_wf and G [N m] and
                                   times D_w, D_f and D_g [N m s]
    damped    True where any D is not 0 or the triangles are few, else None
    """

    start: Long
    corners: Int
    constants: Float
    damped: bool | None


Yarns = tuple[Triple, Triple]
"""images of the unit vectors along warp and weft, or their rates"""
Strains = tuple[Lanes, Lanes, Lanes]
"""e_w, e_f and g, or their rates"""
Stresses = tuple[Lanes, Lanes, Lanes]
"""A S_w, A S_f and A T"""


@kernel
def stretched(d1: Triple, d2: Triple, constants: Float, p: int) -> Yarns:
    """Return F_w and F_f of eight triangles from x1 - x0 and x2 - x0, or other quantities linear in them."""
    warp = plus(times(load(constants, 0, p), d1), times(load(constants, 1, p), d2))
    return warp, plus(times(load(constants, 2, p), d1), times(load(constants, 3, p), d2))


@kernel
def direction(yarn: Triple) -> tuple[Triple, Lanes]:
    """Return directions and lengths of eight vectors; one of length 0 has none."""
    square = dot(yarn, yarn)
    length = root(square)
    return times(where_not_zero(square, 1.0 / length), yarn), length


@kernel
def stresses(e: Strains, constants: Float, p: int) -> Stresses:
    """Return A S_w, A S_f and A T of eight triangles."""
    warp, weft, both = load(constants, 4, p), load(constants, 5, p), load(constants, 6, p)
    return warp * e[0] + both * e[1], weft * e[1] + both * e[0], load(constants, 7, p) * e[2]


@kernel
def drags(rate: Strains, constants: Float, p: int) -> Stresses:
    """Return the damping part of the stresses of eight triangles."""
    return load(constants, 8, p) * rate[0], load(constants, 9, p) * rate[1], load(constants, 10, p) * rate[2]


@kernel
def growth(rates: Yarns, unit: Yarns, yarns: Yarns) -> Strains:
    """Return the rates of the strains of eight triangles whose F_w and F_f change at `rates`."""
    return dot(unit[0], rates[0]), dot(unit[1], rates[1]), dot(rates[0], yarns[1]) + dot(rates[1], yarns[0])


@kernel
def pulls(s: Stresses, unit: Yarns, yarns: Yarns) -> Yarns:
    """Return the forces that pull F_w and F_f back [N m], by their directions."""
    warp = plus(times(s[0], unit[0]), times(s[2], yarns[1]))
    return warp, plus(times(s[1], unit[1]), times(s[2], yarns[0]))


@kernel
def at_corners(pull: Yarns, constants: Float, p: int) -> tuple[Triple, Triple]:
    """Return the forces at x1 and x2 of pulls at F_w and F_f; x0 has minus their sum."""
    first = plus(times(load(constants, 0, p), pull[0]), times(load(constants, 2, p), pull[1]))
    return first, plus(times(load(constants, 1, p), pull[0]), times(load(constants, 3, p), pull[1]))


@kernel
def sides(x: Float, corners: Int, p: int) -> tuple[Triple, Triple]:
    """Return x1 - x0 and x2 - x0 of eight triangles."""
    x0 = gather_triple(x, corners, 0, p)
    return minus(gather_triple(x, corners, 1, p), x0), minus(gather_triple(x, corners, 2, p), x0)


@kernel
def spread_to_corners(force: Float, corners: Int, p: int, first: Triple, second: Triple) -> None:
    """Add forces on x1 and x2 of eight triangles, and minus their sum on x0, to a block's (3, w)."""
    for row in range(3):
        add_at(force, row, corners, 3, p, 0.0 - (first[row] + second[row]))
        add_at(force, row, corners, 4, p, first[row])
        add_at(force, row, corners, 5, p, second[row])


@kernel
def add_membrane(lists: MembraneLists, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add a block's triangles to its forces (3, w)."""
    start, corners, constants = lists.start, lists.corners, lists.constants
    for p in range(start[block], start[block + 1], WIDTH):
        yarns = stretched(*sides(x, corners, p), constants, p)
        warp, long = direction(yarns[0])
        weft, wide = direction(yarns[1])
        unit, s = (warp, weft), stresses((long - 1.0, wide - 1.0, dot(yarns[0], yarns[1])), constants, p)
        if lists.damped is not None:
            s = plus(s, drags(growth(stretched(*sides(v, corners, p), constants, p), unit, yarns), constants, p))
        first, second = at_corners(pulls(s, unit, yarns), constants, p)
        spread_to_corners(force, corners, p, times(-1.0, first), times(-1.0, second))


def damps(lists: MembraneLists) -> bool:
    """Whether any triangle is damped."""
    return lists.damped is not None and bool(lists.constants[8:].any())


def pack_membrane(membrane: Membrane | None, vertices: int) -> tuple[MembraneLists, ...]:
    """Return the kernel layout of a fabric's triangles; () without any."""
    if membrane is None or membrane.number == 0:
        return ()
    faces = membrane.faces.astype(np.int64)
    order = np.lexsort((faces.max(axis=1), faces.min(axis=1)))
    each = (membrane.moduli * membrane.area, membrane.damping * membrane.area)
    values = np.concatenate([membrane.along.T, membrane.across.T, *each])
    element, start, corners = list_copies(np.ascontiguousarray(faces[order].T), vertices)
    constants = np.ascontiguousarray(np.where(element >= 0, values[:, order][:, element], 0.0))
    damped = True if is_small(membrane.number) or membrane.damping.any() else None
    return (MembraneLists(start, corners, constants, damped),)


register(
    MembraneLists, "membrane", reads_velocity=damps, block=add_membrane, rows="membrane:rows_of_membrane",
    elements="membrane:elements_of_membrane", fill="membrane:fill_membrane", diagonal="membrane:sum_membrane",
    multiply="membrane:multiply_membrane", assemble="membrane:assemble_membrane", stiffest="membrane:stiffest",
    tension="membrane:tension_of_membrane", turning="membrane:turning_of_membrane", energy="membrane:measure_membrane",
    constraints="membrane_constraints:constraints_of_membrane",
)  # fmt: skip


# The membrane's matrix: each triangle's part as a 6 x 6 matrix on its F_w and F_f.
#
# Of the energy's second derivative there are, times the area and with the damping's part of each modulus, C_w + rate
# D_w,
#
#     H_ww = C_w w^ w^T + a_w (1 - w^ w^T) + G F_f F_f^T,     a_w = S_w / |F_w|,
#     H_wf = C_wf w^ f^T + G F_f F_w^T + T,
#
# and H_ff like H_ww. Stress across the yarns, a_w and T, is indefinite where cloth is compressed or sheared: a_w is cut
# off at `floor`, as of springs (nuno_kernels.forces.linear), and T left out where the matrix is to be positive. a_w is
# by the stress that the length F0_w.F_w / |F0_w| brings, F0 before the step.

ROWS, SHARES = 25, 21
"""xx, yy, zz, xy, xz, yz of H_ww and of H_ff, H_wf row by row; from SHARES on how x1 and x2 move F_w and F_f."""

elements_of_membrane = listed_elements(3)


def rows_of_membrane(lists: MembraneLists) -> LinearLists:
    """Allocate the matrix, with its constant entries."""
    linear = linear_lists(ROWS, "corners")(lists)
    linear.rows[SHARES:] = lists.constants[:4]
    return linear


@kernel
def expected_length(yarn: Triple, before: Triple, follow: float) -> Lanes:
    """Return the length that a linear step from `before` predicts for a yarn, or that at `before` if `follow` is 0."""
    square = dot(before, before)
    length = direction(before)[1]
    return length + follow * where_not_zero(square, dot(before, yarn) / length - length)


@kernel
def expected_stresses(yarns: Yarns, before: Yarns, follow: float, constants: Float, p: int) -> tuple[Lanes, Lanes]:
    """Return A S_w and A S_f that a linear step from `before` predicts."""
    warp, weft = expected_length(yarns[0], before[0], follow), expected_length(yarns[1], before[1], follow)
    found = stresses((warp - 1.0, weft - 1.0, splat(0.0)), constants, p)
    return found[0], found[1]


@kernel
def along_and_across(modulus: Lanes, stress: Lanes, yarn: Triple, shear: Lanes, other: Triple, floor: float) -> Rows:
    """Return H_ww of eight triangles, its six entries: `other` is F_f."""
    unit, length = direction(yarn)
    across = where_not_zero(length, higher(stress / length, splat(floor)))
    across = lower(across, modulus)
    rest = modulus - across
    return (
        across + rest * unit[0] * unit[0] + shear * other[0] * other[0],
        across + rest * unit[1] * unit[1] + shear * other[1] * other[1],
        across + rest * unit[2] * unit[2] + shear * other[2] * other[2],
        rest * unit[0] * unit[1] + shear * other[0] * other[1],
        rest * unit[0] * unit[2] + shear * other[0] * other[2],
        rest * unit[1] * unit[2] + shear * other[1] * other[2],
    )


@kernel
def fill_membrane(
    lists: MembraneLists, linear: LinearLists, block: int, x: Float, before: Float, rate: float, floor: float,
    follow: float,
) -> None:  # fmt: skip
    """Write the rows of a block's triangles at x (3, n), after a step from `before`."""
    corners, constants, rows = lists.corners, lists.constants, linear.rows
    for p in range(lists.start[block], lists.start[block + 1], WIDTH):
        yarns = stretched(*sides(x, corners, p), constants, p)
        s = expected_stresses(yarns, stretched(*sides(before, corners, p), constants, p), follow, constants, p)
        both, shear = load(constants, 6, p), load(constants, 7, p) + rate * load(constants, 10, p)
        long, wide = (
            load(constants, 4, p) + rate * load(constants, 8, p),
            load(constants, 5, p) + rate * load(constants, 9, p),
        )
        warp = along_and_across(long, s[0], yarns[0], shear, yarns[1], floor)
        weft = along_and_across(wide, s[1], yarns[1], shear, yarns[0], floor)
        for row in range(6):
            store(rows, row, p, warp[row])
            store(rows, 6 + row, p, weft[row])
        (w, _), (f, _) = direction(yarns[0]), direction(yarns[1])
        # Between the corners of a sheared triangle this has no sign.
        sheared = splat(0.0) if floor == 0.0 else load(constants, 7, p) * dot(yarns[0], yarns[1])
        for i in range(3):
            for j in range(3):
                found = both * w[i] * f[j] + shear * yarns[1][i] * yarns[0][j]
                store(rows, 12 + 3 * i + j, p, found + sheared if i == j else found)


@kernel
def product(rows: Float, p: int, warp: Triple, weft: Triple) -> Yarns:
    """Return H times (warp, weft) of eight triangles."""
    a, b = load_triple(rows, 0, p) + load_triple(rows, 3, p), load_triple(rows, 6, p) + load_triple(rows, 9, p)
    c0, c1, c2 = load_triple(rows, 12, p), load_triple(rows, 15, p), load_triple(rows, 18, p)
    on_warp = (
        a[0] * warp[0] + a[3] * warp[1] + a[4] * warp[2] + dot(c0, weft),
        a[3] * warp[0] + a[1] * warp[1] + a[5] * warp[2] + dot(c1, weft),
        a[4] * warp[0] + a[5] * warp[1] + a[2] * warp[2] + dot(c2, weft),
    )
    turned = plus(plus(times(warp[0], c0), times(warp[1], c1)), times(warp[2], c2))
    on_weft = (
        b[0] * weft[0] + b[3] * weft[1] + b[4] * weft[2] + turned[0],
        b[3] * weft[0] + b[1] * weft[1] + b[5] * weft[2] + turned[1],
        b[4] * weft[0] + b[5] * weft[1] + b[2] * weft[2] + turned[2],
    )
    return on_warp, on_weft


@kernel
def multiply_membrane(lists: MembraneLists, linear: LinearLists, block: int, origin: int, u: Float, out: Float) -> None:
    """Add the products of a block's triangles with u (3, n) to `out` (3, w)."""
    corners, constants = lists.corners, lists.constants
    for p in range(linear.start[block], linear.start[block + 1], WIDTH):
        moved = stretched(*sides(u, corners, p), constants, p)
        first, second = at_corners(product(linear.rows, p, moved[0], moved[1]), constants, p)
        spread_to_corners(out, corners, p, first, second)


@kernel
def share(rows: Float, c: int, corner: int) -> tuple[float, float]:
    """Return how a corner's place moves F_w and F_f of the triangle in column c."""
    if corner == 0:
        return -rows[SHARES, c] - rows[SHARES + 1, c], -rows[SHARES + 2, c] - rows[SHARES + 3, c]
    return rows[SHARES + corner - 1, c], rows[SHARES + corner + 1, c]


@kernel
def entry(rows: Float, c: int, w: tuple[float, float], z: tuple[float, float], i: int, j: int) -> float:
    """Return entry (i, j) of the 3 x 3 block between corners with the shares w and z."""
    place = i if i == j else i + j + 2
    alike = w[0] * z[0] * rows[place, c] + w[1] * z[1] * rows[6 + place, c]
    return float(alike + w[0] * z[1] * rows[12 + 3 * i + j, c] + w[1] * z[0] * rows[12 + 3 * j + i, c])


@kernel
def add_corner(out: Float, at: int, rows: Float, c: int, corner: int) -> None:
    """Add a corner's own block to column `at` of (6, w)."""
    w = share(rows, c, corner)
    for k in range(3):
        out[k, at] += entry(rows, c, w, w, k, k)
    out[3, at] += entry(rows, c, w, w, 0, 1)
    out[4, at] += entry(rows, c, w, w, 0, 2)
    out[5, at] += entry(rows, c, w, w, 1, 2)


@kernel
def sum_membrane(lists: MembraneLists, linear: LinearLists, block: int, origin: int, out: Float) -> None:
    """Add the diagonal blocks of a block's triangles to (6, w)."""
    for c in range(linear.start[block], linear.start[block + 1]):
        for corner in range(3):
            add_corner(out, linear.indices[3 + corner, c], linear.rows, c, corner)


@kernel
def assemble_membrane(linear: LinearLists, places: Any, diagonal: Float, values: Float) -> None:
    """Add triangles to a matrix that is to be factorised: see nuno_kernels.forces.linear."""
    rows = linear.rows
    for p in range(places.column.shape[0]):
        c, pair = places.column[p], 0
        for corner in range(3):
            add_corner(diagonal, places.vertices[corner, p], rows, c, corner)
        for i in range(3):
            for j in range(i + 1, 3):
                at, width = places.at[pair, p], places.width[pair, p]
                first, second = (i, j) if width > 0 else (j, i)
                if at >= 0:
                    w, z = share(rows, c, first), share(rows, c, second)
                    for row in range(3):
                        for column in range(3):
                            values[0, at + row * abs(width) + column] += entry(rows, c, w, z, row, column)
                pair += 1


# Measures of the membrane besides its force: energy, stretch, the largest force, work of turning.

Point = tuple[float, float, float]


@kernel
def yarns_of(lists: MembraneLists, x: Float, c: int) -> tuple[Point, Point]:
    """Return F_w and F_f of the triangle in column c, or of other arrays (3, n), linear in its corners."""
    corners, constants = lists.corners, lists.constants
    d1, d2 = edge(x, corners[0, c], corners[1, c]), edge(x, corners[0, c], corners[2, c])
    warp = plus(times(constants[0, c], d1), times(constants[1, c], d2))
    return warp, plus(times(constants[2, c], d1), times(constants[3, c], d2))


@kernel
def stress_of(lists: MembraneLists, c: int, warp: float, weft: float) -> Point:
    """Return A S_w, A S_f [N m] and A G of the triangle in column c, whose yarns have these lengths."""
    k = lists.constants
    e, f = warp - 1.0, weft - 1.0
    return k[4, c] * e + k[6, c] * f, k[5, c] * f + k[6, c] * e, k[7, c]


@kernel
def is_home(lists: MembraneLists, block: int, c: int, vertices: int) -> bool:
    """Whether column c holds a triangle, and the block has its first vertex: so each counts once."""
    width = min(BLOCK, vertices - block * BLOCK)
    return bool(lists.corners[0, c] != lists.corners[1, c] and lists.corners[3, c] < width)


@kernel
def measure_membrane(lists: MembraneLists, x: Float) -> Measured:
    """Return energy, the largest stretch in any direction, and the shortest side of any triangle."""
    energy, stretch, shortest = 0.0, -1.0, math.inf
    for block in range(lists.start.shape[0] - 1):
        for c in range(lists.start[block], lists.start[block + 1]):
            if not is_home(lists, block, c, x.shape[1]):
                continue
            warp, weft = yarns_of(lists, x, c)
            ww, ff, wf = dot(warp, warp), dot(weft, weft), dot(warp, weft)
            long, wide = math.sqrt(ww), math.sqrt(ff)
            s = stress_of(lists, c, long, wide)
            energy += 0.5 * (s[0] * (long - 1.0) + s[1] * (wide - 1.0) + s[2] * wf * wf)
            largest = 0.5 * (ww + ff) + math.sqrt(0.25 * (ww - ff) * (ww - ff) + wf * wf)
            stretch = max(stretch, math.sqrt(largest) - 1.0)
            for k in range(3):
                side = edge(x, lists.corners[k, c], lists.corners[(k + 1) % 3, c])
                square = dot(side, side)
                if square > 0.0:
                    shortest = min(shortest, math.sqrt(square))
    return Measured(energy, stretch, shortest)


@kernel
def tension_of_membrane(lists: MembraneLists, x: Float) -> float:
    """Return the largest force [N] of any triangle on a corner."""
    largest, k = 0.0, lists.constants
    for c in range(lists.corners.shape[1]):
        warp, weft = yarns_of(lists, x, c)
        ww, ff, wf = dot(warp, warp), dot(weft, weft), dot(warp, weft)
        long, wide = math.sqrt(ww), math.sqrt(ff)
        s = stress_of(lists, c, long, wide)
        along, across = (s[0] / long if long > 0.0 else 0.0), (s[1] / wide if wide > 0.0 else 0.0)
        on_warp = plus(times(along, warp), times(s[2] * wf, weft))
        on_weft = plus(times(across, weft), times(s[2] * wf, warp))
        first = plus(times(k[0, c], on_warp), times(k[2, c], on_weft))
        second = plus(times(k[1, c], on_warp), times(k[3, c], on_weft))
        total = plus(first, second)
        largest = max(largest, dot(first, first), dot(second, second), dot(total, total))
    return math.sqrt(largest)


@kernel
def turned_further(length: float, before: Point, now: Point) -> float:
    """Return how much longer a yarn of this length is than a linear step from `before` predicts."""
    square = dot(before, before)
    return length - dot(before, now) / math.sqrt(square) if square > 0.0 else 0.0


@kernel
def turning_of_membrane(lists: MembraneLists, x0: Float, x: Float, d: Float) -> float:
    """Return work along d (3, n) of the stress that yarns got by turning on their way from x0 to x [J]."""
    total, k = 0.0, lists.constants
    for block in range(lists.start.shape[0] - 1):
        for c in range(lists.start[block], lists.start[block + 1]):
            if not is_home(lists, block, c, x.shape[1]):
                continue
            (warp, weft), (warp0, weft0), moved = yarns_of(lists, x, c), yarns_of(lists, x0, c), yarns_of(lists, d, c)
            long, wide = math.sqrt(dot(warp, warp)), math.sqrt(dot(weft, weft))
            e, f = turned_further(long, warp0, warp), turned_further(wide, weft0, weft)
            if long > 0.0:
                total += (k[4, c] * e + k[6, c] * f) * dot(warp, moved[0]) / long
            if wide > 0.0:
                total += (k[5, c] * f + k[6, c] * e) * dot(weft, moved[1]) / wide
    return total


def stiffest(lists: MembraneLists) -> float:
    """Return the greatest stiffness of any triangle for one of its corners [N/m]."""
    k = lists.constants
    shares = np.stack([k[:2], k[2:4]])
    squares = np.square(np.concatenate([shares, shares.sum(axis=1, keepdims=True)], axis=1)).max(axis=1, initial=0.0)
    return float((k[4] * squares[0] + k[5] * squares[1] + k[7] * (squares[0] + squares[1])).max(initial=0.0))
