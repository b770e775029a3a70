"""Crossings of cloth with cloth: exact tests of edges against triangles that they do not belong to.

This is independent of the contact that prevents crossings: edges through triangles instead of distances, exact signs
instead of margins. So a mistake there shows here.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import sqrt
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

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
    return np.asarray(segment[:, 0] + share[:, None] * (segment[:, 1] - segment[:, 0]))


# Pairs of near edges and triangles of a cloth, by boxes of both in the cells of a grid.
#
# This is independent of the contact that keeps cloth from passing through cloth: cells instead of a tree over the mesh.
# So a mistake there shows here.

Long = NDArray[np.int64]
Boxes = tuple[Float, Float]
"""Lower and upper bounds along each of d axes (d, k) [m]."""
DIAGONALS = np.array([[1, 1, 0], [1, -1, 0], [1, 0, 1], [1, 0, -1], [0, 1, 1], [0, 1, -1]], np.float64)
"""Axes between those of space: with both, boxes are 18-DOPs (Klosowski et al. 1998, Efficient collision detection using
bounding volume hierarchies of k-DOPs), which fit oblique cloth more tightly."""
ROUNDING = 1e-14
"""Bound on the rounding of a position along a diagonal, as a share of the largest coordinate."""
CELL = 2.0
"""Width of a grid's cells over that of the triangles' boxes: fewer, larger cells leave more pairs to test."""
MOST_CELLS = 1 << 20
"""Most cells of a grid along an axis."""
MOST_OF_ONE = 512
"""Most cells of a box: a larger one, of a triangle with a distant vertex, is compared with all others."""
WIDE = 8
"""Boxes of a cell that one box is compared with at once."""
AT_ONCE = 1 << 12
"""Number of these comparisons in one batch, which fits into the core's cache."""
ROOM, FRAMES = 0.5, 3.0
"""Extra distance of kept pairs, as a share of the triangles' width, if they then last for this many frames."""
BITS = 9
"""Bits of a box's side in units of the whole cloth, for the first test: six with a spare bit each fill an integer."""


@dataclass(frozen=True)
class Mesh:
    """Triangles (f, 3) and edges (e, 2), each once, by vertices, and numbers (f, 3) of the edges of each triangle."""

    faces: Int
    edges: Int
    sides: Long


def mesh_of(faces: Int) -> Mesh:
    """Build the mesh of triangles (f, 3), with all their edges."""
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, sides = np.unique(ends, axis=0, return_inverse=True)
    return Mesh(faces, edges, sides.reshape(-1, 3).astype(np.int64))


def near_pairs(x: Float, mesh: Mesh, within: float) -> tuple[Long, Long]:
    """Return numbers (k,) of edges and of triangles of a mesh x (n, 3), which must be finite, that share no vertex and
    are at most `within` [m] apart along each axis of space and DIAGONALS; each pair once, in order.
    """
    empty = np.zeros(0, np.int64)
    if not len(mesh.faces) or not len(mesh.edges):
        return empty, empty
    (low, high), faces = boxes_of(x.T, mesh.edges), boxes_of(x.T, mesh.faces)
    edges = low - within, high + within
    ends, corners = ([np.ascontiguousarray(each) for each in part.T] for part in (mesh.edges, mesh.faces))
    found, near_edges, near_faces = [(empty, empty)], _reaching(edges, faces), _reaching(faces, edges)
    for a, b in _candidates(_some(edges, near_edges), _some(faces, near_faces)):
        edge, face = near_edges.take(a), near_faces.take(b)
        apart = np.ones(len(edge), bool)
        for one, other in itertools.product(
            [end.take(edge) for end in ends], [corner.take(face) for corner in corners]
        ):
            apart &= one != other
        left = np.flatnonzero(apart)
        found.append(overlap(edge.take(left), edges, face.take(left), faces))
    edge, face = (np.concatenate(each) for each in zip(*found, strict=True))
    # A pair in several cells was found in each.
    return _along_diagonals(x, mesh, once(edge, face, len(mesh.faces)), within)


