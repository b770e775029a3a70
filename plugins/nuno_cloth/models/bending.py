"""Bending of a triangle mesh: measured rigidities along warp and weft, and any Poisson's ratio, whatever the mesh.

Over a triangle and all that touch its corners (nuno_cloth.models.patches) the surface is approximated by the quadratic
function that fits best, with weights (1 + r)^-3, r the distance from the triangle's middle over the side of an
equilateral triangle as large. Its second derivatives K (warp, weft, twist) are linear in the vertices, and the
triangle, of area A, has the energy of an orthotropic plate,

    A K^T D K / 2,   D = (B_w, B_1, 0; B_1, B_f, 0; 0, 0, 4 B_t),

with B_1 = nu sqrt(B_w B_f), and B_t from the rigidity measured along the bias, or as if the cloth, stretched by (B_f /
B_w)^(1/4), were isotropic: 2 B_t = (1 - nu) sqrt(B_w B_f).

The fit's residual r is not curvature, and without a cost of its own cloth could fold to and fro between vertices nearly
freely. It costs A FIT sqrt(B_w B_f) times the weighted mean of r^2 over the fourth power of the side, 0 where the
surface is quadratic, so that constant curvature stays exact (the stabilisation of virtual elements: Beirao da Veiga et
al. 2013, Math. Models Methods Appl. Sci. 23, 199-214). With FIT = 130 the lowest frequencies squared of a free square
plate with 12 edges a side are within 5 % on any mesh, and a heavy strip of 16 clamped edges drops 1 to 2 % too far.
Half as much leaves 5 and 4 %, and twice as much is as far off to the other side, with steps that are half as long.

Few vertices, or vertices on two lines, do not determine all curvatures. The singular values s of the fit say which,
over the root of the sum of squared weights and with the patch stretched until it spreads alike in all directions: 0.4
on grids, 0.23 and more on patterns that are cut and meshed, 0 of a ribbon one cell wide. Curvatures of s < WEAK, whose
errors grow as 1 / s and the matrix as 1 / s^2, are unknowns c that minimise the energy instead, in which the part of
the fit's coefficient y that c does not explain costs (y - s c)^2 as the residual does, times 1 / (1 - (s / WEAK)^2). At
s = WEAK this is the fit, and at s = 0 the curvature is free: a ribbon one cell wide curls up across, and two pieces
that share a vertex turn freely. The matrix is bounded on any mesh and a continuous function of its vertices.

Ribbons one triangle wide, whose vertices are all on borders, have a law of their own (nuno_cloth.models.ribbons).

Rejected: hinges, k = B e^2 / (A_1 + A_2), 0.89 to 1.10 of B by the mesh, and with no choice of Poisson's ratio; the
quadratic through a triangle's and its neighbours' six vertices, 0.67 of B where diagonals alternate; weak curvatures
as 0, 1.11 of B for an isotropic ribbon one cell wide along the bias.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_cloth.fabrics.material import Materials
from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.patches import find_patches, flip_slivers
from nuno_cloth.models.ribbons import bend_ribbons
from nuno_schemas.fabric import Bending, Bool, Float, Int

NEAR, STEEP = 1.0, 3
FIT = 130.0
WEAK = 0.22
"""Singular values, over the root of the sum of squared weights, below which a patch does not determine a curvature:
below the least of patterns that are cut and meshed here."""
WIDEST = 20.0
"""Largest radius of a patch over the length by which weights fall off, which bounds the weights of slivers."""
AT_ONCE = 8192
"""Triangles whose matrices are in memory at a time."""


def plate(material: Material) -> Float:
    """Return the plate's matrix D (3, 3) [N m]."""
    warp, weft = material.bend_warp, material.bend_weft
    both = material.bend_poisson * np.sqrt(warp * weft)
    return np.array([[warp, both, 0.0], [both, weft, 0.0], [0.0, 0.0, 4.0 * material.bend_twist]])


