"""Woven cloth in its plane: triangles of constant strain in the cloth's own directions, warp and weft.

With the deformation gradient's columns F_w and F_f, what the unit vectors along warp and weft become, a triangle of
area A at rest has the strains e_w = |F_w| - 1, e_f = |F_f| - 1, g = F_w.F_f and the energy

    A (C_w e_w^2 + C_f e_f^2 + 2 C_wf e_w e_f + G g^2) / 2.

For small strains these are the engineer's strains of any measure, and g the angle by which warp and weft have sheared.
The stresses S_w = C_w e_w + C_wf e_f, S_f = C_f e_f + C_wf e_w and T = G g pull F_w with A (S_w w^ + T F_f) and F_f
with A (S_f f^ + T F_w), w^ and f^ their directions. F is linear in the corners, F_w = a (x1 - x0) + b (x2 - x0),
so is what acts on them. Damping adds D_w de_w/dt, D_f de_f/dt and D_g dg/dt to the stresses.

Lengths of yarns, not Green's strains (|F_w|^2 - 1) / 2: these are stiffer by the square of the stretch, which costs
steps, and softer where cloth is compressed: from 1 / sqrt(3) on it would give way and collapse. Shear alone is Green's,
which needs no division: its stiffness is far below that of tension.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.lanes.choose import where_not_zero
from nuno_kernels.lanes.simd import WIDTH, Lanes, Triple, add_at, load, root
from nuno_kernels.lanes.triples import dot, gather_triple, minus, plus, times
from nuno_kernels.step.blocks import Long, is_small, list_copies
from nuno_kernels.terms import register
from nuno_schemas.fabric import Float, Int, Membrane


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
    MembraneLists,
    name="membrane",
    block=add_membrane,
    reads_velocity=damps,
    energy="nuno_kernels.forces.membrane_measures:measure_membrane",
    tension="nuno_kernels.forces.membrane_measures:tension_of_membrane",
    turning="nuno_kernels.forces.membrane_measures:turning_of_membrane",
    stiffest="nuno_kernels.forces.membrane_measures:stiffest",
    rows="nuno_kernels.forces.membrane_linear:rows_of_membrane",
    elements="nuno_kernels.forces.membrane_linear:elements_of_membrane",
    constraints="nuno_kernels.forces.membrane_constraints:constraints_of_membrane",
    fill="nuno_kernels.forces.membrane_linear:fill_membrane",
    diagonal="nuno_kernels.forces.membrane_linear:sum_membrane",
    multiply="nuno_kernels.forces.membrane_linear:multiply_membrane",
    assemble="nuno_kernels.forces.membrane_linear:assemble_membrane",
)
