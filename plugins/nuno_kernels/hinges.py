"""Bending between two triangles that share an edge: energy k (1 - cos(theta - rest)).

Edge e = x1 - x0, opposite vertices x2 (left) and x3 (right), normals n1 = e x (x2 - x0) and
n2 = (x3 - x0) x e, both up for a flat counter-clockwise pair. theta is 0 when flat and positive
when the triangles fold towards their normals (a valley).

Both normals are perpendicular to e, so x3's height over the left triangle, n1.(x3 - x0)/|n1|, and
its distance from the edge, |n2|/|e|, give

    sin theta = n1.(x3 - x0) |e| / (|n1| |n2|),    cos theta = n1.n2 / (|n1| |n2|)

and the moment k sin(theta - rest) needs no angle. Where x2 or x3 moves along its normal, theta
grows by the inverse of its distance from the edge; x0 and x1 share the reaction like a lever
(Bridson et al. 2003; Tamstorf & Grinspun 2013), with t = (x - x0).e/|e|^2:

    grad2 = |e|/|n1|^2 n1,  grad3 = |e|/|n2|^2 n2,
    grad1 = -(t2 grad2 + t3 grad3),  grad0 = -(grad1 + grad2 + grad3)

A cosine, not a square: the second derivative k cos(theta - rest) never exceeds k, and a fully
folded hinge has no jump. A triangle without area has no normal: its hinge exerts no force.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.blocks import Long, block_count, local_targets, owned_copies, pad_lists
from nuno_kernels.simd import WIDTH, add_at, gather, load, root, where_greater, where_not_zero
from nuno_schemas.fabric import Float, Hinges, Int

FLAT = 1e-20
"""Squared sine of a triangle's angle at x0 below which rounding alone decides its normal."""


class HingeLists(NamedTuple):
    """Hinges by index, padded to whole vectors by hinges without area.

    start     (blocks + 1,) int64  places of each block's hinges
    corners   (8, p) int32         vertices x0..x3, then their columns in the block's forces
    constants (2, p) float64       k cos(rest) and k sin(rest) [N m]
    """

    start: Long
    corners: Int
    constants: Float


@kernel
def cross(a: Any, b: Any) -> Any:
    """a x b of two triples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def dot(a: Any, b: Any) -> Any:
    """a.b of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def corner(x: Any, corners: Any, which: int, p: int) -> Any:
    """Positions of one corner of eight hinges."""
    return gather(x, 0, corners, which, p), gather(x, 1, corners, which, p), gather(x, 2, corners, which, p)


@kernel
def add_hinges(block: int, x: Any, force: Any, start: Any, corners: Any, constants: Any) -> None:
    """Add a block's hinges to its forces (3, w)."""
    for p in range(start[block], start[block + 1], WIDTH):
        x0, x1 = corner(x, corners, 0, p), corner(x, corners, 1, p)
        x2, x3 = corner(x, corners, 2, p), corner(x, corners, 3, p)
        e = (x1[0] - x0[0], x1[1] - x0[1], x1[2] - x0[2])
        d2 = (x2[0] - x0[0], x2[1] - x0[1], x2[2] - x0[2])
        d3 = (x3[0] - x0[0], x3[1] - x0[1], x3[2] - x0[2])
        n1, n2 = cross(e, d2), cross(d3, e)
        ee, q1, q2 = dot(e, e), dot(n1, n1), dot(n2, n2)
        i1 = where_greater(q1, FLAT * ee * dot(d2, d2), 1.0 / q1)
        i2 = where_greater(q2, FLAT * ee * dot(d3, d3), 1.0 / q2)
        i1, i2 = where_greater(i2, 0.0 * i1, i1), where_greater(i1, 0.0 * i2, i2)
        edge, inverse = root(ee), root(i1 * i2)
        moment = (load(constants, 0, p) * (dot(n1, d3) * edge) - load(constants, 1, p) * dot(n1, n2)) * inverse
        w2, w3 = moment * edge * i1, moment * edge * i2
        along = where_not_zero(ee, 1.0 / ee)
        t2, t3 = dot(d2, e) * along, dot(d3, e) * along
        for row in range(3):
            f2, f3 = w2 * n1[row], w3 * n2[row]
            f1 = t2 * f2 + t3 * f3
            add_at(force, row, corners, 4, p, f2 + f3 - f1)
            add_at(force, row, corners, 5, p, f1)
            add_at(force, row, corners, 6, p, 0.0 - f2)
            add_at(force, row, corners, 7, p, 0.0 - f3)


def pack_hinges(hinges: Hinges | None, vertices: int) -> HingeLists | None:
    """Kernel layout of a fabric's hinges, or None where there are none."""
    if hinges is None or hinges.number == 0:
        return None
    quads = hinges.quads().astype(np.int64)
    order = np.lexsort((quads.max(axis=1), quads.min(axis=1)))
    quads = np.ascontiguousarray(quads[order].T)
    k, rest = hinges.per_hinge(hinges.k)[order], hinges.per_hinge(hinges.rest)[order]
    element, bounds = owned_copies(quads, block_count(vertices))
    element, start = pad_lists(element, bounds, WIDTH)
    filled = element >= 0
    target = local_targets(np.where(filled, quads[:, element], -1), start, vertices)
    corners = np.concatenate([np.where(filled, quads[:, element], 0), target]).astype(np.int32)
    constants = np.where(filled, np.stack([k * np.cos(rest), k * np.sin(rest)])[:, element], 0.0)
    return HingeLists(start, corners, np.ascontiguousarray(constants))


def hinge_angles(position: Float, quads: Int) -> Float:
    """(h,) angles [rad] in (-pi, pi] of hinges (h, 4) at positions (n, 3): 0 flat, positive a valley.

    A hinge with a triangle without area has angle 0.
    """
    x0, x1, x2, x3 = (position[quads[:, c]] for c in range(4))
    e = x1 - x0
    n1, n2 = np.cross(e, x2 - x0), np.cross(x3 - x0, e)
    sine = (n1 * (x3 - x0)).sum(axis=1) * np.sqrt((e * e).sum(axis=1))
    return np.asarray(np.arctan2(sine, (n1 * n2).sum(axis=1)))
