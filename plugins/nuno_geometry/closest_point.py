"""The closest point of a triangle mesh, with the side of it that a point lies on.

Of the four candidates of a triangle, its inside (where the foot of the perpendicular lies in it) and its
three edges, the nearest is taken. With n = (b - a) x (c - a) and p - a = s (b - a) + t (c - a) + h n,

    s = n . ((p - a) x (c - a)) / n . n,    t = n . ((b - a) x (p - a)) / n . n,

whose error grows with 1 / sin of the triangle's angle at a; the usual solution by dot products squares that.
Every candidate is a point of the triangle whatever rounding did to s and t, so that even a sliver's error
stays within its width, and a triangle without area is its edges.

The search starts with the leaf of a triangle that is thought to be near, goes up from there, and looks only at boxes
that are no farther away than the best so far. Of equally near triangles that of the lowest number is taken: the answer
does not depend on the start, the order of the search or the number of threads, to the last bit.

Weighed: libigl, trimesh and Open3D, beside which `nuno bench speed closest` measures this search. igl, with sign and in
double precision, answers an eighth as fast or less, since it makes its tree anew in every call; Open3D is in single.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numba import prange

from nuno_geometry.poses import Vector, row_at
from nuno_geometry.tree import Room, Tree, make_room, push_children
from nuno_kernels import block_kernel, forced_inline, parallel_kernel, threads_available
from nuno_kernels.lanes import (
    EVERY,
    WIDTH,
    Lanes,
    cross,
    dot,
    first_lane,
    higher,
    lane,
    lanes_up_to,
    load_triple,
    lower,
    minus,
    plus,
    splat,
    times,
    where_not_negative,
)
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

BLOCK = 256
"""queries handled together"""
FARTHEST = 1e154
"""coordinates beyond this have no square"""


@forced_inline
def leaf_distances(p: Vector, corners: Float, leaf: int) -> Lanes:
    """Return squared distances [m^2] of a point to a leaf's eight triangles, as a vector."""
    row = 9 * leaf
    zero, one = splat(0.0), splat(1.0)
    a = minus(p, load_triple(corners, row, 0))
    b, c = load_triple(corners, row + 3, 0), load_triple(corners, row + 6, 0)
    d, e, bb, bc, cc = dot(b, a), dot(c, a), dot(b, b), dot(b, c), dot(c, c)
    n = cross(b, c)
    det, u, v = dot(n, n), dot(n, cross(a, c)), dot(n, cross(b, a))
    # Edge a-b, edge a-c, edge b-c; a quotient of an edge without length is NaN, which `higher` makes 0.
    off = minus(a, times(lower(higher(d / bb, zero), one), b))
    least = dot(off, off)
    off = minus(a, times(lower(higher(e / cc, zero), one), c))
    least = lower(dot(off, off), least)
    t = lower(higher((e - bc - (d - bb)) / (bb - 2.0 * bc + cc), zero), one)
    off = minus(minus(a, times(one - t, b)), times(t, c))
    least = lower(dot(off, off), least)
    off = minus(minus(a, times(u / det, b)), times(v / det, c))
    return where_not_negative(lower(lower(u, v), det - u - v), lower(dot(off, off), least), least)


@forced_inline
def take_nearest(values: Lanes, leaf: int, face: Int, best: float, which: int) -> tuple[float, int]:
    """Return (squared distance, place) of the best so far and a leaf's eight triangles."""
    bits = lanes_up_to(values, best)
    while bits != 0:
        j = first_lane(bits)
        bits &= bits - 1
        value, at = lane(values, j), WIDTH * leaf + j
        if value < best or (value == best and face[at] < face[which]):
            best, which = value, at
    return best, which


@forced_inline
def box_distances(p: Vector, boxes: Float, node: int) -> Lanes:
    """Return squared distances [m^2] of a point to the boxes of a node's eight children, as a vector."""
    zero, row = splat(0.0), 6 * node
    below, beyond = minus(load_triple(boxes, row, 0), p), minus(p, load_triple(boxes, row + 3, 0))
    off = (
        higher(higher(below[0], beyond[0]), zero),
        higher(higher(below[1], beyond[1]), zero),
        higher(higher(below[2], beyond[2]), zero),
    )
    # A share of 64 ulp off: see nuno_geometry.tree.ROUNDING, which does not cover points that are far away.
    return dot(off, off) * (1.0 - 2.0**-46)


