"""A triangle mesh as a tree of boxes, eight children a node and eight triangles a leaf, and the stack of a search in
it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.normals import edge_normals, edge_numbers, vertex_normals
from nuno_kernels import forced_inline, kernel
from nuno_kernels.lanes import WIDTH, Lanes, first_lane, lane
from nuno_schemas.fabric import Float, Int

# The stack of a tree search, the nearest of each node's children on top.


@forced_inline
def push_children(away: Lanes, bits: int, first: int, waiting: NDArray[np.int64], bound: Float, top: int) -> int:
    """Push those of a node's eight children whose `bits` are set, the nearest last; return the new height, `top`
    before.

    `away` are their distances, written to `bound`; `first` is the first child, and counts down where it is negative, as
    numbers of leaves do.
    """
    base = top
    while bits != 0:
        j = first_lane(bits)
        bits &= bits - 1
        value, k = lane(away, j), top
        while k > base and bound[k - 1] < value:
            waiting[k], bound[k] = waiting[k - 1], bound[k - 1]
            k -= 1
        waiting[k], bound[k] = first + j if first >= 0 else first - j, value
        top += 1
    return top


# A triangle mesh as a tree of boxes, eight children a node and eight triangles a leaf.
#
# Triangles are cut at medians along the widest axis of their centroids into groups of 8, 64, 512, ...
# of their order, so that a node's children stand side by side and a node, like a leaf, is one vector test.
# A mesh of 330,000 triangles is six levels high.
#
# Not chosen: the surface area heuristic, whose boxes are a little tighter but whose leaves are unequally
# full; pointers to children one by one, which cost a gather where a load will do.

ROUNDING = 2.0**-46
"""Boxes are wider than their triangles by this share of the mesh's size, 64 ulp: the distance computed to a triangle is
then never less than that computed to its boxes, so that skipped boxes change no bit."""
DEPTH = 192
"""capacity of the stack of nodes: at most seven a level on the way up and seven on the way down, and twelve levels hold
5e11 triangles"""


class Tree(NamedTuple):
    """N nodes, L leaves and f triangles of a mesh of n vertices and e edges.

    boxes    (6 N, 8)  of node k in rows 6 k to 6 k + 5: lowest x, y, z, highest x, y, z of its eight
                       children [m]; a child that is missing is infinitely far
    child    (N,)      int64: first of a node's children, which follow each other; -1 - (first leaf) where
                       they are leaves; the root is node 0
    parent   (N,)      int64: the node that each node is a child of, -1 of the root
    leaf_parent (L,)   int64: the node that each leaf is a child of
    corners  (9 L, 8)  of leaf k in rows 9 k to 9 k + 8: corner a and edges b - a and c - a of its eight
                       triangles [m]; the last leaf is filled up with repetitions
    face     (8 L,)    int32: number of the triangle in each place of the leaves
    place    (f,)      int32: first place of each triangle
    faces    (f, 3)    int32: its vertices
    edges    (f, 3)    int32: its edges a-b, b-c, c-a by number
    vertex_normals (n, 3), edge_normals (e, 3): angle-weighted pseudonormals, of any length
    """

    boxes: Float
    child: NDArray[np.int64]
    parent: NDArray[np.int64]
    leaf_parent: NDArray[np.int64]
    corners: Float
    face: Int
    place: Int
    faces: Int
    edges: Int
    vertex_normals: Float
    edge_normals: Float


class Room(NamedTuple):
    """Scratch of a search: nodes on the stack, and their distances."""

    waiting: NDArray[np.int64]
    """(DEPTH,)"""
    bound: Float
    """(DEPTH,) squared distances [m^2]"""


@forced_inline
def make_room() -> Room:
    """Allocate the scratch of one search at a time."""
    return Room(np.empty(DEPTH, np.int64), np.empty(DEPTH))


@kernel
def order_triangles(centre: Float, capacity: int, order: NDArray[np.int64]) -> None:
    """Reorder the triangles of centroids (f, 3) so that each run of 8, 64, ... is a cell cut at medians.

    `capacity` is the least power of eight that is no less than f; `order` (f,) int64 starts as 0 .. f - 1.
    """
    stack = np.empty((512, 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, order.shape[0], capacity
    top = 1
    while top > 0:
        top -= 1
        low, high, unit = stack[top, 0], stack[top, 1], stack[top, 2]
        while unit > 1 and high - low <= unit:
            unit //= 8
        if unit < 8:
            continue
        parts = (high - low + unit - 1) // unit
        part = order[low:high].copy()
        widest, axis = -1.0, 0
        for c in range(3):
            least, most = np.inf, -np.inf
            for i in range(part.shape[0]):
                value = centre[part[i], c]
                least, most = min(least, value), max(most, value)
            if most - least > widest:
                widest, axis = most - least, c
        key = np.empty(part.shape[0])
        for i in range(part.shape[0]):
            key[i] = centre[part[i], axis]
        ranked = np.argsort(key, kind="mergesort")
        for i in range(part.shape[0]):
            order[low + i] = part[ranked[i]]
        middle = low + (parts + 1) // 2 * unit
        stack[top, 0], stack[top, 1], stack[top, 2] = low, middle, unit
        stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = middle, high, unit
        top += 2


def in_eights(values: Float, fill: float) -> Float:
    """Reshape (m, c) -> (c ceil(m / 8), 8): rows of eight, c for each group, the last group filled up."""
    groups = -(-len(values) // WIDTH)
    full = np.full((groups * WIDTH, values.shape[1]), fill)
    full[: len(values)] = values
    return np.ascontiguousarray(full.reshape(groups, WIDTH, -1).transpose(0, 2, 1).reshape(-1, WIDTH))


def build_tree(vertices: Float, faces: Int) -> Tree:
    """Return the tree of a mesh: vertices (n, 3) [m], at least one triangle (f, 3), counter-clockwise from outside.

    Degenerate triangles are allowed. Signs of distances need a closed mesh whose vertices are shared.
    """
    x = np.ascontiguousarray(vertices, np.float64)
    faces = np.ascontiguousarray(faces, np.int32)
    corners = x[faces]
    order = np.arange(len(faces), dtype=np.int64)
    capacity = WIDTH
    while capacity < len(faces):
        capacity *= WIDTH
    order_triangles(corners.mean(axis=1), capacity, order)
    leaves = -(-len(faces) // WIDTH)
    filled = np.concatenate([order, np.full(leaves * WIDTH - len(order), order[-1])])
    a, b, c = (corners[filled, k] for k in range(3))
    place = np.empty(len(faces), np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    boxes, child = stack_boxes(corners[filled], ROUNDING * float(np.abs(x[faces]).max(initial=0.0)))
    numbers, pairs = edge_numbers(faces)
    inner = int((child >= 0).sum())  # nodes whose children are leaves come last
    parent = np.searchsorted(child[:inner], np.arange(len(child)), side="right") - 1
    return Tree(
        boxes=boxes,
        child=child,
        parent=parent.astype(np.int64),
        leaf_parent=inner + np.arange(leaves) // WIDTH,
        corners=in_eights(np.concatenate([a, b - a, c - a], axis=1), 0.0),
        face=filled.astype(np.int32),
        place=place,
        faces=faces,
        edges=numbers,
        vertex_normals=vertex_normals(x, faces),
        edge_normals=edge_normals(x, faces, numbers, len(pairs)),
    )


def stack_boxes(corners: Float, margin: float) -> tuple[Float, NDArray[np.int64]]:
    """Return the boxes and children of all nodes, root first, over items (8 L, c, 3) in the order of their leaves.

    An item is whatever lies between the lowest and the highest of its c points; boxes are wider by `margin` [m].
    """
    own = np.concatenate([corners.min(axis=1) - margin, corners.max(axis=1) + margin], axis=1)
    below = _enclose(in_eights(own, np.nan))
    levels: list[Float] = []
    while not levels or len(levels[-1]) > 6:
        levels.append(in_eights(below, np.nan))
        below = _enclose(levels[-1])
    counts = [len(level) // 6 for level in reversed(levels)]
    starts = np.cumsum([0, *counts])
    child = [starts[k + 1] + WIDTH * np.arange(count) for k, count in enumerate(counts)]
    child[-1] = -1 - WIDTH * np.arange(counts[-1])
    boxes = np.concatenate(levels[::-1])
    missing = np.isnan(boxes)
    boxes[missing] = np.inf
    return boxes, np.concatenate(child).astype(np.int64)


def _enclose(rows: Float) -> Float:
    """Return boxes (N, 6) around the boxes of children (6 N, 8), NaN for missing ones."""
    groups = rows.reshape(-1, 6, WIDTH)
    return np.concatenate([np.nanmin(groups[:, :3], axis=2), np.nanmax(groups[:, 3:], axis=2)], axis=1)
