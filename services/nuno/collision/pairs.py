"""Which edges and triangles of a cloth are near each other: boxes of both in the cells of a grid.

Written apart from what keeps cloth from passing through cloth, in another way: cells instead of a tree over the mesh.
So a mistake there shows here.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Bool, Float, Int

Long = NDArray[np.int64]
Boxes = tuple[Float, Float]
"""Lowest and highest corners (k, 3) [m]."""
CELL = 2.0
"""Width of a grid's cells over that of the triangles' boxes: fewer, larger cells leave more pairs to be told apart."""
MOST_CELLS = 1 << 20
"""Of a grid along an axis."""
MOST_OF_ONE = 512
"""Cells that a box is looked for in: a larger one, of a triangle with a vertex far away, is held against all others."""
AT_ONCE = 1 << 16
"""Pairs of boxes that are looked at together: as many as stay in the core's cache."""
BITS = 9
"""Of a box' side in units of the whole cloth, for the first look: six of them and a bit each above fill a number."""


@dataclass(frozen=True)
class Mesh:
    """Triangles (f, 3) and edges (e, 2), each once, by vertices, and numbers (f, 3) of the edges of each triangle."""

    faces: Int
    edges: Int
    sides: Long


def mesh_of(faces: Int) -> Mesh:
    """With all edges of the triangles (f, 3)."""
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, sides = np.unique(ends, axis=0, return_inverse=True)
    return Mesh(faces, edges, sides.reshape(-1, 3).astype(np.int64))


def near_pairs(x: Float, mesh: Mesh, within: float) -> tuple[Long, Long]:
    """Numbers (k,) of edges and of triangles of a mesh x (n, 3), which must be finite, that share no vertex, and whose
    boxes are no farther apart than `within` [m] along any axis; each pair once, in order.
    """
    if not len(mesh.faces):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    (low, high), faces = boxes_of(x[mesh.edges]), boxes_of(x[mesh.faces])
    edges = low - within, high + within
    ends, corners = ([np.ascontiguousarray(each) for each in part.T] for part in (mesh.edges, mesh.faces))
    found = []
    for edge, face in _candidates(edges, faces):
        apart = np.ones(len(edge), bool)
        for one, other in itertools.product([end[edge] for end in ends], [corner[face] for corner in corners]):
            apart &= one != other
        edge, face = edge[apart], face[apart]
        near = overlap(edge, edges, face, faces)
        found.append((edge[near], face[near]))
    # A pair that is in several cells was looked at in each.
    edge, face = (np.concatenate(each) for each in zip(*found, strict=True))
    return once(edge, face, len(mesh.faces))


def boxes_of(points: Float) -> Boxes:
    """Of points (k, w, 3). Not by min(), which is slow over so few."""
    low, high = (functools.reduce(choose, points.transpose(1, 2, 0)).T for choose in (np.minimum, np.maximum))
    return low, high


def overlap(a: Long, one: Boxes, b: Long, two: Boxes) -> Bool:
    """(k,) whether boxes of one kind and of another overlap, in pairs by number."""
    found = np.ones(len(a), bool)
    for axis in range(3):
        low, high, other_low, other_high = (side[:, axis] for side in (*one, *two))
        found &= (low[a] <= other_high[b]) & (other_low[b] <= high[a])
    return found


def once(a: Long, b: Long, number: int) -> tuple[Long, Long]:
    """Each of the pairs a, b (k,) once, in order; b are below `number`."""
    both = np.sort(a * number + b)
    both = both[np.diff(both, prepend=-1) != 0]
    return both // number, both % number


