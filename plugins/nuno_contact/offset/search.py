"""The list of pairs that may come near: all that could be within a radius of each other over a window of time.

At a reference, at which no primitives meet, each vertex is taken to go on by its `motion` over the window. A pair is
left out only where a plane keeps it apart by more than the radius R at the start and at the end of that: distances
from a plane are linear in time, their least and greatest over a primitive concave and convex, so that it does so all
the while. With R = h + 2 b a pair that is left out stays farther apart than h while no vertex is more than b away
from where it is taken to be. Cloth that moves along together needs no new list, however fast it moves.

Most lists in the field (Verlet 1967) are made for points at rest, and used up by common motion.
"""

from __future__ import annotations

import numpy as np

from nuno_contact.offset.tree import Tree, less
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.bodies.poses import Index, Vector
from nuno_kernels.lanes.choose import first_lane, higher, lanes_up_to, lower
from nuno_kernels.lanes.simd import WIDTH, load, splat
from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Float

Box = tuple[Vector, Vector, Vector, Vector]
"""Lowest and highest place, lowest and highest motion."""
DEPTH = 512
"""Pairs of nodes that wait to be looked at."""


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
def box_apart(own: Box, nodes: Float, node: Index, radius: float) -> bool:
    """The same of a box and a node."""
    for k in range(3):
        if nodes[node, k] - own[1][k] + less(nodes[node, 6 + k] - own[3][k], 0.0) > radius:
            return True
        if own[0][k] - nodes[node, 3 + k] + less(own[2][k] - nodes[node, 9 + k], 0.0) > radius:
            return True
    return False


@forced_inline
def near_lanes(own: Box, boxes: Float, p: Index, radius: float) -> int:
    """Bits of the eight boxes from column p of boxes (12, places) on that may come within `radius` of a box."""
    gap, none = splat(-np.inf), splat(0.0)
    for k in range(3):
        low, high, back, on = own[0][k], own[1][k], own[2][k], own[3][k]
        gap = higher(load(boxes, k, p) - high + lower(load(boxes, 6 + k, p) - on, none), gap)
        gap = higher(low - load(boxes, 3 + k, p) + lower(back - load(boxes, 9 + k, p), none), gap)
    return int(lanes_up_to(gap, radius))


@forced_inline
def box_of(boxes: Float, p: Index) -> Box:
    """The box in column p."""
    return (
        (boxes[0, p], boxes[1, p], boxes[2, p]), (boxes[3, p], boxes[4, p], boxes[5, p]),
        (boxes[6, p], boxes[7, p], boxes[8, p]), (boxes[9, p], boxes[10, p], boxes[11, p]),
    )  # fmt: skip


@block_kernel
def find_leaves(boxes: Float, radius: float, found: Long) -> int:
    """Pairs (p, 2) of leaves that may come near, as far as there is room; how many there are."""
    waiting = np.empty((DEPTH, 2), np.int64)
    inner = boxes.shape[0] // 2
    waiting[0, 0], waiting[0, 1] = 0, 0
    top, number = 1, 0
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


@kernel
def find_faces(
    a: int, b: int, x: Float, u: Float, spread: Float, tree: Tree, radius: float, found: Long, number: int
) -> int:
    """Vertices of leaf a and triangles of leaf b whose boxes come near, into found (c, 2) from `number` on."""
    nodes, faces, face, vertex, boxes = tree.boxes, tree.faces, tree.face, tree.vertex, tree.face_boxes
    node, first, stop = nodes.shape[0] // 2 + b, tree.face_start[b], tree.face_start[b + 1]
    for p in range(np.uint64(tree.vertex_start[a]), np.uint64(tree.vertex_start[a + 1])):
        v = np.uint64(vertex[p])
        own, r = (x[0, v], x[1, v], x[2, v]), spread[v]
        low, high = (own[0] - r, own[1] - r, own[2] - r), (own[0] + r, own[1] + r, own[2] + r)
        box = low, high, (u[0, v], u[1, v], u[2, v]), (u[0, v], u[1, v], u[2, v])
        if box_apart(box, nodes, node, radius):
            continue
        for q in range(np.uint64(first), np.uint64(stop), np.uint64(WIDTH)):
            bits = near_lanes(box, boxes, q, radius)
            while bits != 0:
                f = np.uint64(face[q + np.uint64(first_lane(bits))])
                bits &= bits - 1
                if v != faces[f, 0] and v != faces[f, 1] and v != faces[f, 2]:
                    if number < found.shape[0]:
                        found[number, 0], found[number, 1] = np.int64(v), np.int64(f)
                    number += 1
    return number


@kernel
def find_edges(a: int, b: int, tree: Tree, radius: float, found: Long, number: int) -> int:
    """The same of edges e < o of two leaves, as -1 - e and o."""
    nodes, edges, edge, boxes = tree.boxes, tree.edges, tree.edge, tree.edge_boxes
    node, first, stop = nodes.shape[0] // 2 + b, tree.edge_start[b], tree.edge_start[b + 1]
    for p in range(np.uint64(tree.edge_start[a]), np.uint64(tree.edge_start[a + 1])):
        own = box_of(boxes, p)
        if edge[p] < 0 or (a != b and box_apart(own, nodes, node, radius)):
            continue
        e = np.int64(edge[p])
        i, j = edges[np.uint64(e), 0], edges[np.uint64(e), 1]
        for q in range(np.uint64(first), np.uint64(stop), np.uint64(WIDTH)):
            bits = near_lanes(own, boxes, q, radius)
            while bits != 0:
                o = np.int64(edge[q + np.uint64(first_lane(bits))])
                bits &= bits - 1
                k, l = edges[np.uint64(o), 0], edges[np.uint64(o), 1]  # noqa: E741
                if i != k and i != l and j != k and j != l and (a != b or e < o):
                    if number < found.shape[0]:
                        found[number, 0], found[number, 1] = -1 - min(e, o), max(e, o)
                    number += 1
    return number


@block_kernel
def find_near(
    x: Float, u: Float, spread: Float, tree: Tree, radius: float, leaves: Long, count: int, found: Long
) -> int:
    """Primitives of `count` pairs of leaves whose boxes come near: see find_faces and find_edges."""
    number = 0
    for g in range(count):
        a, b = leaves[g, 0], leaves[g, 1]
        number = find_faces(a, b, x, u, spread, tree, radius, found, number)
        if a != b:
            number = find_faces(b, a, x, u, spread, tree, radius, found, number)
        number = find_edges(a, b, tree, radius, found, number)
    return number
