"""The membrane's matrix: each triangle's part as a 6 x 6 matrix on its F_w and F_f.

Of the energy's second derivative there are, times the area and with the damping's part of each modulus, C_w + rate D_w,

    H_ww = C_w w^ w^T + a_w (1 - w^ w^T) + G F_f F_f^T,     a_w = S_w / |F_w|,
    H_wf = C_wf w^ f^T + G F_f F_w^T + T,

and H_ff like H_ww. Stress across the yarns, a_w and T, is indefinite where cloth is compressed or sheared: a_w is cut
off at `floor`, as of springs (nuno_kernels.forces.linear), and T left out where the matrix is to be positive. a_w is by
the stress that the length F0_w.F_w / |F0_w| brings, F0 before the step.
"""

from __future__ import annotations

from typing import Any

from nuno_kernels import kernel
from nuno_kernels.forces.linear_layout import LinearLists, Rows, linear_lists, listed_elements
from nuno_kernels.forces.membrane import (
    MembraneLists,
    Yarns,
    at_corners,
    direction,
    sides,
    spread_to_corners,
    stresses,
    stretched,
)
from nuno_kernels.lanes.choose import higher, lower, where_not_zero
from nuno_kernels.lanes.simd import WIDTH, Lanes, Triple, load, splat, store
from nuno_kernels.lanes.triples import dot, load_triple, plus, times
from nuno_schemas.fabric import Float

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
    """Add triangles to a matrix that is to be factorised: see nuno_kernels.forces.assembly."""
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