def _candidates(one: Boxes, two: Boxes) -> Iterator[tuple[Long, Long]]:
    """Numbers of boxes of the one kind and of the other that overlap but for rounding, once for each cell that both
    reach into; some at a time.
    """
    low = np.minimum(one[0].min(axis=0), two[0].min(axis=0))
    size = np.maximum(one[1].max(axis=0), two[1].max(axis=0)) - low
    cell = max(CELL * float((two[1] - two[0]).max(axis=1).mean()), float(size.max()) / MOST_CELLS) or 1.0
    shape = np.floor(size / cell).astype(np.int64) + 1
    # Cells far from each other may share a place in the table: what is found too much, the boxes tell apart.
    table = 1 << (2 * len(two[0])).bit_length()
    big = _reach(one, low, cell) > MOST_OF_ONE, _reach(two, low, cell) > MOST_OF_ONE
    for k in np.flatnonzero(big[0]):
        b = np.flatnonzero((one[0][k] <= two[1]).all(axis=1) & (two[0] <= one[1][k]).all(axis=1))
        yield np.full(len(b), k), b
    for k in np.flatnonzero(big[1]):
        a = np.flatnonzero((one[0] <= two[1][k]).all(axis=1) & (two[0][k] <= one[1]).all(axis=1) & ~big[0])
        yield a, np.full(len(a), k)
    own, key = _cells(one, ~big[0], low, cell, shape, table)
    other, other_key = _cells(two, ~big[1], low, cell, shape, table)
    other = other[np.argsort(other_key, kind="stable")]
    start = np.concatenate([[0], np.cumsum(np.bincount(other_key, minlength=table))])
    scale = np.divide(2**BITS - 1, size, out=np.zeros(3), where=size > 0.0)
    (low_one, high_one), (low_two, high_two) = (
        [((side - low) * scale).astype(np.int64) for side in box] for box in (one, two)
    )
    # Six comparisons in one subtraction: of each only the bit above tells, which is lost where it is too small.
    most = 2**BITS - 1
    above = _pack(np.full((3, 1), most + 1), np.full((3, 1), most + 1))
    upper, lower = _pack(high_one.T, most - low_one.T) | above, _pack(low_two.T, most - high_two.T)
    first = start[key]
    count = start[key + 1] - first
    total = np.cumsum(count)
    parts = np.searchsorted(total, np.arange(AT_ONCE, total[-1] if len(total) else 0, AT_ONCE)).tolist()
    for begin, end in itertools.pairwise([0, *parts, len(own)]):
        part = slice(begin, end)
        a = np.repeat(own[part], count[part])
        before = total[begin] - count[begin] if begin < end else 0
        b = other[np.arange(len(a)) + np.repeat(first[part] - total[part] + count[part] + before, count[part])]
        kept = np.flatnonzero((upper[a] - lower[b]) & above == above)
        yield a[kept], b[kept]


def _pack(*numbers: Long) -> Long:
    """(k,) twice three numbers (3, k) in one."""
    packed = (number << place * (BITS + 1) for place, number in enumerate(itertools.chain(*numbers)))
    return functools.reduce(np.bitwise_or, packed)


def _reach(box: Boxes, low: Float, cell: float) -> Long:
    """(k,) into how many cells each box reaches."""
    first, last = (np.floor((corner - low) / cell).astype(np.int64) for corner in box)
    return np.asarray((last - first + 1).prod(axis=1))


def _cells(box: Boxes, kept: Bool, low: Float, cell: float, shape: Any, table: int) -> tuple[Long, Long]:
    """(m,) number of a box that is kept and (m,) place in the table of a cell that it reaches into."""
    names = np.flatnonzero(kept)
    first, last = (np.floor((corner[names] - low) / cell).astype(np.int64) for corner in box)
    count = last - first + 1
    total = count.prod(axis=1)
    number = np.repeat(np.arange(len(total)), total)
    place = np.arange(len(number)) - np.repeat(np.cumsum(total) - total, total)
    along = count[number]
    x, place = place % along[:, 0], place // along[:, 0]
    at = first[number] + np.stack([x, place % along[:, 1], place // along[:, 1]], axis=1)
    return names[number], ((at[:, 0] * shape[1] + at[:, 1]) * shape[2] + at[:, 2]) % table