def build_bending(
    material: Material | Materials, corners: Float, faces: Int, warp: Float, weft: Float, held: Bool
) -> Bending | None:
    """Build the bending matrix of triangles with corners (f, 3, 3) [m], flat once unfolded, yarn directions (f, 3) and
    vertices faces (f, 3); `held` (n,) marks held vertices. None where no vertex can bend.
    """
    n, cloth = len(held), Materials.spread(material, len(faces))
    sides = flip_slivers(corners, faces, np.column_stack([cloth.fabric_index, warp, weft]))
    faces = sides.faces
    rigidity = np.array([plate(fabric) for fabric in cloth.fabrics])
    clamp = find_clamp(faces, held)
    loose = np.flatnonzero(~clamp.faces).astype(np.int32)
    if not rigidity.any() or n < 4 or not len(loose):
        return None
    parts = []
    for narrow, vertices, matrix in bend_ribbons(sides, clamp.faces, warp, weft, rigidity[cloth.fabric_index]):
        loose = np.setdiff1d(loose, narrow)
        parts.append(_pairs(vertices, -matrix, n))
    for at in range(0, len(loose), AT_ONCE):
        triangles = loose[at : at + AT_ONCE]
        part = find_patches(sides, triangles, warp[triangles], weft[triangles])
        middle, base = part.flat[:, :3].mean(axis=1, keepdims=True), clamp.base(part.vertices, part.flat, part.there)
        side = np.sqrt(4.0 / np.sqrt(3.0) * part.area)
        flat, base, stiffness = part.flat - middle, base - middle, rigidity[cloth.fabric_index[triangles]]
        fitted = fit(flat, base, part.there, side, stiffness)
        cost = FIT * np.sqrt(stiffness[:, 0, 0] * stiffness[:, 1, 1])[:, None, None]
        matrix = np.einsum("fak,fab,fbl->fkl", fitted.second, stiffness, fitted.second, optimize=True)
        matrix += cost * np.einsum("frk,frl->fkl", fitted.left, fitted.left)
        parts.append(_pairs(part.vertices, -part.area[:, None, None] * matrix, n))
    keys, weights = _sum_alike(*(np.concatenate(values) for values in zip(*parts, strict=True)))
    return Bending(np.stack(np.divmod(keys, n), axis=1).astype(np.int32), weights)


class Fit(NamedTuple):
    """Linear maps from heights of a patch's vertices to the first derivatives (f, 2, k) of the fitted quadratic
    function along warp and weft [1/m], to its second ones (f, 3, k) along warp, weft and between them [1/m^2], and to
    its residuals (f, k, k), weighted and over the square of the side [1/m^2].
    """

    first: Float
    second: Float
    left: Float


class Clamp(NamedTuple):
    """A clamp: its triangles (f,), whose vertices are all held, the vertices (n,) behind its edge, which touch no other
    triangle, and those on its edge (n,).
    """

    faces: Bool
    behind: Bool
    edge: Bool

    def base(self, vertices: Int, flat: Float, there: Bool) -> Float:
        """Return the points (f, k, 2) from which the surface is straight up to each vertex of patches at flat (f, k,
        2): for vertices in a clamp its edge, where curvature begins with a jump, for others the vertex itself.
        """
        base, behind = flat.copy(), self.behind[vertices] & there
        some = np.flatnonzero(behind.any(axis=1))
        far = np.linalg.norm(flat[some, :, None] - flat[some, None], axis=3)
        far[np.broadcast_to(~(self.edge[vertices[some]] & there[some])[:, None], far.shape)] = np.inf
        nearest = np.take_along_axis(flat[some], far.argmin(axis=2)[..., None], axis=1)
        base[some] = np.where(behind[some][..., None] & np.isfinite(far.min(axis=2))[..., None], nearest, base[some])
        return base


def find_clamp(faces: Int, held: Bool) -> Clamp:
    """Return the clamp of triangles (f, 3), of whose vertices (n,) some are held."""
    rigid: Bool = np.all(held[faces], axis=1)
    loose, behind = (np.isin(np.arange(len(held)), faces[part]) for part in (~rigid, rigid))
    return Clamp(rigid, behind & ~loose, behind & loose)


