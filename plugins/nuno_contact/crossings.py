"""Edges that are near to triangles, those that may go through, and the least distance, and how often closed meshes go
round points: the collision service's check.

It shares nothing with the contact that prevents crossings but the comparison of sixteen boxes: not its tree, nor its
lists, its windows of time, its planes or its closest points. So a mistake there shows here.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nuno_contact.offset.tree import less, more
from nuno_geometry.poses import Vector, row_at
from nuno_kernels import block_kernel, forced_inline
from nuno_kernels.boxes import NUMBERS, SIXTEEN, having, meeting, stand_up, unite, write_chosen
from nuno_kernels.lanes import cross, dot, first_lane, minus, plus, times
from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Bool, Float, Int

# Boxes of edges and of triangles in whole numbers, in sixteens of neighbours; and boxes round these, two levels of
# them for triangles, so that what is near to sixteen edges is found by few comparisons of sixteen boxes.

LARGEST, NOWHERE = 16000, 16500
"""Largest coordinate in whole numbers, and the lowest one, and the highest one turned in sign, of a box that meets
none."""
SOME, FARTHEST = 256, 4.0
"""Number of vertices that show where cloth is; times their median distance, beyond which numbers grow no more."""
ROOM = 16
"""Pairs for each triangle that there is room for at first."""
SMALLEST = 1e-300
"""Least size of cloth [m], and what products that underflow are off by, at most."""
Shorts = NDArray[np.int16]


def _patches(part: Long, place: Float) -> list[Long]:
    """Cut elements at medians along the widest axis of their places (k, 3) into patches of sixteen, one of the rest."""
    if len(part) <= SIXTEEN:
        return [part]
    middle = SIXTEEN * -(-len(part) // (2 * SIXTEEN))
    part = part[np.argsort(place[part, np.ptp(place[part], axis=0).argmax()], kind="stable")]
    return _patches(part[:middle], place) + _patches(part[middle:], place)


def _sixteens(x: Float, corners: Int) -> tuple[Int, Int]:
    """Return numbers (g, 16) of elements with vertices (k, w) of x (n, 3), -1 for none, and their vertices (g, 48): the
    first of each, the second, the last; n for none.
    """
    number = np.full(-(-len(corners) // SIXTEEN) * SIXTEEN, -1, np.int32)
    number[: len(corners)] = np.concatenate(_patches(np.arange(len(corners)), x[corners].mean(axis=1)))
    three = np.where(number[:, None] < 0, len(x), corners[:, [0, 1, -1]][number]).astype(np.int32)
    return number.reshape(-1, SIXTEEN), three.reshape(-1, SIXTEEN, 3).swapaxes(1, 2).reshape(-1, 3 * SIXTEEN)


class NearPairs:
    """Near edges (e, 2) and triangles (f, 3), of vertices in one frame after the other.

    number (g, 16), corner (g, 48)  of sixteens of edges, then of triangles, as _sixteens has them where they are seen
                                    first
    first (5,)                      first sixteen of triangles, of boxes round theirs, of boxes round those, of boxes
                                    round sixteens of edges, and their end b
    parent (p,)                     row of the box round each of the first sixteens
    row (16 b, 16), box (b, 192)    boxes of them all, and the same side by side (nuno_kernels.boxes)
    """

    def __init__(self, edges: Int, faces: Int) -> None:
        self.edges, self.faces = (np.ascontiguousarray(each, np.int32) for each in (edges, faces))
        self.found = np.empty((2, 0), np.int32)

    def _begin(self, x: Float) -> None:
        both = [_sixteens(x, corners) for corners in (self.edges, self.faces)]
        self.number, self.corner = (np.concatenate(each) for each in zip(*both, strict=True))
        edges, faces = (len(number) for number, _ in both)
        above = -(-faces // SIXTEEN)
        self.first = np.cumsum([edges, faces, above, -(-above // SIXTEEN), -(-edges // SIXTEEN)])
        counts = zip(self.first[[3, 1, 2]], (edges, faces, above), strict=True)
        self.parent = np.concatenate([SIXTEEN * at + np.arange(count) for at, count in counts])
        self.row = np.empty((SIXTEEN * self.first[-1], SIXTEEN), np.int16)
        self.box = np.empty((self.first[-1], NUMBERS * SIXTEEN), np.int16)
        self.found = np.empty((2, ROOM * (len(self.faces) + 1)), np.int32)

    def at(self, x: Float, within: float) -> tuple[Int, Int]:
        """Return numbers (k,) of edges and triangles without a common vertex, each pair once: all that are at most
        `within` [m] apart along each axis of space, at x (n, 3), which must be finite, and some others.
        """
        if not len(self.edges) or not len(self.faces):
            return self.found[0], self.found[1]
        if not self.found.size:
            self._begin(x)
        some = x[:: 1 + len(x) // SOME]
        middle = np.median(some, axis=0)
        size = FARTHEST * float(np.median(np.abs(some - middle).max(axis=1))) + within
        units = LARGEST / max(size, SMALLEST)
        off, room = (x - middle) * units, 0.5 * within * units + 1.0
        way = np.full((len(x) + 1, SIXTEEN), NOWHERE, np.int16)
        for column, numbers in ((0, off), (6, -off)):  # beyond the largest number boxes still meet each other
            way[:-1, column : column + 3] = np.floor(numbers - room).clip(-LARGEST, LARGEST - 1)
        way[:, 3:6], way[:, 9:12] = way[:, :3], way[:, 6:9]
        rest = self.edges, self.number, self.corner, self.parent, self.first, self.row, self.box
        while (number := find(way, *rest, self.found)) < 0:
            self.found = np.empty((2, 2 * self.found.shape[1]), np.int32)
        edge, face = self.found[:, :number].copy()
        return edge, face

    def examine(self, x: Float, edge: Int, face: Int, within: float) -> tuple[Bool, float]:
        """Return which pairs, by number (k,), of vertices x (n, 3) are not clearly apart, shape (k,), and the least
        distance [m] of all, as if none crossed; `within` at most.
        """
        doubtful = np.empty(len(edge), np.bool_)
        return doubtful, float(examine(x, self.edges, self.faces, edge, face, within, doubtful))


@block_kernel
def fit(way: Shorts, corner: Int, parent: Long, row: Shorts, box: Shorts) -> None:
    """Fit all boxes to those of vertices, `way` (n + 1, 16), the last of none."""
    row[SIXTEEN * corner.shape[0] :] = NOWHERE
    for g in range(box.shape[0]):
        for k in range(SIXTEEN * g, SIXTEEN * g + SIXTEEN if g < corner.shape[0] else 0):
            i = k - SIXTEEN * g
            unite(way, corner[g, i], corner[g, i + SIXTEEN], corner[g, i + 2 * SIXTEEN], row, k)
        stand_up(row, SIXTEEN * g, box, g)
        for k in range(SIXTEEN * g, SIXTEEN * g + SIXTEEN if g < parent.shape[0] else 0):
            unite(row, parent[g], k, k, row, parent[g])


@block_kernel
def find(
    way: Shorts, edges: Int, number: Int, corner: Int, parent: Long, first: Long,
    row: Shorts, box: Shorts, found: Int,
) -> int:  # fmt: skip
    """Write pairs whose boxes meet into found (2, c); return their number, -1 if there is too little room."""
    fit(way, corner, parent, row, box)
    at, room = 0, found.shape[1] - SIXTEEN
    for g in range(first[0]):
        for top in range(first[2], first[3]):
            over = meeting(row, parent[g], box, top)
            while over != 0:
                middle = first[1] + SIXTEEN * (top - first[2]) + first_lane(over)
                over &= over - 1
                below = meeting(row, parent[g], box, middle)
                while below != 0:
                    h = first[0] + SIXTEEN * (middle - first[1]) + first_lane(below)
                    below &= below - 1
                    ours = meeting(row, parent[h], box, g)
                    while ours != 0:
                        lane = first_lane(ours)
                        ours &= ours - 1
                        met = meeting(row, SIXTEEN * g + lane, box, h)
                        if met == 0:
                            continue
                        if at > room:
                            return -1
                        e = number[g, lane]
                        met &= ~having(corner, h, edges[e, 0], edges[e, 1])
                        at = write_chosen(met, number, h, e, found, at)
    return at


# What planes keep apart by more than rounding does not cross, and by more than a distance is not as near.

DOUBT = 1e-13
"""Share of the terms above which a distance along an axis is more than rounding."""
PARALLEL = 1e-12
"""Square of the sine between two edges below which their ends are used: the error is a millionth of their length."""
SURE = 1.0 + 1e-9
"""Factor over a distance that covers its rounding."""
NEAR, APART, FAR = 0, 1, 2


@forced_inline
def largest(a: Vector) -> float:
    """Return the largest coordinate, without its sign."""
    return more(more(abs(a[0]), abs(a[1])), abs(a[2]))


@forced_inline
def beside(axis: Vector, p: Vector, q: Vector, b: Vector, c: Vector, size: float, reach: float) -> int:
    """Return whether an edge p q is clearly beside a triangle 0 b c along an axis, and by more than `reach`; size: of
    the largest coordinate.
    """
    s, t, u, v = dot(axis, p), dot(axis, q), dot(axis, b), dot(axis, c)
    gap = more(less(s, t) - more(more(u, v), 0.0), less(less(u, v), 0.0) - more(s, t))
    gap -= DOUBT * size * (abs(axis[0]) + abs(axis[1]) + abs(axis[2])) + SMALLEST
    if gap <= 0.0:
        return NEAR
    return FAR if gap * gap > reach * reach * dot(axis, axis) else APART


@forced_inline
def part(p: Vector, q: Vector, b: Vector, c: Vector, reach: float) -> int:
    """Return whether an edge p q and a triangle 0 b c are clearly apart, and by more than `reach`: along the normal,
    which parts most, between their middles, across the edge and a side, or in the triangle's plane across one.
    """
    size = more(more(largest(p), largest(q)), more(largest(b), largest(c)))
    n = cross(b, c)
    most = beside(n, p, q, b, c, size, reach)
    if most == FAR:
        return most
    most = max(most, beside(minus(plus(p, q), times(2.0 / 3.0, plus(b, c))), p, q, b, c, size, reach))
    along = minus(q, p)
    for first in (along, n):
        for side in (b, c, minus(c, b)):
            if most == FAR:
                return most
            most = max(most, beside(cross(first, side), p, q, b, c, size, reach))
    return most if most == FAR else max(most, beside(cross(n, along), p, q, b, c, size, reach))


@forced_inline
def above(p: Vector, b: Vector, c: Vector) -> float:
    """Return the distance of a point p above the inside of a triangle 0 b c; inf from others."""
    n = cross(b, c)
    square, d = dot(n, n), minus(c, b)
    inside = dot(cross(b, p), n) >= 0.0 and dot(cross(d, minus(p, b)), n) >= 0.0 and dot(cross(p, c), n) >= 0.0
    return abs(dot(p, n)) / math.sqrt(square) if inside and square > 0.0 else np.inf


@forced_inline
def from_edge(p: Vector, v: Vector) -> float:
    """Return the distance of a point p from an edge 0 v."""
    square, along = dot(v, v), dot(p, v)
    share = along / square if along > 0.0 else 0.0
    share = share if share < 1.0 else 1.0
    off = minus(p, times(share, v))
    return math.sqrt(dot(off, off))


@forced_inline
def across(p: Vector, q: Vector, a: Vector, b: Vector) -> float:
    """Return the distance of edges p q and a b."""
    u, v, r = minus(q, p), minus(b, a), minus(p, a)
    # The shortest line ends inside both edges where s u - t v + r is perpendicular to both.
    uu, uv, vv, ur, vr = dot(u, u), dot(u, v), dot(v, v), dot(u, r), dot(v, r)
    det, s, t = uu * vv - uv * uv, uv * vr - vv * ur, uu * vr - uv * ur
    if det > PARALLEL * uu * vv and s > 0.0 and s < det and t > 0.0 and t < det:
        n = cross(u, v)
        nearest: float = abs(dot(r, n)) / math.sqrt(dot(n, n))
        return nearest
    return min(from_edge(r, v), from_edge(minus(q, a), v), from_edge(minus(a, p), u), from_edge(minus(b, p), u))


@block_kernel
def examine(x: Float, edges: Int, faces: Int, edge: Int, face: Int, within: float, doubtful: Bool) -> float:
    """Write which edges and triangles in pairs, by number (k,), are not clearly apart; return the least distance [m] of
    all, as if none crossed, `within` at most.

    That of an edge from a triangle is that of vertices from triangles and of edges from edges, except for pairs whose
    neighbours all share vertices, as a corner of cloth and the triangle next to it.
    """
    nearest = within
    for r in range(edge.shape[0]):
        e, f = edge[r], face[r]
        a = row_at(x, faces[f, 0])
        p, q = minus(row_at(x, edges[e, 0]), a), minus(row_at(x, edges[e, 1]), a)
        b, c, o = minus(row_at(x, faces[f, 1]), a), minus(row_at(x, faces[f, 2]), a), (0.0, 0.0, 0.0)
        parted = part(p, q, b, c, SURE * nearest)
        doubtful[r] = parted == NEAR
        if parted != FAR and within > 0.0:
            for ends in ((o, b), (b, c), (c, o)):
                nearest = less(across(p, q, ends[0], ends[1]), nearest)
            nearest = less(less(above(p, b, c), above(q, b, c)), nearest)
    return nearest


# How often a closed mesh goes round points: so many times more a ray along x leaves it than enters it. Points
# are listed by the cells of a grid, so that a triangle tests only those of the cells that it covers.
#
# Which side of an edge a ray passes is computed from the edge's ends in the order of their numbers, and so with the
# same bits for both of its triangles: a ray that hits an edge or a vertex crosses exactly one.

MOST_CELLS = 250
"""Most cells of the grid of points along an axis, whose numbers are short: NumPy sorts those in a tenth of the time."""


@forced_inline
def is_left(y: float, z: float, i: int, j: int, x: Float) -> bool:
    """Return whether a ray along x at y and z passes to the left of the edge from vertex i to vertex j."""
    a, b = min(i, j), max(i, j)
    left = (x[b, 1] - x[a, 1]) * (z - x[a, 2]) - (x[b, 2] - x[a, 2]) * (y - x[a, 1]) >= 0.0
    return bool(left == (i < j))


@block_kernel
def add_turns(at: Float, first: Long, low: Float, size: float, shape: Long, x: Float, faces: Int, turns: Long) -> None:
    """Add to turns (n,) how often a mesh x (v, 3), faces (f, 3) goes round points (3, n). The points are in the order
    of a grid over y and z, of `shape` cells of `size` from `low` on: cell k has those from first[k] to first[k + 1].
    """
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        a, b, c = row_at(x, i), row_at(x, j), row_at(x, k)
        x1, y0, z0 = more(more(a[0], b[0]), c[0]), less(less(a[1], b[1]), c[1]), less(less(a[2], b[2]), c[2])
        y1, z1 = more(more(a[1], b[1]), c[1]), more(more(a[2], b[2]), c[2])
        rows = max(int((y0 - low[0]) / size), 0), min(int((y1 - low[0]) / size), shape[0] - 1)
        columns = max(int((z0 - low[1]) / size), 0), min(int((z1 - low[1]) / size), shape[1] - 1)
        for row in range(rows[0], rows[1] + 1 if columns[0] <= columns[1] else 0):
            for p in range(first[row * shape[1] + columns[0]], first[row * shape[1] + columns[1] + 1]):
                y, z = at[1, p], at[2, p]
                if at[0, p] > x1 or y < y0 or y > y1 or z < z0 or z > z1:
                    continue
                left = is_left(y, z, i, j, x)
                if left == is_left(y, z, j, k, x) and left == is_left(y, z, k, i, x):
                    n = cross(minus(b, a), minus(c, a))
                    if dot(minus((at[0, p], y, z), a), n) * n[0] < 0.0:
                        turns[p] += 1 if left else -1


def find_turns(points: Float, x: Float, faces: Int) -> Long:
    """Return how often a closed mesh x (v, 3), faces (f, 3) goes round points (n, 3), all finite: (n,), 0 outside."""
    turns, at = np.zeros(len(points), np.int64), np.ascontiguousarray(points.T)
    if not len(points):
        return turns
    low, wide = at[1:].min(axis=1), np.ptp(at[1:], axis=1)
    size = max(math.sqrt(wide.prod() / len(points)), float(wide.max()) / MOST_CELLS) or 1.0
    shape = (wide / size).astype(np.int64) + 1
    cell = ((at[1] - low[0]) / size).astype(np.uint16) * shape[1] + ((at[2] - low[1]) / size).astype(np.uint16)
    order = np.argsort(cell.astype(np.uint16), kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=shape.prod()))])
    found = turns.copy()
    add_turns(at[:, order], first, low, size, shape, x, faces, found)
    turns[order] = found
    return turns
