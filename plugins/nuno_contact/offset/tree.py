"""A tree of boxes over a moving cloth's triangles, and the search in it for pairs that may come near."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_geometry.normals import edge_numbers
from nuno_geometry.poses import Index, Vector
from nuno_kernels import block_kernel, forced_inline
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.lanes import WIDTH, first_lane, higher, lanes_up_to, load, lower, splat
from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Float, Int

# A tree of boxes over a moving cloth's triangles, made once and refitted; each box also holds how its vertices move.
#
# Triangles are cut at medians along the widest axis of their centroids at the start, so that a leaf is a patch of
# neighbours and stays one however the cloth folds: a sheet hardly stretches. Bodies, where there are any, are the
# second half of the tree. Each vertex and each edge is owned by the first leaf that has it, so that a pair of
# primitives is looked at once.
#
# Not chosen: a grid of cells, whose size suits one length of edges; boxes rebuilt by place, which separate folds that
# touch a little better and cost a sort each time.

LEAF = 8
"""triangles of a leaf at most"""


@by_reference
class MovingTree(NamedTuple):
    """Of f triangles, e edges and n vertices: a complete binary tree of M leaves, M a power of two; node k has the
    children 2 k + 1 and 2 k + 2, the leaves are the last M nodes.

    boxes  (2 M - 1, 12) lowest and highest place [m], lowest and highest motion [m]; lowest above highest where empty
    faces (f, 3), edges (e, 2), vertices (n, 1)  of which vertices
    face_start, edge_start, vertex_start (M + 1,)  bounds of what each leaf owns in
    face, edge, vertex (eights, 8)  numbers, leaf by leaf, each leaf's filled up to eights with -1
    face_boxes, edge_boxes, vertex_boxes (eights, 96)  their boxes as above, the eight of them number by number: rows as
    long as the mesh might drive each other from the cache
    """

    boxes: Float
    faces: Int
    edges: Int
    vertices: Int
    face_start: Int
    face: Int
    edge_start: Int
    edge: Int
    vertex_start: Int
    vertex: Int
    face_boxes: Float
    edge_boxes: Float
    vertex_boxes: Float


def make_tree(x: Float, faces: Int, of_cloth: int | None = None) -> MovingTree:
    """Return the tree of faces (f, 3) between vertices x (n, 3); those after the first `of_cloth` are of bodies."""
    numbers, edges = edge_numbers(faces)
    centre = x[faces].mean(axis=1)
    parts: list[Any] = [np.arange(len(faces))]
    if of_cloth is not None and of_cloth < len(faces):
        parts = [parts[0][:of_cloth], parts[0][of_cloth:]]
    while max(map(len, parts)) > LEAF:
        parts = [half for part in parts for half in _halves(part, centre)]
    leaves = len(parts)
    leaf_of = np.empty(len(faces), np.int64)
    for leaf, part in enumerate(parts):
        leaf_of[part] = leaf
    boxes = np.empty((2 * leaves - 1, 12))
    face_start, face = _in_eights(*_owned(leaf_of, np.arange(len(faces)), leaves))
    edge_start, edge = _in_eights(*_owned(leaf_of.repeat(3), numbers.ravel(), leaves))
    vertex_start, vertex = _in_eights(*_owned(leaf_of.repeat(3), faces.ravel(), leaves))
    rooms = [np.empty((len(eights), 12 * WIDTH)) for eights in (face, edge, vertex)]
    faces, vertices = np.ascontiguousarray(faces, np.int32), np.arange(len(x), dtype=np.int32)[:, None]
    return MovingTree(boxes, faces, edges, vertices, face_start, face, edge_start, edge, vertex_start, vertex, *rooms)


def adjacent_faces(faces: Int) -> Int:
    """Return the number (f, 3) of the triangle across each edge of faces (f, 3), -1 for none; of several the lowest."""
    keys = edge_numbers(faces)[0].ravel()
    order = np.argsort(keys, kind="stable")
    same = keys[order][1:] == keys[order][:-1]
    adjacent = np.full(keys.shape, -1, np.int32)
    adjacent[order[:-1][same]] = order[1:][same] // 3
    adjacent[order[1:][same]] = order[:-1][same] // 3
    return adjacent.reshape(-1, 3)


def rings(edges: Int, n: int) -> tuple[Int, Int]:
    """Return the bounds (n + 1,) of each vertex' neighbours, and the neighbours, of edges (e, 2)."""
    both = np.concatenate([edges, edges[:, ::-1]])
    order = np.lexsort((both[:, 1], both[:, 0]))
    start = np.searchsorted(both[order, 0], np.arange(n + 1)).astype(np.int32)
    return start, np.ascontiguousarray(both[order, 1])


