"""A tree of boxes over a moving cloth's triangles, made once and refitted; each box also holds how its vertices move.

Triangles are cut at medians along the widest axis of their centroids at the start, so that a leaf is a patch of
neighbours and stays one however the cloth folds: a sheet hardly stretches. Bodies, where there are any, are the second
half of the tree. Each vertex and each edge is owned by the
first leaf that has it, so that a pair of primitives is looked at once.

Not chosen: a grid of cells, whose size suits one length of edges; boxes rebuilt by place, which separate folds that
touch a little better and cost a sort each time.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_geometry.normals import edge_numbers
from nuno_kernels import block_kernel, forced_inline
from nuno_kernels.lanes.simd import WIDTH
from nuno_schemas.fabric import Float, Int

LEAF = 8
"""triangles of a leaf at most"""


class Tree(NamedTuple):
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


def make_tree(x: Float, faces: Int, of_cloth: int | None = None) -> Tree:
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
    return Tree(boxes, faces, edges, vertices, face_start, face, edge_start, edge, vertex_start, vertex, *rooms)


def adjacent_faces(faces: Int) -> Int:
    """Return the number (f, 3) of the triangle across each edge of faces (f, 3), -1 for none; of several the lowest."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1).astype(np.int64)
    span = int(faces.max(initial=0)) + 1
    keys = (ends[..., 0] * span + ends[..., 1]).ravel()
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
def fit_tree(tree: Tree, x: Float, motion: Float, spread: Float) -> None:
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
