"""Pairs of near edges and triangles of a cloth, by boxes of both in the cells of a grid.

This is independent of the contact that keeps cloth from passing through cloth: cells instead of a tree over the mesh.
So a mistake there shows here.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from nuno_schemas.fabric import Float, Int

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
    # A row is a box and WIDE consecutive others of the table, the last of which may be of other cells.
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
