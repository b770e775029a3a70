"""Least distance of cloth from cloth: of an edge from a triangle that shares no vertex with it.

That is the least distance of vertices from triangles and of edges from edges, except for pairs whose neighbours all
share vertices, as a corner of cloth and the triangle next to it. It is independent of the solver's lists and of its
closest points: by lines and planes where the closest points are inside both, and by the ends of edges.
"""

from __future__ import annotations

import functools

import numpy as np

from nuno.collision.pairs import Boxes, Long, Mesh, boxes_of, once, overlap
from nuno_schemas.fabric import Float

PARALLEL = 1e-12
"""Square of the sine between two edges below which their ends are used: the error is a millionth of their length."""
SURE = 1.0 + 1e-9
"""Factor over a distance for edges' boxes, which covers rounding."""


def least_distance(x: Float, mesh: Mesh, pairs: tuple[Long, Long], within: float) -> float | None:
    """Return the least distance [m] of edges from triangles of a mesh x (n, 3), in pairs by number that share no vertex
    and do not cross; None for more than `within`.
    """
    edge, face = pairs
    along = np.ascontiguousarray(x.T)
    edges, faces = boxes_of(along, mesh.edges), boxes_of(along, mesh.faces)
    vertex, below = _near(mesh.edges[edge].ravel().astype(np.int64), (along, along), face.repeat(2), faces, within)
    least = float(_above(x[vertex], x[mesh.faces[below]]).min(initial=np.inf))
    one, two = edge.repeat(3), mesh.sides[face].ravel()
    one, two = _near(np.minimum(one, two), edges, np.maximum(one, two), edges, min(within, SURE * least))
    least = min(least, _across(x[mesh.edges[one]], x[mesh.edges[two]]))
    return least if least <= within else None


def _near(a: Long, boxes: Boxes, b: Long, others: Boxes, within: float) -> tuple[Long, Long]:
    """Return the pairs of a, b (k,) whose boxes are at most `within` apart, each once."""
    return once(*overlap(a, (boxes[0] - within, boxes[1] + within), b, others), others[0].shape[1])


def to_triangles(p: Float, triangle: Float) -> Float:
    """Return distances (k,) of points p (k, 3) from triangles (k, 3, 3)."""
    a, b, c = (triangle[:, i] for i in range(3))
    return functools.reduce(np.minimum, (_to_edge(p, a, b), _to_edge(p, b, c), _to_edge(p, c, a)), _above(p, triangle))


def _above(p: Float, triangle: Float) -> Float:
    """Return distances (k,) of points p (k, 3) above the inside of triangles (k, 3, 3); inf from others."""
    a, b, c = (triangle[:, i] for i in range(3))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    inside = size > 0.0
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= _dot(np.cross(end - start, p - start), normal) >= 0.0
    above: Float = np.divide(np.abs(_dot(p - a, normal)), size, out=np.full(len(p), np.inf), where=inside)
    return above


def _across(one: Float, two: Float) -> float:
    """Return the least distance of edges (k, 2, 3) from edges; inf for none."""
    (p, q), (a, b) = (edge.transpose(1, 0, 2) for edge in (one, two))
    least = min(float(_to_edge(*ends).min(initial=np.inf)) for ends in ((p, a, b), (q, a, b), (a, p, q), (b, p, q)))
    # The shortest line ends inside both edges where s (q - p) - t (b - a) + p - a is perpendicular to both.
    u, v, r = q - p, b - a, p - a
    uu, uv, vv, ur, vr = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, r), _dot(v, r)
    det = uu * vv - uv * uv
    s, t = uv * vr - vv * ur, uu * vr - uv * ur
    inside = (det > PARALLEL * uu * vv) & (s > 0.0) & (s < det) & (t > 0.0) & (t < det)
    way = np.cross(u[inside], v[inside])
    distance = np.abs(_dot(r[inside], way)) / np.linalg.norm(way, axis=1)
    return min(least, float(distance.min(initial=np.inf)))


def _to_edge(p: Float, a: Float, b: Float) -> Float:
    """Return distances (k,) of points p (k, 3) from edges a b."""
    along = b - a
    size = _dot(along, along)
    share = np.divide(_dot(p - a, along), size, out=np.zeros(len(p)), where=size > 0.0).clip(0.0, 1.0)
    return np.asarray(np.linalg.norm(p - a - share[:, None] * along, axis=1))


def _dot(a: Float, b: Float) -> Float:
    return np.asarray(np.einsum("ki,ki->k", a, b))