@forced_inline
def find_place(p: Vector, start: int, root: int, tree: Tree, room: Room, most: float = math.inf) -> int:
    """Return the place of the nearest triangle of the tree from node `root` on, starting with that in place `start`,
    which is returned if none is within a squared distance of `most` [m^2].

    The search goes up from that leaf to the root, and at each node queues those of the other children that are near
    enough: if the start is good, hardly any. Nodes on the way up are known beforehand, so that the processor works on
    several at once; on a way down each is known only after the one before. From a bad start, of whose neighbours all
    are near enough, it goes down from the root: there the nearest are distinguished first.
    """
    boxes, child, corners, face, waiting, bound = (
        tree.boxes, tree.child, tree.corners, tree.face, room.waiting, room.bound
    )  # fmt: skip
    start_leaf = start // WIDTH
    values = leaf_distances(p, corners, start_leaf)
    best, which = take_nearest(values, start_leaf, face, min(most, lane(values, start % WIDTH)), start)
    node, top = tree.leaf_parent[start_leaf], 0
    visited = 1 << (start_leaf + child[node] + 1)
    if lanes_up_to(box_distances(p, boxes, node), best) == EVERY:
        node, visited = root, 0
    while node >= 0:
        away = box_distances(p, boxes, node)
        top = push_children(away, lanes_up_to(away, best) & ~visited, child[node], waiting, bound, top)
        below, node = node, tree.parent[node]
        if node >= 0:
            visited = 1 << (below - child[node])
    while top > 0:
        top -= 1
        if bound[top] > best:
            continue
        node = waiting[top]
        if node < 0:
            leaf = -1 - node
            best, which = take_nearest(leaf_distances(p, corners, leaf), leaf, face, best, which)
        else:
            away = box_distances(p, boxes, node)
            top = push_children(away, lanes_up_to(away, best), child[node], waiting, bound, top)
    return which


@forced_inline
def clamp(value: float) -> float:
    """Clamp `value` to [0, 1]; 0 for NaN."""
    return min(value, 1.0) if value > 0.0 else 0.0


