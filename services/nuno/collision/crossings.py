"""Crossings of cloth with cloth: exact tests of edges against triangles that they do not belong to.

This is independent of the contact that prevents crossings: edges through triangles instead of distances, exact signs
instead of margins. So a mistake there shows here.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from nuno.collision.pairs import Long, Mesh, near_pairs
from nuno_schemas.fabric import Bool, Float, Int

CERTAIN = 7.8e-16
"""Share of its terms' sizes above which the sign of a determinant in floating point is exact (Shewchuk 1997, Adaptive
precision floating-point arithmetic and fast robust geometric predicates, 4.4)."""
DOUBT = 1e-13
"""Share of the terms above which a distance along an axis is more than rounding."""


@dataclass(frozen=True)
class Crossings:
    """Edges (k, 2) that pass through triangles (k, 3), by vertices, and the places (k, 3) [m]."""

    edges: Int
    triangles: Int
    places: Float


def find_crossings(x: Float, mesh: Mesh, pairs: tuple[Long, Long] | None = None) -> Crossings:
    """Return the crossings of a mesh x (n, 3), in pairs of edges and triangles by number, by default in all; an edge
    that only touches counts as well.
    """
    edge, face = near_pairs(x, mesh, 0.0) if pairs is None else pairs
    through = cross(x[mesh.edges[edge]], x[mesh.faces[face]])
    ends, corners = mesh.edges[edge[through]], mesh.faces[face[through]]
    return Crossings(ends, corners, _places(x[ends], x[corners]))


def cross(segment: Float, triangle: Float) -> Bool:
    """Return whether segments (k, 2, 3) meet triangles (k, 3, 3), shape (k,); coplanar ones do not."""
    a, b, c = (triangle[:, i] for i in range(3))
    (above, doubt), (below, other) = (_determinant(a, b, c, segment[:, end]) for end in (0, 1))
    doubtful = (np.abs(above) <= doubt) | (np.abs(below) <= other)
    uncertain = np.flatnonzero(doubtful)
    uncertain = uncertain[_not_clearly_apart(segment[uncertain], triangle[uncertain])]
    near = np.concatenate([np.flatnonzero((above * below <= 0.0) & ~doubtful), uncertain])
    crosses: Bool = np.zeros(len(segment), bool)
    crosses[near] = _cross(segment[near], triangle[near])
    return crosses


def _not_clearly_apart(segment: Float, triangle: Float) -> Long:
    """Return the numbers of pairs that no plane across the triangle, along one of its sides or the segment, clearly
    separates: separated pairs are those of flat cloth, whose signs would be 0 without rounding.
    """
    left = np.arange(len(segment))
    corners = np.concatenate([triangle, segment], axis=1) - triangle[:, :1]
    normal = np.cross(corners[:, 1], corners[:, 2])
    for start, end in ((0, 1), (1, 2), (2, 0), (3, 4)):
        points = corners[left]
        axis = np.cross(normal[left], points[:, end] - points[:, start])
        along = np.einsum("kpi,ki->pk", points, axis)
        doubt = DOUBT * np.abs(points).max(axis=(1, 2)) * np.abs(axis).sum(axis=1)
        (low, high), (lower, higher) = ((part.min(axis=0), part.max(axis=0)) for part in (along[:3], along[3:]))
        left = left[(low - higher <= doubt) & (lower - high <= doubt)]
    return left


def _cross(segment: Float, triangle: Float) -> Bool:
    """Do `cross` by exact signs."""
    p, q = segment[:, 0], segment[:, 1]
    a, b, c = triangle[:, 0], triangle[:, 1], triangle[:, 2]
    crosses: Bool = np.zeros(len(p), bool)
    above, below = _side(a, b, c, p), _side(a, b, c, q)
    near = np.flatnonzero((above * below <= 0) & ((above != 0) | (below != 0)))
    turns = np.stack([_side(p[near], q[near], *(corner[near] for corner in pair)) for pair in ((a, b), (b, c), (c, a))])
    crosses[near] = ((turns >= 0).all(axis=0) | (turns <= 0).all(axis=0)) & (turns != 0).any(axis=0)
    return crosses


def _side(a: Float, b: Float, c: Float, d: Float) -> Long:
    """Return the sign (k,) of the determinant of a - d, b - d, c - d: the side of the plane a b c of points d."""
    determinant, doubt = _determinant(a, b, c, d)
    sign = np.sign(determinant).astype(np.int64)
    # Terms that are all 0 are exact: they occur everywhere in cloth that lies flat along an axis.
    for i in np.flatnonzero((np.abs(determinant) <= doubt) & (doubt > 0.0)).tolist():
        sign[i] = _exact_side(*(point[i].tolist() for point in (a, b, c, d)))
    return sign


def _determinant(a: Float, b: Float, c: Float, d: Float) -> tuple[Float, Float]:
    """Return determinants (k,) of a - d, b - d, c - d, and the size (k,) below which their signs may be wrong."""
    u, v, w = a - d, b - d, c - d
    products = [(v[:, i] * w[:, j], v[:, j] * w[:, i]) for i, j in ((1, 2), (2, 0), (0, 1))]
    determinant = sum(u[:, k] * (one - other) for k, (one, other) in enumerate(products))
    size = sum(np.abs(u[:, k]) * (np.abs(one) + np.abs(other)) for k, (one, other) in enumerate(products))
    return np.asarray(determinant), CERTAIN * np.asarray(size)


def _exact_side(*points: list[float]) -> int:
    """Return the sign of the determinant of four points, in fractions."""
    a, b, c, d = ([Fraction(value) for value in point] for point in points)
    u, v, w = ([one - other for one, other in zip(point, d, strict=True)] for point in (a, b, c))
    determinant = sum(u[k] * (v[k - 2] * w[k - 1] - v[k - 1] * w[k - 2]) for k in range(3))
    return (determinant > 0) - (determinant < 0)


def _places(segment: Float, triangle: Float) -> Float:
    """Return the points (k, 3) where segments meet the planes of triangles."""
    a = triangle[:, 0]
    normal = np.cross(triangle[:, 1] - a, triangle[:, 2] - a)
    above, below = (((segment[:, end] - a) * normal).sum(axis=1) for end in (0, 1))
    difference = above - below
    share = np.divide(above, difference, out=np.full(len(difference), 0.5), where=difference != 0.0)
    place: Float = segment[:, 0] + share[:, None] * (segment[:, 1] - segment[:, 0])
    return place