def _halves(part: Any, centre: Float) -> tuple[Any, Any]:
    """Cut a set of triangles at the median along the widest axis."""
    if len(part) < 2:
        return part, part[:0]
    axis = int(np.ptp(centre[part], axis=0).argmax())
    order = part[np.argsort(centre[part, axis], kind="stable")]
    return order[: (len(order) + 1) // 2], order[(len(order) + 1) // 2 :]


def _owned(leaf: Any, number: Any, leaves: int) -> tuple[Int, Int]:
    """Return the bounds (M + 1,) and numbers of the primitives that each leaf is the first to have."""
    order = np.lexsort((leaf, number))
    kept, first = np.unique(number[order], return_index=True)
    owner = leaf[order][first]
    by_leaf = np.lexsort((kept, owner))
    bounds = np.searchsorted(owner[by_leaf], np.arange(leaves + 1))
    return bounds.astype(np.int32), kept[by_leaf].astype(np.int32)


def _in_eights(start: Int, number: Int) -> tuple[Int, Int]:
    """Pad each leaf's numbers with -1 to whole eights."""
    count = np.diff(start)
    eights = np.concatenate([[0], np.cumsum(-(-count // WIDTH))])
    filled = np.full((eights[-1], WIDTH), -1, np.int32)
    filled.flat[np.arange(len(number)) - np.repeat(start[:-1] - WIDTH * eights[:-1], count)] = number
    return eights.astype(np.int32), filled


@forced_inline
def less(a: float, b: float) -> float:
    """Return the lower of two numbers; min() also tests for NaN."""
    return a if a < b else b


@forced_inline
def more(a: float, b: float) -> float:
    """Return the higher of two numbers."""
    return a if a > b else b


@block_kernel
def fit_boxes(eights: Int, of: Int, x: Float, motion: Float, spread: Float, boxes: Float) -> None:
    """Fit boxes (g, 96) to eights (g, 8) of primitives of vertices of[number]; -1 is nowhere."""
    for g in range(eights.shape[0]):
        for axis in range(3):
            at, along, box = x[axis], motion[axis], boxes[g, axis * WIDTH :]
            for lane in range(WIDTH):
                number, low, high, back, on = eights[g, lane], np.inf, -np.inf, np.inf, -np.inf
                for corner in range(of.shape[1] if number >= 0 else 0):
                    v = np.uint64(of[number, corner])
                    low, high = less(low, at[v] - spread[v]), more(high, at[v] + spread[v])
                    back, on = less(back, along[v]), more(on, along[v])
                box[lane], box[lane + 3 * WIDTH], box[lane + 6 * WIDTH], box[lane + 9 * WIDTH] = low, high, back, on


@block_kernel
def fit_tree(tree: MovingTree, x: Float, motion: Float, spread: Float) -> None:
    """Fit the boxes to vertices x (3, n), each within spread (n,) [m], that go motion (3, n) from there."""
    boxes, face_start, face_boxes = tree.boxes, tree.face_start, tree.face_boxes
    fit_boxes(tree.face, tree.faces, x, motion, spread, face_boxes)
    fit_boxes(tree.edge, tree.edges, x, motion, spread, tree.edge_boxes)
    fit_boxes(tree.vertex, tree.vertices, x, motion, spread, tree.vertex_boxes)
    leaves = face_start.shape[0] - 1
    for leaf in range(leaves):
        for row in range(12):
            lowest = row % 6 < 3
            value = np.inf if lowest else -np.inf
            for g in range(face_start[leaf], face_start[leaf + 1]):
                for lane in range(WIDTH):
                    own = face_boxes[g, row * WIDTH + lane]
                    value = less(value, own) if lowest else more(value, own)
            boxes[leaves - 1 + leaf, row] = value
    for node in range(leaves - 2, -1, -1):
        a, b = 2 * node + 1, 2 * node + 2
        for row in range(12):
            lowest = row % 6 < 3
            boxes[node, row] = less(boxes[a, row], boxes[b, row]) if lowest else more(boxes[a, row], boxes[b, row])


# The list of pairs that may come near: all that could be within a radius of each other over a window of time.
#
# At a reference, at which no primitives meet, each vertex is expected to move by its `motion` over the window. A pair
# is left out only where a plane keeps it apart by more than the radius R at the start and at the end of that: distances
# from a plane are linear in time, their least and greatest over a primitive concave and convex, so that it does so all
# the while. With R = h + 2 b a pair that is left out stays farther apart than h while no vertex is more than b away
# from its expected place. Cloth that moves along together needs no new list, however fast it moves.
#
# Most lists in the field (Verlet 1967) are made for points at rest, and used up by common motion.

Box = tuple[Vector, Vector, Vector, Vector]
"""lowest and highest place, lowest and highest motion"""
DEPTH = 512
"""capacity of the stack of pairs of nodes"""
HITS = (3 * LEAF) * (3 * LEAF // WIDTH + 1)
"""most edges of a leaf times eights of edges of another"""


@forced_inline
def nodes_apart(boxes: Float, a: int, b: int, radius: float) -> bool:
    """Whether all of two nodes stays farther apart than `radius` along some axis."""
    for k in range(3):
        if boxes[b, k] - boxes[a, 3 + k] + less(boxes[b, 6 + k] - boxes[a, 9 + k], 0.0) > radius:
            return True
        if boxes[a, k] - boxes[b, 3 + k] + less(boxes[a, 6 + k] - boxes[b, 9 + k], 0.0) > radius:
            return True
    return False


@forced_inline
def near_lanes(box: Box, boxes: Float, g: Index, radius: float) -> int:
    """Return the bits of those of an eight of boxes (eights, 96) that may come within `radius` of a box."""
    gap, none = splat(-np.inf), splat(0.0)
    for k in range(3):
        low, high, back, on = box[0][k], box[1][k], box[2][k], box[3][k]
        gap = higher(load(boxes, g, k * WIDTH) - high + lower(load(boxes, g, (k + 6) * WIDTH) - on, none), gap)
        gap = higher(low - load(boxes, g, (k + 3) * WIDTH) + lower(back - load(boxes, g, (k + 9) * WIDTH), none), gap)
    return int(lanes_up_to(gap, radius))


@forced_inline
def box_of(boxes: Float, g: Index, lane: int) -> Box:
    """Return one of an eight of boxes."""
    return _three(boxes, g, lane, 0), _three(boxes, g, lane, 3), _three(boxes, g, lane, 6), _three(boxes, g, lane, 9)


@forced_inline
def _three(boxes: Float, g: Index, lane: int, number: int) -> Vector:
    """Return three of its numbers."""
    p = np.uint64(lane + number * WIDTH)
    return boxes[g, p], boxes[g, p + np.uint64(WIDTH)], boxes[g, p + np.uint64(2 * WIDTH)]


@block_kernel
def find_leaves(boxes: Float, radius: float, bodies: bool, found: Long) -> int:
    """Write pairs (p, 2) of leaves that may come near, as far as there is room; return their number. Of a tree with
    `bodies` no pair is of two bodies.
    """
    waiting = np.empty((DEPTH, 2), np.int64)
    inner = boxes.shape[0] // 2
    waiting[0, 0], waiting[0, 1] = 0, 0
    top, number = 1, 0
    if bodies:
        waiting[0, 0], waiting[0, 1], waiting[1, 0], waiting[1, 1] = 1, 1, 1, 2
        top = 2
    while top > 0:
        top -= 1
        a, b = waiting[top, 0], waiting[top, 1]
        if a != b and nodes_apart(boxes, a, b, radius):
            continue
        if a >= inner:
            if number < found.shape[0]:
                found[number, 0], found[number, 1] = a - inner, b - inner
            number += 1
        # All leaves are as deep: both are inner nodes.
        elif a == b:
            waiting[top, 0], waiting[top, 1] = 2 * a + 1, 2 * a + 1
            waiting[top + 1, 0], waiting[top + 1, 1] = 2 * a + 1, 2 * a + 2
            waiting[top + 2, 0], waiting[top + 2, 1] = 2 * a + 2, 2 * a + 2
            top += 3
        else:
            for k in range(4):
                waiting[top, 0], waiting[top, 1] = 2 * a + 1 + k % 2, 2 * b + 1 + k // 2
                top += 1
    return number


@block_kernel
def near_leaves(boxes: Float, radius: float, bodies: bool) -> Long:
    """Return pairs (p, 2) of leaves that may come near; see find_leaves."""
    found = np.empty((4 * boxes.shape[0], 2), np.int64)
    number = find_leaves(boxes, radius, bodies, found)
    if number > found.shape[0]:
        found = np.empty((number, 2), np.int64)
        find_leaves(boxes, radius, bodies, found)
    return found[:number]


@forced_inline
def node_box(nodes: Float, node: Index) -> Box:
    """Return the box of a node."""
    return (
        (nodes[node, 0], nodes[node, 1], nodes[node, 2]), (nodes[node, 3], nodes[node, 4], nodes[node, 5]),
        (nodes[node, 6], nodes[node, 7], nodes[node, 8]), (nodes[node, 9], nodes[node, 10], nodes[node, 11]),
    )  # fmt: skip


@forced_inline
def meet_eights(
    node: Box, boxes_a: Float, start_a: Int, boxes: Float, start: Int, a: Index, b: Index, radius: float, hits: Long
) -> int:
    """Write into hits (c, 4): eight and lane of each primitive of leaf a that comes near the box `node` of leaf b, an
    eight of b, and the bits of its primitives whose boxes come near; return their number.

    Written without a branch on whether any does, since a wrong prediction takes as long as ten tests.
    """
    number = np.uint64(0)
    for g in range(np.uint64(start_a[a]), np.uint64(start_a[a + 1])):
        ours = near_lanes(node, boxes_a, g, radius)
        while ours != 0:
            lane = first_lane(ours)
            ours &= ours - 1
            box = box_of(boxes_a, g, lane)
            for q in range(np.uint64(start[b]), np.uint64(start[b + 1])):
                bits = near_lanes(box, boxes, q, radius)
                hits[number, 0], hits[number, 1], hits[number, 2], hits[number, 3] = g, lane, q, bits
                number += np.uint64(bits != 0)
    return int(number)


@forced_inline
def find_faces(a: int, b: int, tree: MovingTree, radius: float, hits: Long, found: Long, number: int) -> int:
    """Write vertices of leaf a and triangles of leaf b whose boxes come near into found (c, 2) from `number` on."""
    faces, face, vertex, node = tree.faces, tree.face, tree.vertex, node_box(tree.boxes, tree.boxes.shape[0] // 2 + b)
    met = meet_eights(node, tree.vertex_boxes, tree.vertex_start, tree.face_boxes, tree.face_start, a, b, radius, hits)
    for h in range(met):
        v, bits = vertex[hits[h, 0], hits[h, 1]], hits[h, 3]
        while bits != 0:
            f = face[hits[h, 2], first_lane(bits)]
            bits &= bits - 1
            if number < found.shape[0]:
                found[number, 0], found[number, 1] = v, f
            number += int((v != faces[f, 0]) & (v != faces[f, 1]) & (v != faces[f, 2]))
    return number


@forced_inline
def find_edges(a: int, b: int, tree: MovingTree, radius: float, hits: Long, found: Long, number: int) -> int:
    """Write edges e < o of two leaves likewise, as -1 - e and o."""
    edges, edge, node = tree.edges, tree.edge, node_box(tree.boxes, tree.boxes.shape[0] // 2 + b)
    met = meet_eights(node, tree.edge_boxes, tree.edge_start, tree.edge_boxes, tree.edge_start, a, b, radius, hits)
    for h in range(met):
        e, bits = np.int64(edge[hits[h, 0], hits[h, 1]]), hits[h, 3]
        i, j = edges[e, 0], edges[e, 1]
        while bits != 0:
            o = np.int64(edge[hits[h, 2], first_lane(bits)])
            bits &= bits - 1
            k, l = edges[o, 0], edges[o, 1]  # noqa: E741
            if number < found.shape[0]:
                found[number, 0], found[number, 1] = -1 - min(e, o), max(e, o)
            number += int((i != k) & (i != l) & (j != k) & (j != l) & ((a != b) | (e < o)))
    return number


@block_kernel
def find_near(tree: MovingTree, radius: float, leaves: Long, found: Long) -> int:
    """Write primitives of pairs (p, 2) of leaves whose boxes come near: see find_faces and find_edges. One kind after
    the other, so that loops over them are predictable.
    """
    number, hits = 0, np.empty((HITS, 4), np.int64)
    for g in range(leaves.shape[0]):
        for turn in range(1 if leaves[g, 0] == leaves[g, 1] else 2):
            number = find_faces(leaves[g, turn], leaves[g, 1 - turn], tree, radius, hits, found, number)
    for g in range(leaves.shape[0]):
        number = find_edges(leaves[g, 0], leaves[g, 1], tree, radius, hits, found, number)
    return number