@forced_inline
def corners_of(place: int, corners: Float) -> tuple[Vector, Vector, Vector]:
    """Return a, b - a and c - a of the triangle in a place."""
    row, j = 9 * (place // WIDTH), place % WIDTH
    a, b = (
        (corners[row, j], corners[row + 1, j], corners[row + 2, j]),
        (corners[row + 3, j], corners[row + 4, j], corners[row + 5, j]),
    )
    return a, b, (corners[row + 6, j], corners[row + 7, j], corners[row + 8, j])


@forced_inline
def nearest_in(a: Vector, b: Vector, c: Vector) -> tuple[float, float, int]:
    """Return coordinates (s, t) of the closest point a + s (b - a) + t (c - a) of a triangle, and its feature: 0
    inside, 1 to 3 on the edge a-b, b-c or c-a, 4 to 6 at the corner a, b or c; p - a, b - a and c - a are given.
    """
    d, e, bb, bc, cc = dot(b, a), dot(c, a), dot(b, b), dot(b, c), dot(c, c)
    n = cross(b, c)
    det, u, v = dot(n, n), dot(n, cross(a, c)), dot(n, cross(b, a))
    best, s, t, part = math.inf, 0.0, 0.0, 4
    if min(u, v, det - u - v) >= 0.0 and det > 0.0:
        s, t, part = u / det, v / det, 0
        off = minus(minus(a, times(s, b)), times(t, c))
        best = dot(off, off)
    for edge in range(1, 4):
        if edge == 1:
            along = clamp(d / bb)
            es, et = along, 0.0
        elif edge == 2:
            along = clamp((e - bc - (d - bb)) / (bb - 2.0 * bc + cc))
            es, et = 1.0 - along, along
        else:
            es, et = 0.0, clamp(e / cc)
            along = 1.0 - et
        off = minus(minus(a, times(es, b)), times(et, c))
        value = dot(off, off)
        if value < best:
            best, s, t, part = value, es, et, edge
            if along == 0.0:
                part = 3 + edge
            elif along == 1.0:
                part = 3 + edge % 3 + 1
    return s, t, part


class Answer(NamedTuple):
    """The closest point: its triangle's place, its coordinates there (s, t), the point [m], the signed distance [m],
    and the pseudonormal there, of any length.
    """

    place: int
    s: float
    t: float
    point: Vector
    distance: float
    normal: Vector


@forced_inline
def closest(p: Vector, start: int, root: int, tree: Tree, room: Room) -> Answer:
    """Return the closest point of the tree from node `root` on, the search starting in place `start`."""
    face, place = tree.face, find_place(p, start, root, tree, room)
    a, b, c = corners_of(place, tree.corners)
    s, t, part = nearest_in(minus(p, a), b, c)
    q = plus(plus(a, times(s, b)), times(t, c))
    if part == 0:
        n = cross(b, c)
    elif part < 4:
        number, normals = tree.edges[face[place], part - 1], tree.edge_normals
        n = row_at(normals, number)
    else:
        number, normals = tree.faces[face[place], part - 4], tree.vertex_normals
        n = row_at(normals, number)
    d = minus(p, q)
    distance = math.sqrt(dot(d, d))
    if dot(d, n) < 0.0:
        distance = -distance
    return Answer(place, s, t, q, distance, n)


class Closest(NamedTuple):
    """Closest points of a mesh.

    point    (n, 3) [m]
    face     (n,) int32, the lowest number where several are equally near
    weights  (n, 3) barycentric coordinates in it
    distance (n,) [m], negative inside of a closed mesh
    """

    point: Float
    face: Int
    weights: Float
    distance: Float


@block_kernel
def find_block(block: int, points: Float, start: Int, tree: Tree, room: Room, found: Closest) -> None:
    """Find the closest points of a block of points (n, 3)."""
    (point, face, weights, distance), last = found, 0
    for i in range(block * BLOCK, min((block + 1) * BLOCK, points.shape[0])):
        first = tree.place[start[i]] if start[i] >= 0 else last
        near = closest(row_at(points, i), first, 0, tree, room)
        last = near.place
        point[i, 0], point[i, 1], point[i, 2] = near.point
        weights[i, 0], weights[i, 1], weights[i, 2] = 1.0 - near.s - near.t, near.s, near.t
        face[i], distance[i] = tree.face[last], near.distance


@parallel_kernel
def find_closest(points: Float, start: Int, tree: Tree, found: Closest) -> None:
    """Call `find_block` for all blocks, in parallel. numba drops a loop as dead that itself writes into a tuple."""
    for block in prange((points.shape[0] + BLOCK - 1) // BLOCK):
        find_block(block, points, start, tree, make_room(), found)


def closest_points(tree: Tree, points: Float, start: Int | None = None, threads: int | None = None) -> Closest:
    """Return the closest points of a mesh to points (n, 3) [m].

    `start` (n,) are the triangles that the search begins with, as of the last time: a good guess bounds it, and a bad
    one costs time only. By default each point's is that of the point before. `threads`: all by default; the same bits
    with any. Raises BadInput for points that are not finite.
    """
    points = np.ascontiguousarray(points, np.float64)
    bad = ~(np.abs(points) <= FARTHEST).all(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        raise BadInput("not a finite position", field=f"points[{first}]", value=points[first].tolist())
    n = len(points)
    begin = np.full(n, -1, np.int32) if start is None else np.ascontiguousarray(start, np.int32)
    found = Closest(np.empty((n, 3)), np.empty(n, np.int32), np.empty((n, 3)), np.empty(n))
    available = threads_available()[0]
    numba.set_num_threads(max(1, min(threads or available, available)))
    find_closest(points, begin, tree, found)
    return found
