"""Margins of cloth from bodies: how far off vertices are kept, so that no triangle between them enters."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from nuno_contact.quantities import Reach
from nuno_geometry.normals import face_normals, vertex_normals
from nuno_kernels import kernel
from nuno_schemas.bodies import CAPSULE, OF_TRIANGLES, Geometry
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.vectors import face_areas

# Let q = sum_i b_i x_i be a point of a triangle with sides of at most L. For any point a
#
#     |q - a|^2 = sum_i b_i |x_i - a|^2 - sum_i b_i |x_i - q|^2,
#
# and the last sum is at most S = L^2 / 3. Let a body be a union of balls of radius r, those about the same middles with
# the radius r / c cover it and all its corners, and each x_i be at least m from the body. Then it is r + m from each
# middle, and q is not in the body if (r + m)^2 - S >= (r / c)^2.
#
# A capsule has c = 1 and its own r. Where a vertex of a mesh has a normal at the angle phi to those of its triangles, a
# ball that touches the triangles has c = cos phi, and any r up to the body's own: m is least for r = c^2 sqrt(S) /
# sin phi, and is sqrt(S) sin phi then. A corner of a box, with c^2 = 1 / 3, is an example: an equilateral triangle at
# the margin touches it. A plane needs no margin.

Margin = Reach | Literal["auto"]
"""a margin in the scene: a length [m], or as much as triangles and bodies need"""
STRETCHED = 1.05
"""Length of a triangle's side in motion over that at the start, which a margin allows for."""
SHARPER = 0.1
"""share of the convex part of a mesh, by area, that may be rounder or sharper than a margin allows for"""
FLAT = 1e-6
"""difference of unit normals that is no more than rounding"""


@kernel
def round_margin(spread: float, radius: float, cosine: float) -> float:
    """Return the margin [m] of a vertex whose triangles have the spread S [m^2]. The body contains balls of any radius
    up to `radius` [m], and balls of that radius over `cosine` about the same middles cover it.
    """
    if cosine < 1.0:
        radius = min(radius, cosine * cosine * math.sqrt(spread / (1.0 - cosine * cosine)))
    return math.sqrt(radius * radius / (cosine * cosine) + spread) - radius


def triangle_spread(x: Float, faces: Int) -> Float:
    """Return S of each vertex, a third of the square of the longest side of its triangles, stretched (n,) [m^2], 0
    without any; x (n, 3) [m], faces (f, 3).
    """
    corners, spread = x[faces], np.zeros(len(x))
    square = np.square(corners - np.roll(corners, 1, axis=1)).sum(axis=2).max(axis=1, initial=0.0)
    np.maximum.at(spread, faces.reshape(-1), np.repeat(STRETCHED**2 * square / 3.0, 3))
    return spread


def roundness(x: Float, faces: Int) -> tuple[float, float]:
    """Return `radius` [m] and `cosine` of `round_margin` for a mesh, x (n, 3) [m], faces (f, 3).

    All but SHARPER of its convex part have at least this radius of curvature, the way from a triangle's middle to a
    vertex over the normal's turn on it, and at most this angle between both normals. A plate has half its thickness.
    """
    way, size, convex = _turns(x, faces)
    if not convex.any():
        return 0.0, FLAT
    share = np.repeat(face_areas(x[faces])[:, None], 3, axis=1)[convex]

    def beyond(values: Float) -> float:
        ascending = np.argsort(values)
        sums = np.cumsum(share[ascending])
        return float(values[ascending][np.searchsorted(sums, SHARPER * sums[-1])])

    cosine = max(beyond(1.0 - 0.5 * size[convex] ** 2), FLAT)
    return min(beyond(way[convex] / size[convex] ** 2) * cosine, thinness(x)), cosine


def local_roundness(x: Float, faces: Int) -> Float:
    """Return of each vertex 1 / radius [1/m] and 1 - cosine (n, 2) of `round_margin`, 0 where a mesh is not convex; the
    largest of its triangles, as `roundness` has them of the whole mesh.
    """
    found = np.zeros((len(x), 2))
    way, size, convex = _turns(x, faces)
    turned = np.minimum(0.5 * size[convex] ** 2, 1.0 - FLAT)
    np.maximum.at(found[:, 0], faces[convex], size[convex] ** 2 / (way[convex] * (1.0 - turned)))
    np.maximum.at(found[:, 1], faces[convex], turned)
    return found


def _turns(x: Float, faces: Int) -> tuple[Float, Float, Bool]:
    """Return of each triangle's corners (f, 3) the way from its middle to the corner times the normal's turn on it [m],
    the turn's size, and whether the mesh is convex there.
    """
    corners, sums = x[faces], vertex_normals(x, faces)
    unit = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), FLAT)
    turn = unit[faces] - face_normals(x, faces)[:, None]
    size = np.linalg.norm(turn, axis=2)
    way = np.einsum("fki,fki->fk", corners - corners.mean(axis=1, keepdims=True), turn)
    return way, size, (size > FLAT) & (way > 0.0)


def thinness(x: Float) -> float:
    """Return half the extent [m] of a mesh's vertices x (n, 3) along the axis in which they vary least."""
    away = x - x.mean(axis=0)
    return 0.5 * float(np.ptp(away @ np.linalg.svd(away, full_matrices=False)[2][2]))


def mesh_margins(spread: Float, x: Float, faces: Int) -> Float:
    """Return the margins (n,) [m] of vertices of `spread` (n,) [m^2] from a mesh x, faces."""
    sizes, which = np.unique(spread, return_inverse=True)
    shape = roundness(x, faces)
    return np.array([round_margin(size, *shape) for size in sizes.tolist()])[which]


def check_margin(margin: float, geometry: Geometry) -> None:
    """Raise BadInput for a margin as thick as a limb: cloth would stand off like a hoop."""
    limbs = np.where(geometry.kind == CAPSULE, geometry.radius, np.inf)
    for primitive in np.flatnonzero(np.isin(geometry.kind, OF_TRIANGLES)).tolist():
        limbs[primitive] = thinness(geometry.mesh(primitive)[0])
    if margin >= limbs.min(initial=np.inf):
        body = geometry.bodies[geometry.body[limbs.argmin()]]
        limit = f"less than the thinnest limb of {body}, {limbs.min():.4g} m"
        raise BadInput("the margin is as thick as a limb", field="margin", value=f"{margin:g} m", limit=limit,
                       remedy="a few millimetres, or auto")  # fmt: skip
