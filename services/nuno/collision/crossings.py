"""Crossings of cloth with cloth: exact tests of edges against triangles that they do not belong to.

This is independent of the contact that prevents crossings: edges through triangles instead of distances, exact signs
instead of margins. So a mistake there shows here. A compiled search leaves the pairs that no plane keeps clearly apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from typing import Any

import numpy as np

from nuno.plugin_contract import registry
from nuno_schemas.fabric import Bool, Float, Int

CERTAIN = 7.8e-16
"""Share of its terms' sizes above which the sign of a determinant in floating point is exact (Shewchuk 1997, Adaptive
precision floating-point arithmetic and fast robust geometric predicates, 4.4)."""


@cache
def compiled() -> Any:
    """Return the contact that comes with nuno, for the parts of this check that are compiled:
    nuno_contact/crossings.py, and the bending of skins.
    """
    return registry.load("nuno.cloth_contacts", "offset")


@dataclass(frozen=True)
class Crossings:
    """Edges (k, 2) that pass through triangles (k, 3), by vertices, and the places (k, 3) [m]."""

    edges: Int
    triangles: Int
    places: Float


@dataclass(frozen=True)
class Mesh:
    """Triangles (f, 3) and edges (e, 2), each once, by vertices."""

    faces: Int
    edges: Int

    @cached_property
    def near(self) -> Any:
        """Return the compiled search for near pairs."""
        return compiled().near_pairs(self.edges, self.faces)


def mesh_of(faces: Int) -> Mesh:
    """Build the mesh of triangles (f, 3), with all their edges."""
    return Mesh(faces, np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0))


def near_pairs(x: Float, mesh: Mesh, within: float) -> tuple[Int, Int]:
    """Return numbers (k,) of edges and triangles without a common vertex of a mesh x (n, 3), which must be finite, each
    pair once: all that are at most `within` [m] apart along each axis of space, and some others.
    """
    edge, face = mesh.near.at(x, within)
    return edge, face


def find_crossings(x: Float, mesh: Mesh, pairs: tuple[Int, Int] | None = None) -> Crossings:
    """Return the crossings of a mesh x (n, 3), in pairs of edges and triangles by number, by default in all; an edge
    that only touches counts as well.
    """
    return look(x, mesh, near_pairs(x, mesh, 0.0) if pairs is None else pairs, 0.0)[0]


def look(x: Float, mesh: Mesh, pairs: tuple[Int, Int], within: float) -> tuple[Crossings, float | None]:
    """Return the crossings of a mesh x (n, 3) in pairs of edges and triangles by number that share no vertex, in order,
    and the least distance [m] of all pairs, 0 for crossings; None for `within` or more.
    """
    doubtful, least = mesh.near.examine(x, *pairs, within)
    edge, face = (number[doubtful] for number in pairs)
    through = cross(x[mesh.edges[edge]], x[mesh.faces[face]])
    edge, face = edge[through], face[through]
    order = np.lexsort((face, edge))
    ends, corners = mesh.edges[edge[order]], mesh.faces[face[order]]
    distance = 0.0 if len(order) else least if least < within else None
    return Crossings(ends, corners, _places(x[ends], x[corners])), distance


def cross(segment: Float, triangle: Float) -> Bool:
    """Return whether segments (k, 2, 3) meet triangles (k, 3, 3), shape (k,), by exact signs; coplanar ones do not."""
    p, q = segment[:, 0], segment[:, 1]
    a, b, c = triangle[:, 0], triangle[:, 1], triangle[:, 2]
    crosses: Bool = np.zeros(len(p), bool)
    above, below = _side(a, b, c, p), _side(a, b, c, q)
    near = np.flatnonzero((above * below <= 0) & ((above != 0) | (below != 0)))
    turns = np.stack([_side(p[near], q[near], *(corner[near] for corner in pair)) for pair in ((a, b), (b, c), (c, a))])
    crosses[near] = ((turns >= 0).all(axis=0) | (turns <= 0).all(axis=0)) & (turns != 0).any(axis=0)
    return crosses


def _side(a: Float, b: Float, c: Float, d: Float) -> Int:
    """Return the sign (k,) of the determinant of a - d, b - d, c - d: the side of the plane a b c of points d."""
    determinant, doubt = _determinant(a, b, c, d)
    sign = np.sign(determinant).astype(np.int32)
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
    return np.asarray(segment[:, 0] + share[:, None] * (segment[:, 1] - segment[:, 0]))