def fit(flat: Float, base: Float, there: Bool, side: Float, rigidity: Float) -> Fit:
    """Fit a quadratic function to patches with vertices at flat (f, k, 2) [m] along weft and warp from the point where
    it is evaluated; `there` (f, k) masks padding, `side` (f,) is the length [m] by which weights fall off, `rigidity`
    (f, 3, 3) is D [N m]. A vertex with another `base` is on the tangent there.
    """
    side = np.maximum(side, np.where(there, np.linalg.norm(flat, axis=2), 0.0).max(axis=1) / WIDEST)
    places, base = flat / side[:, None, None], base / side[:, None, None]
    weight = np.where(there, (NEAR + np.linalg.norm(places, axis=2)) ** (-STEEP / 2), 0.0)
    (weft, warp), (weft0, warp0) = np.moveaxis(places, 2, 0), np.moveaxis(base, 2, 0)
    plane = np.stack([np.ones_like(warp), warp, weft], axis=2) * weight[..., None]
    squares = warp0 * (warp - 0.5 * warp0), weft0 * (weft - 0.5 * weft0), warp0 * weft + weft0 * warp - warp0 * weft0
    curved = np.stack(squares, axis=2) * weight[..., None]
    # Planes first, so that they add no curvature even where too few vertices determine all curvatures.
    level, upper = np.linalg.qr(plane)
    bent = curved - level @ (level.transpose(0, 2, 1) @ curved)
    u, size, v = np.linalg.svd(bent, full_matrices=False)
    number, total = np.eye(weight.shape[1]), np.sqrt(np.square(weight).sum(axis=1))
    shape = _stretch_to_even(upper, total)
    clear = np.linalg.svd(bent @ shape, compute_uv=False)
    inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    second = (v.transpose(0, 2, 1) * inverse[:, None, :]) @ u.transpose(0, 2, 1)
    explained = np.concatenate([level, u], axis=2)
    residual = number - explained @ explained.transpose(0, 2, 1)
    weak = np.flatnonzero(clear[:, 2] < WEAK * total)
    second[weak], residual[weak] = _fit_weak(bent[weak], shape[weak], level[weak], total[weak], rigidity[weak])
    slopes = np.linalg.solve(upper, level.transpose(0, 2, 1) @ (number - curved @ second))[:, 1:]
    residual /= total[:, None, None]
    scale, length = weight[:, None, :], side[:, None, None]
    return Fit(slopes * scale / length, second * scale / length**2, residual * scale / length**2)


def _fit_weak(bent: Float, shape: Float, level: Float, total: Float, rigidity: Float) -> tuple[Float, Float]:
    """Return the maps of weighted heights to second derivatives (f, 3, k) and residuals (f, k, k) where some are weak,
    of singular values below WEAK. `bent` (f, k, 3) are weighted heights of unit curvatures without their
    planes, which are `level` (f, k, 3).
    """
    u, size, v = np.linalg.svd(bent @ shape, full_matrices=False)
    share, coefficient = size / total[:, None], u.transpose(0, 2, 1)
    weak = share < WEAK
    gain = np.where(weak, 1.0 / np.maximum(1.0 - np.square(share / WEAK), np.finfo(float).eps), 1.0)
    way = shape @ v.transpose(0, 2, 1)
    length = np.linalg.norm(way, axis=1)
    way, size = way / length[:, None, :], size / length
    stiffness = rigidity / np.maximum(rigidity.max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    pull = FIT * np.sqrt(stiffness[:, 0, 0] * stiffness[:, 1, 1])[:, None] * gain * size / np.square(total)[:, None]
    matrix = way.transpose(0, 2, 1) @ stiffness @ way + (pull * size)[:, :, None] * np.eye(3)
    # Cloth without rigidity along one yarn may have many minima of energy: the pseudo-inverse takes one.
    inverse = np.linalg.pinv(np.where(weak[:, :, None], matrix, np.eye(3)))
    curvature = inverse @ (np.divide(1.0, size, out=pull, where=~weak)[:, :, None] * coefficient)
    explained = np.concatenate([level, u * ~weak[:, None, :]], axis=2)
    beyond = np.sqrt(gain)[:, :, None] * (coefficient - size[:, :, None] * curvature) - coefficient
    residual = np.eye(u.shape[1]) - explained @ explained.transpose(0, 2, 1) + (u * weak[:, None, :]) @ beyond
    return way @ curvature, residual


def _stretch_to_even(upper: Float, total: Float) -> Float:
    """Return the map (f, 3, 3) to curvatures along warp and weft and between them from those of a patch that is
    stretched until its weighted vertices spread alike in all directions, by the triangular factor of their planes.
    """
    (a, c), (b, d) = np.moveaxis(np.linalg.inv(upper[:, 1:, 1:]) * total[:, None, None], 0, 2)
    columns = (a * a, b * b, a * b), (c * c, d * d, c * d), (2.0 * a * c, 2.0 * b * d, a * d + b * c)
    return np.asarray(np.moveaxis(np.array(columns), 2, 0).transpose(0, 2, 1) * [1.0, 1.0, np.sqrt(0.5)])


def _pairs(vertices: Int, matrix: Float, n: int) -> tuple[Int, Float]:
    """Return keys i n + j of pairs of different vertices i < j, and the sums of their entries in matrices (f, k, k)."""
    first, second = np.triu_indices(vertices.shape[1], 1)
    low, high = vertices[:, first].astype(np.int64), vertices[:, second].astype(np.int64)
    keys, weights = np.minimum(low, high) * n + np.maximum(low, high), matrix[:, first, second]
    different = low != high
    return _sum_alike(keys[different], weights[different])


def _sum_alike(keys: Int, weights: Float) -> tuple[Int, Float]:
    unique, inverse = np.unique(keys, return_inverse=True)
    return unique, np.bincount(inverse, weights, len(unique)).astype(np.float64)