class NearPairs:
    """Near pairs of a mesh over many frames, faster than `near_pairs` where little moves: from the pairs within a
    larger distance, until a vertex has moved half of the difference.
    """

    def __init__(self, mesh: Mesh, within: float) -> None:
        self.mesh, self.within = mesh, within
        self.found_at, self.last, self.room, self.wide = np.zeros((0, 3)), np.zeros((0, 3)), 0.0, np.nan
        self.pairs = np.zeros(0, np.int64), np.zeros(0, np.int64)

    def at(self, x: Float) -> tuple[Long, Long]:
        """Return `near_pairs` at x (n, 3)."""
        if len(x) != len(self.found_at) or 2.0 * _farthest(x, self.found_at) > self.room:
            if np.isnan(self.wide):
                low, high = boxes_of(x.T, self.mesh.faces)
                self.wide = ROOM * float((high - low).max(axis=0).mean()) if len(self.mesh.faces) else 0.0
            pace = _farthest(x, self.last) if len(x) == len(self.last) else np.inf
            self.room = self.wide if 2.0 * FRAMES * pace <= self.wide else 0.0
            self.found_at, self.pairs = x.copy(), near_pairs(x, self.mesh, self.within + self.room)
        self.last = x.copy()
        return self.pairs if self.room == 0.0 else _nearer(x, self.mesh, self.pairs, self.within)


def _farthest(x: Float, from_there: Float) -> float:
    """Return the largest displacement of a vertex [m], including rounding."""
    d = x - from_there
    return sqrt(float(np.einsum("ki,ki->k", d, d).max(initial=0.0))) + ROUNDING * float(np.abs(x).max(initial=0.0))


def _nearer(x: Float, mesh: Mesh, pairs: tuple[Long, Long], within: float) -> tuple[Long, Long]:
    """Return the pairs that are at most `within` apart along each axis."""
    edges, faces = boxes_of(x.T, mesh.edges), boxes_of(x.T, mesh.faces)
    near = overlap(pairs[0], (edges[0] - within, edges[1] + within), pairs[1], faces)
    return _along_diagonals(x, mesh, near, within)


def _along_diagonals(x: Float, mesh: Mesh, pairs: tuple[Long, Long], within: float) -> tuple[Long, Long]:
    """Return the pairs that are at most `within` apart along each of DIAGONALS."""
    edge, face = pairs
    room = sqrt(2.0) * within + ROUNDING * float(np.abs(x).max())
    for axis in DIAGONALS:
        along = (x @ axis)[None]
        low, high = boxes_of(along, mesh.edges)
        edge, face = overlap(edge, (low - room, high + room), face, boxes_of(along, mesh.faces))
    return edge, face


def boxes_of(along: Float, vertices: Int) -> Boxes:
    """Return the boxes of k elements with vertices (k, w), from coordinates `along` (d, n) on d axes."""
    corners = [along.take(each, axis=1) for each in vertices.T]
    return functools.reduce(np.minimum, corners), functools.reduce(np.maximum, corners)


def overlap(a: Long, one: Boxes, b: Long, two: Boxes) -> tuple[Long, Long]:
    """Return the pairs of a, b (k,) whose boxes, of two kinds, overlap."""
    for low, high, other_low, other_high in zip(*one, *two, strict=True):
        near = np.flatnonzero((low.take(a) <= other_high.take(b)) & (other_low.take(b) <= high.take(a)))
        a, b = a.take(near), b.take(near)
    return a, b


def _reaching(one: Boxes, two: Boxes) -> Long:
    """Return the numbers of boxes of one kind that overlap the bounding box of the other kind."""
    low, high = two[0].min(axis=1), two[1].max(axis=1)
    return np.flatnonzero(((one[0] <= high[:, None]) & (low[:, None] <= one[1])).all(axis=0))


def _some(boxes: Boxes, number: Long) -> Boxes:
    return boxes[0].take(number, axis=1), boxes[1].take(number, axis=1)


def once(a: Long, b: Long, number: int) -> tuple[Long, Long]:
    """Return each of the pairs a, b (k,) once, in order; b are below `number`."""
    both = np.sort(a * number + b)
    both = both[np.diff(both, prepend=-1) != 0]
    return both // number, both % number


