"""Spring and hinge constants of a triangle mesh.

Springs. A triangle of area A whose edges have the unit directions d_i and lengths L_i stores
sum of k_i L_i^2 (d_i . e d_i)^2 / 2 under the strain e. With s_i = k_i L_i^2 / A that is the
stiffness

    warp  sum s_i dw_i^4,    weft  sum s_i df_i^4,    shear  sum s_i dw_i^2 df_i^2

per area, dw and df being the parts of d along warp and weft. Three springs, three measures: on a right triangle with
its legs along the yarns this is solved exactly, by the constants of a grid. On others the solution may be negative, and
an equilateral triangle has warp = 3 shear whatever its springs: then the s_i >= 0 minimise the sum of squared relative
errors, in which tension counts TENSION times as much as shear, because excessive stretch shows first. So tension is
exact wherever springs allow it, and on equilateral triangles shear is at least a third of the softer of warp and weft:
0.6 to 136 times the presets'. An edge's k is the sum over its triangles.

Hinges. k = B e^2 / (A1 + A2), B between those of warp and weft by the direction across the edge.
This is exact on equilateral triangles (Poisson ratio -1/3); elsewhere fold lines that the curvature
does not follow cost or save tens of per cent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_cloth.fabrics.presets import Material
from nuno_schemas.fabric import Float, Int
from nuno_schemas.vectors import dot, face_areas

TENSION = 1000.0


@dataclass(frozen=True)
class Edges:
    """Edges of a mesh.

    pairs (e, 2) vertices, the first smaller; of_face (f, 3) the edge that leaves each corner;
    inner (h,) edges with two faces; quads (h, 4) their hinges: start, end, left, right.
    count (e,) faces at each edge.
    """

    pairs: Int
    of_face: Int
    inner: Int
    quads: Int
    count: Int


def find_edges(faces: Int) -> Edges:
    """Return the edges of faces (f, 3), which must be consistently oriented for `quads`."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    opposite = np.roll(faces, -2, axis=1).reshape(-1)
    both = np.sort(np.stack([start, end], 1), axis=1)
    pairs, edge, count = np.unique(both, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    forward = start < end
    left, right = np.full((2, len(pairs)), -1, np.int32)
    left[edge[forward]], right[edge[~forward]] = opposite[forward], opposite[~forward]
    inner = np.flatnonzero((left >= 0) & (right >= 0) & (count == 2))
    quads = np.stack([pairs[inner, 0], pairs[inner, 1], left[inner], right[inner]], 1)
    return Edges(*(part.astype(np.int32) for part in (pairs, edge.reshape(-1, 3), inner, quads, count)))


ACROSS = 0.1
"""Sine of the angle to a triangle's normal below which a warp is across it, and says nothing of the yarns' way."""


def yarn_axes(corners: Float, warp: Float) -> tuple[Float, Float]:
    """Return unit warp and weft directions (f, 3): `warp` (3,) or (f, 3) laid onto triangles with corners (f, 3, 3).

    Triangles that `warp` is normal to, within ACROSS, have `second_axis(warp)` laid onto them.
    """
    first = corners[:, 1] - corners[:, 0]
    normal = np.cross(first, corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]

    def lay(axis: Float) -> Float:
        return np.asarray(axis - normal * (axis * normal).sum(1)[:, None])

    every = np.broadcast_to(warp, normal.shape)
    flat, length = lay(every), np.linalg.norm(every, axis=1)
    across = np.linalg.norm(flat, axis=1) <= ACROSS * length
    flat[across] = lay(second_axis(every / length[:, None]))[across]
    along = flat / np.linalg.norm(flat, axis=1)[:, None]
    return along, np.cross(along, normal)


def second_axis(warp: Float) -> Float:
    """Return the coordinate axes farthest from directions (..., 3), the last of several: z, of an upright one."""
    return np.asarray(np.eye(3)[2 - np.argmin(np.round(np.abs(warp), 6)[..., ::-1], axis=-1)])


def spring_stiffness(material: Material, x: Float, faces: Int, edges: Edges, warp: Float, weft: Float) -> Float:
    """Return spring constants (e,) [N/m] from the yarn directions (f, 3) of each face."""
    side = x[np.roll(faces, -1, axis=1)] - x[faces]
    length = np.linalg.norm(side, axis=2)
    unit = side / length[..., None]
    dw, df = (np.einsum("fij,fj->fi", unit, axis) ** 2 for axis in (warp, weft))
    target = np.array([material.warp, material.weft, material.shear])
    weight = np.array([TENSION, TENSION, 1.0]) / np.where(target > 0, target, target.max())
    system = np.stack([dw**2, df**2, dw * df], 1) * weight[:, None]
    s = least_squares_positive(system, np.broadcast_to(target * weight, (len(faces), 3)))
    k = s * face_areas(x[faces])[:, None] / length**2
    return np.bincount(edges.of_face.reshape(-1), k.reshape(-1), len(edges.pairs)).astype(np.float64)


def least_squares_positive(system: Float, target: Float) -> Float:
    """Return non-negative s (f, 3) that minimise |system s - target|, for systems (f, 3, 3)."""
    best = np.zeros_like(target)
    error = np.square(target).sum(1)
    for positive in ([0], [1], [2], [0, 1], [0, 2], [1, 2], [0, 1, 2]):
        part = system[:, :, positive]
        s = np.zeros_like(best)
        s[:, positive] = np.einsum("fij,fj->fi", np.linalg.pinv(part), target)
        residual = np.square(np.einsum("fij,fj->fi", system, s) - target).sum(1)
        better = (s >= 0).all(1) & (residual < error * (1 - 1e-9))
        best[better], error[better] = s[better], residual[better]
    return best


def hinge_stiffness(material: Material, x: Float, edges: Edges, area: Float, warp: Float, weft: Float) -> Float:
    """Return hinge constants (h,) [N m]; the yarn directions at an edge are the sum of its faces'."""
    total = np.zeros(len(edges.pairs))
    across = np.zeros((len(edges.pairs), 2))
    e = x[edges.pairs[:, 1]] - x[edges.pairs[:, 0]]
    for corner in range(3):
        edge = edges.of_face[:, corner]
        np.add.at(total, edge, area)
        for axis, yarn in enumerate((weft, warp)):
            np.add.at(across[:, axis], edge, np.square((e[edge] * yarn).sum(1)))
    # An edge along the weft is folded across the warp: the warp yarns bend.
    across /= across.sum(axis=1)[:, None]
    rigidity = dot(across, np.array([material.bend_warp, material.bend_weft]))
    return np.asarray((rigidity * np.square(e).sum(1) / total)[edges.inner])
