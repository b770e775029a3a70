"""Crossing and near pairs, by the tree of cloth contact."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from nuno_contact.offset.proximity import closest, point, unit, weigh
from nuno_contact.offset.tree import PER_TWO, MovingTree, edges_at_faces, find_pairs, less, near_leaves
from nuno_contact.untangle.contours import Cloth, Long, fit
from nuno_geometry.check import orient
from nuno_kernels import block_kernel, kernel
from nuno_schemas.fabric import Bool, Float, Int

OVER = 1.05
"""Pairs nearer than this factor on their gap are pushed that far apart, so that they end with the gap."""
LEAST_SHARE = 0.5
"""share of its distance at the start that a pair may lose which needs no gap"""


APART, CROSSING, DOUBTFUL = 0, 1, 2


@kernel
def passes_through(x: Float, p: int, q: int, face: Int) -> int:
    """Return whether the edge from vertex p to vertex q goes through a triangle of three others, within rounding; in
    one plane it does not.
    """
    a, b, c = x[face[0]], x[face[1]], x[face[2]]
    above, below = orient(a, b, c, x[p]), orient(a, b, c, x[q])
    if above * below > 0.0 or (above == 0.0 and below == 0.0):
        return APART
    u, v, w = orient(x[p], x[q], a, b), orient(x[p], x[q], b, c), orient(x[p], x[q], c, a)
    if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
        return APART
    return DOUBTFUL if above * below * u * v * w == 0.0 else CROSSING


def touches(edge: Float, triangle: Float) -> bool:
    """Whether an edge (2, 3) meets a triangle (3, 3), an end or a side counted, in fractions."""
    (p, q), corners = (
        [[Fraction(value) for value in point] for point in points.tolist()] for points in (edge, triangle)
    )

    def side(*points: list[Fraction]) -> int:
        u, v, w = ([one - other for one, other in zip(point, points[3], strict=True)] for point in points[:3])
        found = sum(u[k] * (v[k - 2] * w[k - 1] - v[k - 1] * w[k - 2]) for k in range(3))
        return (found > 0) - (found < 0)

    ends = {side(*corners, p), side(*corners, q)}
    turns = {side(p, q, corners[k], corners[(k + 1) % 3]) for k in range(3)}
    return ends not in ({0}, {1}, {-1}) and not {1, -1} <= turns and turns != {0}


@block_kernel
def find_through(x: Float, tree: MovingTree, piece: Int, meets: Bool, bodies: bool, found: Long) -> int:
    """Write edges and the triangles f that they go through, doubtful ones as -1 - f, into found (c, 2) as far as there
    is room; return their number.
    """
    number, edges, faces, some = 0, tree.edges, tree.faces, np.empty((2, PER_TWO), np.int32)
    leaves = near_leaves(tree, bodies)
    for g in range(len(leaves)):
        for turn in range(1 if leaves[g, 0] == leaves[g, 1] else 2):
            for c in range(edges_at_faces(tree, leaves[g, turn], leaves[g, 1 - turn], some)):
                e, f = some[0, c], some[1, c]
                i, j = edges[e, 0], edges[e, 1]
                if not meets[piece[i], piece[faces[f, 0]]]:
                    continue
                crossing = passes_through(x, i, j, faces[f])
                if crossing != APART:
                    if number < found.shape[0]:
                        found[number, 0], found[number, 1] = e, f if crossing == CROSSING else -1 - f
                    number += 1
    return number


def with_room(find: Callable[[Long], int], first: int) -> tuple[Long, int]:
    """Return the rows (c, 2) that `find` fills and their number, with as much room as it needs."""
    rows = np.empty((first, 2), np.int64)
    if (number := int(find(rows))) > len(rows):
        rows = np.empty((number, 2), np.int64)
        find(rows)
    return rows, number


def find_crossings(tree: MovingTree, x: Float, piece: Int, meets: Bool, bodies: bool = False) -> tuple[Long, Long]:
    """Return edges (k,) and the triangles (k,) that they go through or touch, of vertices x (n, 3), in order."""
    fit(tree, x, 0.0)
    found, number = with_room(lambda rows: find_through(x, tree, piece, meets, bodies, rows), len(tree.faces))
    found, kept = found[:number], np.ones(number, bool)
    for row in np.flatnonzero(found[:, 1] < 0):
        found[row, 1] = -1 - found[row, 1]
        kept[row] = touches(x[tree.edges[found[row, 0]]], x[tree.faces[found[row, 1]]])
    found = found[kept]
    order = np.lexsort((found[:, 1], found[:, 0]))
    return found[order, 0], found[order, 1]


class Near(NamedTuple):
    """Pairs (k, 4) that are nearer to each other than required, as in nuno_contact.offset.proximity: weights at the
    closest points, normal from the second primitive to the first, distance and the required one [m].
    """

    pair: Long
    weights: Float
    normal: Float
    distance: Float
    wanted: Float


@kernel
def neighbours(ring_start: Long, ring: Long, pair: Int, of_edges: bool) -> bool:
    """Whether an edge joins the two primitives of a pair."""
    first = 2 if of_edges else 1
    for i in range(first):
        for q in range(ring_start[pair[i]], ring_start[pair[i] + 1]):
            for j in range(first, 4):
                if ring[q] == pair[j]:
                    return True
    return False


class Gaps(NamedTuple):
    """What decides the distance that a pair of n vertices requires: begun (n, 3) where they were at the start [m], the
    vertices that each shares an edge with, ring[ring_start[i]:ring_start[i + 1]], the piece (n,) of each, which pieces
    meet (o, o), which of them is of bodies, which vertices are tangled (n,), and the gap [m].
    """

    begun: Float
    ring_start: Long
    ring: Long
    piece: Int
    meets: Bool
    bodies: int
    tangled: Bool
    gap: float


class Room(NamedTuple):
    """Room for c near pairs: pair, weights (c, 4), normal (c, 3), and size (c, 2), distance and required one [m]."""

    pair: Long
    weights: Float
    normal: Float
    size: Float


@block_kernel
def measure_near(x: Float, tree: MovingTree, gaps: Gaps, leaves: Long, room: Room) -> int:
    """Write pairs in leaves (p, 2) that are too near into `room`, as far as it goes; return their number."""
    count, found, four = 0, np.empty((2, 4 * PER_TWO), np.int32), np.empty((4 * PER_TWO, 4), np.int32)
    for of_edges in (False, True):
        first = 0
        while first < len(leaves):
            first, number = find_pairs(tree, of_edges, leaves, first, found, four)
            count = measure_some(x, gaps, of_edges, four[:number], room, count)
    return count


@block_kernel
def measure_some(x: Float, gaps: Gaps, of_edges: bool, found: Int, room: Room, count: int) -> int:
    """Write pairs found (c, 4) that are too near into `room` from `count` on; return the count after.

    Tangled pairs and those of two objects need the gap; others have been near from the start.
    """
    begun, ring_start, ring, piece, meets, bodies, tangled, gap = gaps
    pair, weights, normal, size = room
    for r in range(found.shape[0]):
        i, j, k, l = found[r, 0], found[r, 1], found[r, 2], found[r, 3]  # noqa: E741
        if not meets[piece[i], piece[l]]:
            continue
        here = (point(x, i), point(x, j), point(x, k), point(x, l))
        w = closest(of_edges, here).weights
        n, distance = unit(weigh(w, here))
        if distance >= OVER * gap:
            continue
        wanted = gap
        was = tangled[i] or tangled[j] or tangled[k] or tangled[l]
        objects = piece[i] != piece[l] and piece[i] != bodies and piece[l] != bodies
        if not objects and not (was and not neighbours(ring_start, ring, found[r], of_edges)):
            first = (point(begun, i), point(begun, j), point(begun, k), point(begun, l))
            _, before = unit(weigh(closest(of_edges, first).weights, first))
            wanted = less(gap, LEAST_SHARE * before)
        if distance >= OVER * wanted:
            continue
        if count < pair.shape[0]:
            for corner in range(4):
                pair[count, corner] = found[r, corner]
            weights[count, 0], weights[count, 1], weights[count, 2], weights[count, 3] = w
            normal[count, 0], normal[count, 1], normal[count, 2] = n
            size[count, 0], size[count, 1] = distance, wanted
        count += 1
    return count


def find_near_pairs(cloth: Cloth, x: Float, tangled: Bool, gap: float) -> Near:
    """Return pairs that are nearer than OVER times their required distance, of vertices x (n, 3), in order."""
    tree, rows = cloth.tree, fit(cloth.tree, x, OVER * gap)
    leaves = near_leaves(tree, cloth.bodies >= 0)
    begun = np.ascontiguousarray(cloth.begun.T)
    gaps = Gaps(begun, cloth.ring_start, cloth.ring, cloth.piece, cloth.meets, cloth.bodies, tangled, gap)
    places, kept = 0, 2 * len(tree.faces)
    while kept > places:
        room = Room(np.empty((kept, 4), np.int64), np.empty((kept, 4)), np.empty((kept, 3)), np.empty((kept, 2)))
        places, kept = kept, measure_near(rows, tree, gaps, leaves, room)
    return Near(room.pair[:kept], room.weights[:kept], room.normal[:kept], room.size[:kept, 0], room.size[:kept, 1])