def _candidates(one: Boxes, two: Boxes) -> Iterator[tuple[Long, Long]]:
    """Yield batches of numbers of boxes of both kinds that overlap up to rounding, at least once for each cell that
    both overlap.
    """
    if not one[0].size or not two[0].size:
        return
    low = np.minimum(one[0].min(axis=1), two[0].min(axis=1))
    size = np.maximum(one[1].max(axis=1), two[1].max(axis=1)) - low
    cell = max(CELL * float((two[1] - two[0]).max(axis=0).mean()), float(size.max()) / MOST_CELLS) or 1.0
    shape = np.floor(size / cell).astype(np.int64) + 1
    # Distant cells may share an entry of the table: the boxes exclude the extra pairs.
    table = 1 << (2 * two[0].shape[1]).bit_length()
    (own, key, big), (other, other_key, other_big) = (_cells(box, low, cell, shape, table) for box in (one, two))
    for k in big:
        b = np.flatnonzero((one[0][:, k, None] <= two[1]).all(axis=0) & (two[0] <= one[1][:, k, None]).all(axis=0))
        yield np.full(len(b), k), b
    for k in other_big:
        a = np.flatnonzero((one[0] <= two[1][:, k, None]).all(axis=0) & (two[0][:, k, None] <= one[1]).all(axis=0))
        yield a, np.full(len(a), k)
    if not len(other):
        return
    other = other[np.argsort(other_key)]
    number = np.bincount(other_key, minlength=table)
    first, count = (np.cumsum(number) - number)[key], -(-number // WIDE)[key]
    scale = np.divide(2**BITS - 1, size, out=np.zeros(3), where=size > 0.0)[:, None]
    (low_one, high_one), (low_two, high_two) = (
        [((side - low[:, None]) * scale).astype(np.int64) for side in box] for box in (one, two)
    )
    # Six comparisons in one subtraction: the bit above each is the result, and is cleared where it is too small.
    most = 2**BITS - 1
    above = _pack(np.full((3, 1), most + 1), np.full((3, 1), most + 1))
    upper, lower = _pack(high_one, most - low_one) | above, _pack(low_two, most - high_two)
    # A row is a box and WIDE consecutive others of the table; the last may be of other cells.
    other = np.resize(other, len(other) + WIDE)
    rows = np.ascontiguousarray(sliding_window_view(lower[other], WIDE))
    total = np.cumsum(count)
    parts = np.searchsorted(total, np.arange(AT_ONCE, total[-1] if len(total) else 0, AT_ONCE)).tolist()
    for begin, end in itertools.pairwise([0, *parts, len(own)]):
        part = slice(begin, end)
        name = np.repeat(own[part], count[part])
        before = total[begin] - count[begin] if begin < end else 0
        row = WIDE * np.arange(len(name)) + np.repeat(
            first[part] - WIDE * (total[part] - count[part] - before), count[part]
        )
        bits = rows.take(row, axis=0)
        np.subtract(upper.take(name)[:, None], bits, out=bits)
        bits &= above
        kept = np.flatnonzero(bits == above)
        at = kept // WIDE
        yield name.take(at), other.take(row.take(at) - WIDE * at + kept)


def _pack(*numbers: Long) -> Long:
    """Pack twice three numbers (3, k) into integers (k,)."""
    packed = (number << place * (BITS + 1) for place, number in enumerate(itertools.chain(*numbers)))
    return functools.reduce(np.bitwise_or, packed)


def _cells(box: Boxes, low: Float, cell: float, shape: Any, table: int) -> tuple[Long, Long, Long]:
    """Return the number (m,) of a box and the entry (m,) in the table of a cell that it overlaps; and the numbers of
    boxes that overlap too many cells.
    """
    first, last = (np.floor((corner - low[:, None]) / cell).astype(np.int64) for corner in box)
    wide = last - first + 1
    total = wide.prod(axis=0)
    big = np.flatnonzero(total > MOST_OF_ONE)
    total[big] = 0
    number = np.repeat(np.arange(len(total)), total)
    place, x = np.divmod(np.arange(len(number)) - (np.cumsum(total) - total)[number], wide[0, number])
    z, y = np.divmod(place, wide[1, number])
    at = (first[0] * shape[1] + first[1]) * shape[2] + first[2]
    return number, (at[number] + (x * shape[1] + y) * shape[2] + z) & (table - 1), big
