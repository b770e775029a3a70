"""Where cloth passes through cloth: every edge against every triangle that it does not belong to, exactly.

Written apart from what keeps cloth from doing so, in another way: cells of a grid instead of a tree over the mesh,
edges through triangles instead of distances, signs that are certain instead of margins. So a mistake there shows here.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Bool, Float, Int

Long = NDArray[np.int64]
CERTAIN = 7.8e-16
"""Share of its terms' sizes above which the sign of a determinant in floating point is right (Shewchuk 1997, Adaptive
precision floating-point arithmetic and fast robust geometric predicates, 4.4)."""
CELL = 2.0
"""Width of a grid's cells over that of the triangles' boxes: fewer, larger cells leave more pairs to be told apart."""
MOST_CELLS = 1 << 20
"""Of a grid along an axis."""


@dataclass(frozen=True)
class Crossings:
    """Edges (k, 2) that pass through triangles (k, 3), by vertices, and where they do, places (k, 3) [m]."""

    edges: Int
    triangles: Int
    places: Float


def edges_of(faces: Int) -> Int:
    """(e, 2) the edges of triangles (f, 3), each once."""
    return np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)


def find_crossings(x: Float, faces: Int, edges: Int) -> Crossings:
    """All that cross of a mesh x (n, 3), which must be finite; an edge that just touches counts as well."""
    edge, face = _candidates(x[edges], x[faces])
    apart = np.ones(len(edge), bool)
    for end in edges.T:
        for corner in faces.T:
            apart &= end[edge] != corner[face]
    edge, face = edge[apart], face[apart]
    through = cross(x[edges[edge]], x[faces[face]])
    # A pair that is in several cells was looked at in each.
    edge, face = np.unique(np.stack([edge[through], face[through]]), axis=1)
    ends, corners = edges[edge], faces[face]
    return Crossings(ends, corners, _places(x[ends], x[corners]))


def cross(segment: Float, triangle: Float) -> Bool:
    """(k,) whether segments (k, 2, 3) meet triangles (k, 3, 3); in one plane they are taken not to."""
    p, q = segment[:, 0], segment[:, 1]
    a, b, c = triangle[:, 0], triangle[:, 1], triangle[:, 2]
    found: Bool = np.zeros(len(p), bool)
    above, below = _side(a, b, c, p), _side(a, b, c, q)
    may = np.flatnonzero((above * below <= 0) & ((above != 0) | (below != 0)))
    turns = np.stack([_side(p[may], q[may], *(corner[may] for corner in pair)) for pair in ((a, b), (b, c), (c, a))])
    found[may] = ((turns >= 0).all(axis=0) | (turns <= 0).all(axis=0)) & (turns != 0).any(axis=0)
    return found


def _side(a: Float, b: Float, c: Float, d: Float) -> Long:
    """(k,) sign of the determinant of a - d, b - d, c - d: on which side of the plane a b c the points d lie."""
    u, v, w = a - d, b - d, c - d
    products = [(v[:, i] * w[:, j], v[:, j] * w[:, i]) for i, j in ((1, 2), (2, 0), (0, 1))]
    found = sum(u[:, k] * (one - other) for k, (one, other) in enumerate(products))
    size = sum(np.abs(u[:, k]) * (np.abs(one) + np.abs(other)) for k, (one, other) in enumerate(products))
    sign, size = np.sign(found).astype(np.int64), np.asarray(size)
    # Where all terms are nothing, as of cloth that lies flat along the axes, the determinant is: nothing is rounded.
    for i in np.flatnonzero((size > 0.0) & (np.abs(found) <= CERTAIN * size)).tolist():
        sign[i] = _exact_side(*(point[i].tolist() for point in (a, b, c, d)))
    return sign


def _exact_side(*points: list[float]) -> int:
    """The same of four points in fractions."""
    a, b, c, d = ([Fraction(value) for value in point] for point in points)
    u, v, w = ([one - other for one, other in zip(point, d, strict=True)] for point in (a, b, c))
    found = sum(u[k] * (v[k - 2] * w[k - 1] - v[k - 1] * w[k - 2]) for k in range(3))
    return (found > 0) - (found < 0)


def _places(segment: Float, triangle: Float) -> Float:
    """(k, 3) where segments meet the planes of triangles."""
    a = triangle[:, 0]
    normal = np.cross(triangle[:, 1] - a, triangle[:, 2] - a)
    above, below = (((segment[:, end] - a) * normal).sum(axis=1) for end in (0, 1))
    way = above - below
    share = np.divide(above, way, out=np.full(len(way), 0.5), where=way != 0.0)
    place: Float = segment[:, 0] + share[:, None] * (segment[:, 1] - segment[:, 0])
    return place


def _candidates(segments: Float, triangles: Float) -> tuple[Long, Long]:
    """Numbers of segments and of triangles whose boxes overlap, once for each cell that both reach into."""
    if not len(segments) or not len(triangles):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    boxes = [(_fold(np.minimum, points), _fold(np.maximum, points)) for points in (segments, triangles)]
    low = np.minimum(*(box[0].min(axis=0) for box in boxes))
    size = np.maximum(*(box[1].max(axis=0) for box in boxes)) - low
    cell = max(CELL * float((boxes[1][1] - boxes[1][0]).max(axis=1).mean()), float(size.max()) / MOST_CELLS) or 1.0
    shape = np.floor(size / cell).astype(np.int64) + 1
    (own, key), (other, other_key) = (_cells(box, low, cell, shape) for box in boxes)
    order = np.argsort(other_key, kind="stable")
    other, other_key = other[order], other_key[order]
    first, last = np.searchsorted(other_key, key, "left"), np.searchsorted(other_key, key, "right")
    count = last - first
    one = np.repeat(own, count)
    two = other[np.arange(len(one)) - np.repeat(np.cumsum(count) - count - first, count)]
    for axis in range(3):
        (low_one, high_one), (low_two, high_two) = ((box[0][:, axis], box[1][:, axis]) for box in boxes)
        kept = np.flatnonzero((low_one[one] <= high_two[two]) & (low_two[two] <= high_one[one]))
        one, two = one[kept], two[kept]
    return one, two


def _fold(choose: Any, points: Float) -> Any:
    """(k, 3) the lower or the higher of each of the points (k, w, 3), contiguous by axis; min() over so few is slow."""
    return functools.reduce(choose, points.transpose(1, 2, 0)).T


def _cells(box: tuple[Float, Float], low: Float, cell: float, shape: Any) -> tuple[Long, Long]:
    """(m,) number of a box and (m,) number of a cell that it reaches into."""
    first, last = (np.floor((corner - low) / cell).astype(np.int64) for corner in box)
    count = last - first + 1
    total = count.prod(axis=1)
    number = np.repeat(np.arange(len(total)), total)
    place = np.arange(len(number)) - np.repeat(np.cumsum(total) - total, total)
    along = count[number]
    x, place = place % along[:, 0], place // along[:, 0]
    at = first[number] + np.stack([x, place % along[:, 1], place // along[:, 1]], axis=1)
    return number, (at[:, 0] * shape[1] + at[:, 1]) * shape[2] + at[:, 2]
