"""A tree of boxes over a moving cloth's triangles, and the search in it for pairs that may come near."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.normals import edge_numbers
from nuno_kernels import block_kernel, forced_inline
from nuno_kernels.boxes import NUMBERS, SIXTEEN, having, meeting, stand_up, unite, write_chosen
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.lanes import WIDTH, first_lane, higher, lanes_up_to, load, lower, splat, store
from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Float, Int

# A tree of boxes over a moving cloth's triangles, made once and refitted; each box also holds how its vertices move.
#
# Triangles are cut at medians along the widest axis of their centroids at the start, so that a leaf is a patch of
# neighbours and stays one however the cloth folds: a sheet hardly stretches. Bodies, where there are any, are the
# last leaves. Each vertex and each edge is owned by the first leaf that has it, so that a pair of primitives is looked
# at once. Eight nodes have one parent.
#
# Two kinds of boxes: of nodes, eight float64 side by side; of primitives, sixteen whole numbers
# (nuno_kernels.boxes), rounded outward. Pairs of primitives are looked at in leaves that come near to each other, for
# which numbers modulo 2**16 of a small unit are enough, wherever the leaves are.
#
# Not chosen: a grid of cells, whose size suits one length of edges; boxes rebuilt by place, which separate folds that
# touch a little better and cost a sort each time; bits of the primitives that share a vertex, known beforehand for all
# leaves side by side, which save a seventh of a list's time but need a table of leaves and a longer way to make it.

FACES, VERTICES, EDGES = range(3)
"""kinds of primitives, columns of MovingTree.start"""
Shorts = NDArray[np.int16]


@by_reference
class MovingTree(NamedTuple):
    """Of f triangles, e edges and n vertices, in M leaves of sixteen triangles each, but for the last of cloth, and of
    bodies; N nodes, eights of them side by side.

    faces (f, 3), edges (e, 2)  vertices of each
    start (M, 4)  first of the sixteens of each kind that each leaf owns, one after the other, and their end
    of_cloth (1,)  how many leaves are of cloth
    number (s, 16)  of the primitives of each sixteen, -1 where it is not full
    filled (s,)  bits of those that there are
    corner (s, 48)  vertices of each primitive, some twice: the first of the sixteen, the second, the third
    level (h + 1,)  first of the eights of each level of nodes, leaves first

    The rest are boxes; lowest above highest where a node is empty:
    nodes (N, 16)  lowest place, and where that goes [m], two numbers that mean nothing, the same of the highest
    node_boxes (N / 8, 96)  eights of them, number by number
    way (n, 16), row (16 s + M, 16), box (s, 192)  in whole numbers: of vertices, of primitives and leaves, and sixteens
    of primitives number by number
    """

    faces: Int
    edges: Int
    start: Int
    of_cloth: Int
    number: Int
    filled: Int
    corner: Int
    level: Int
    nodes: Float
    node_boxes: Float
    way: Shorts
    row: Shorts
    box: Shorts


def make_tree(x: Float, faces: Int, of_cloth: int | None = None) -> MovingTree:
    """Return the tree of faces (f, 3) between vertices x (n, 3); those after the first `of_cloth` are of bodies."""
    numbers, edges = edge_numbers(faces)
    centre, cloth = x[faces].mean(axis=1), len(faces) if of_cloth is None else of_cloth
    patches = _patches(np.arange(cloth), centre)
    parts = patches + _patches(np.arange(cloth, len(faces)), centre)
    leaf_of, leaves = np.empty(len(faces), np.int64), len(parts)
    for leaf, part in enumerate(parts):
        leaf_of[part] = leaf
    # Of triangles, vertices and edges: the leaves that have them, their numbers, and the vertices of each.
    three, corners = leaf_of.repeat(3), (faces, np.arange(len(x))[:, None], edges[:, [0, 1, 1]])
    kinds = (leaf_of, np.arange(len(faces))), (three, faces.ravel()), (three, numbers.ravel())
    owned = [_owned(leaf, number, leaves) for leaf, number in kinds]
    count = np.stack([-(-np.diff(bounds) // SIXTEEN) for bounds, _ in owned], axis=1)
    ends = np.cumsum(count.ravel()).reshape(count.shape)
    start = np.column_stack([ends[:, 0] - count[:, 0], ends])
    number = np.full((ends[-1, -1], SIXTEEN), -1, np.int32)
    corner = faces[[part[0] for part in parts]].repeat(SIXTEEN * count.sum(axis=1), axis=0)
    for kind, (bounds, own) in enumerate(owned):
        place = np.arange(len(own)) + np.repeat(SIXTEEN * start[:, kind] - bounds[:-1], np.diff(bounds))
        number.flat[place], corner[place] = own, corners[kind][own]
    level = [0, -(-leaves // WIDTH)]
    while level[-1] - level[-2] > 1:
        level.append(level[-1] - (level[-2] - level[-1]) // WIDTH)
    nodes = np.empty((WIDTH * level[-1], 2 * WIDTH))
    nodes[:, :WIDTH], nodes[:, WIDTH:] = np.inf, -np.inf
    corner = corner.reshape(-1, SIXTEEN, 3).swapaxes(1, 2).reshape(-1, 3 * SIXTEEN)
    return MovingTree(
        np.ascontiguousarray(faces, np.int32), edges, start.astype(np.int32), np.array([len(patches)], np.int32),
        number, ((number >= 0) @ (1 << np.arange(SIXTEEN))).astype(np.int32), corner.astype(np.int32, order="C"),
        np.array(level, np.int32), nodes, np.empty((level[-1], 12 * WIDTH)), np.empty((len(x), SIXTEEN), np.int16),
        np.empty((number.size + leaves, SIXTEEN), np.int16), np.empty((len(number), NUMBERS * SIXTEEN), np.int16),
    )  # fmt: skip


def _patches(part: Any, centre: Float) -> list[Any]:
    """Cut triangles at medians along the widest axis into patches of sixteen, and one of the rest."""
    if len(part) <= SIXTEEN:
        return [np.sort(part)] if len(part) else []
    axis, half = int(np.ptp(centre[part], axis=0).argmax()), SIXTEEN * -(-len(part) // (2 * SIXTEEN))
    order = part[np.argsort(centre[part, axis], kind="stable")]
    return _patches(order[:half], centre) + _patches(order[half:], centre)


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


def _owned(leaf: Any, number: Any, leaves: int) -> tuple[Int, Int]:
    """Return the bounds (M + 1,) and numbers of the primitives that each leaf is the first to have."""
    order = np.lexsort((leaf, number))
    kept, first = np.unique(number[order], return_index=True)
    owner = leaf[order][first]
    by_leaf = np.lexsort((kept, owner))
    bounds = np.searchsorted(owner[by_leaf], np.arange(leaves + 1))
    return bounds.astype(np.int32), kept[by_leaf].astype(np.int32)


@forced_inline
def less(a: float, b: float) -> float:
    """Return the lower of two numbers; min() also tests for NaN."""
    return a if a < b else b


@forced_inline
def more(a: float, b: float) -> float:
    """Return the higher of two numbers."""
    return a if a > b else b


@block_kernel
def lay_out(x: Float, u: Float, spread: Float, ways: Float) -> None:
    """Write into ways (n, 8), one cache line for each vertex: its position, its end after u (3, n), and its spread."""
    for i in range(x.shape[1]):
        for row in range(3):
            ways[i, row], ways[i, 3 + row] = x[row, i], x[row, i] + u[row, i]
        ways[i, 6] = spread[i]


@block_kernel
def fit_nodes(tree: MovingTree, ways: Float, more_room: float) -> None:
    """Fit the nodes' boxes to vertices' ways (n, 8), see lay_out, with more room [m] round each than its spread."""
    nodes, boxes, start, corner, level = tree.nodes, tree.node_boxes, tree.start, tree.corner, tree.level
    for leaf in range(start.shape[0]):
        low, high = splat(np.inf), splat(-np.inf)
        for k in range(3 * SIXTEEN):
            v = np.int64(corner[start[leaf, FACES], k])
            way, room = load(ways, v, 0), splat(ways[v, 6] + more_room)
            low, high = lower(way - room, low), higher(way + room, high)
        store(nodes, leaf, 0, low)
        store(nodes, leaf, WIDTH, high)
    for h in range(1, level.shape[0] - 1):
        for g in range(level[h - 1], level[h]):
            low, high = splat(np.inf), splat(-np.inf)
            for node in range(WIDTH * g, WIDTH * (g + 1)):
                low, high = lower(load(nodes, node, 0), low), higher(load(nodes, node, WIDTH), high)
            parent = WIDTH * level[h] + g - level[h - 1]
            store(nodes, parent, 0, low)
            store(nodes, parent, WIDTH, high)
    for g in range(boxes.shape[0]):
        for lane in range(WIDTH):
            for k in range(6):
                boxes[g, k * WIDTH + lane] = nodes[WIDTH * g + lane, k]
                boxes[g, (k + 6) * WIDTH + lane] = nodes[WIDTH * g + lane, WIDTH + k]


LARGEST, FINEST = 32000.0, 1e12
"""largest difference in whole numbers; most units in the farthest coordinate, so that float64 has them exactly"""


@block_kernel
def units_in_a_metre(tree: MovingTree, ways: Float) -> float:
    """Return how many units a metre has in whole numbers.

    Along each axis, boxes of two leaves that come near to each other are as far apart, all along the way, as they are
    long and part meanwhile, at most: this is the largest difference.
    """
    widest, farthest, differing = 0.0, 1.0, 0.0
    for leaf in range(tree.start.shape[0]):
        for k in range(6):
            low, high = tree.nodes[leaf, k], tree.nodes[leaf, WIDTH + k]
            widest, farthest = more(high - low, widest), more(more(-low, high), farthest)
    for k in range(3):
        back, on = np.inf, -np.inf
        for i in range(ways.shape[0]):
            motion = ways[i, 3 + k] - ways[i, k]
            back, on = less(motion, back), more(motion, on)
        differing = more(on - back, differing)
    return less(LARGEST / (2.0 * widest + differing), FINEST / farthest)


@block_kernel
def fit_tree(tree: MovingTree, ways: Float, radius: float) -> None:
    """Fit the boxes to vertices' ways (n, 8), see lay_out, so that boxes of what comes within `radius` [m] meet."""
    way, row, box, start, corner = tree.way, tree.row, tree.box, tree.start, tree.corner
    fit_nodes(tree, ways, 0.5 * radius)
    units = units_in_a_metre(tree, ways)
    for i in range(ways.shape[0]):
        room = ways[i, 6] + 0.5 * radius
        for k in range(6):
            # One unit more on each side, for what rounding of the products may lose.
            way[i, k] = math.floor((ways[i, k] - room) * units) - 1
            way[i, 6 + k] = math.floor((ways[i, k] + room) * -units) - 1
    for g in range(box.shape[0]):
        for k in range(SIXTEEN):
            unite(way, corner[g, k], corner[g, k + SIXTEEN], corner[g, k + 2 * SIXTEEN], row, SIXTEEN * g + k)
        stand_up(row, SIXTEEN * g, box, g)
    for leaf in range(start.shape[0]):
        first, own = SIXTEEN * start[leaf, FACES], tree.number.size + leaf
        unite(row, first, first + 1, first + 2, row, own)
        for place in range(first + 3, first + SIXTEEN):
            unite(row, own, place, place, row, own)


# The list of pairs that may come near: all that could be within a radius of each other over a window of time.
#
# At a reference, at which no primitives meet, each vertex is expected to move by its `motion` over the window. A pair
# is left out only where a plane keeps it apart by more than the radius R at the start and at the end of that: distances
# from a plane are linear in time, their least and greatest over a primitive concave and convex, so that it does so all
# the while. With R = h + 2 b a pair that is left out stays farther apart than h while no vertex is more than b away
# from its expected place. Cloth that moves along together needs no new list, however fast it moves.
#
# Boxes are widened by R / 2 and by b: where they do not meet, such a plane lies across an axis. Whole numbers are
# rounded outward.
#
# Most lists in the field (Verlet 1967) are made for points at rest, and used up by common motion.

PER_TWO = (3 * SIXTEEN) ** 2
"""most pairs of primitives of one kind in two leaves"""


@forced_inline
def near_nodes(nodes: Float, node: int, boxes: Float, g: int) -> int:
    """Return the bits of those of an eight of nodes that may meet one."""
    gap = splat(-np.inf)
    for k in range(3):
        begin, end = load(boxes, g, k * WIDTH), load(boxes, g, (k + 3) * WIDTH)
        gap = higher(lower(begin - nodes[node, WIDTH + k], end - nodes[node, WIDTH + 3 + k]), gap)
        begin, end = load(boxes, g, (k + 6) * WIDTH), load(boxes, g, (k + 9) * WIDTH)
        gap = higher(lower(nodes[node, k] - begin, nodes[node, 3 + k] - end), gap)
    return int(lanes_up_to(gap, 0.0))


@block_kernel
def find_leaves(tree: MovingTree, bodies: bool, found: Long) -> int:
    """Write pairs of leaves that may come near, the second not before the first, as far as there is room, into
    found (p, 2); return their number. Of a tree with `bodies` no pair is of two bodies.
    """
    nodes, boxes, level, top, number = tree.nodes, tree.node_boxes, tree.level, tree.level.shape[0] - 2, 0
    rest, eight = np.zeros(top + 1, np.int64), np.zeros(top + 1, np.int64)
    for a in range(tree.of_cloth[0] if bodies else tree.start.shape[0]):
        h, eight[top] = top, level[top]
        rest[top] = near_nodes(nodes, a, boxes, level[top])
        while h <= top:
            if rest[h] == 0:
                h += 1
                continue
            b = WIDTH * (eight[h] - level[h]) + first_lane(rest[h])
            rest[h] &= rest[h] - 1
            if ((b + 1) << (3 * h)) <= a:
                continue
            if h > 0:
                h -= 1
                eight[h] = level[h] + b
                rest[h] = near_nodes(nodes, a, boxes, eight[h])
                continue
            if number < found.shape[0]:
                found[number, 0], found[number, 1] = a, b
            number += 1
    return number


@block_kernel
def near_leaves(tree: MovingTree, bodies: bool) -> Long:
    """Return pairs (p, 2) of leaves that may come near; see find_leaves."""
    found = np.empty((16 * tree.start.shape[0], 2), np.int64)
    number = find_leaves(tree, bodies, found)
    if number > found.shape[0]:
        found = np.empty((number, 2), np.int64)
        find_leaves(tree, bodies, found)
    return found[:number]


@forced_inline
def write_meeting(tree: MovingTree, one: int, kind: int, two: int, other: int, once: bool, found: Int, at: int) -> int:
    """Write vertices or edges of leaf `one`, and those of another kind of leaf `two`, without a common vertex, whose
    boxes they meet, into found (2, c) from column `at` on; return the column after. If `once`, only of later places.
    """
    row, box, number, filled, start, corner = tree.row, tree.box, tree.number, tree.filled, tree.start, tree.corner
    own = np.uint64(number.size + two)
    first, end = np.uint64(start[two, other]), np.uint64(start[two, other + 1])
    for s in range(np.uint64(start[one, kind]), np.uint64(start[one, kind + 1])):
        ours = meeting(row, own, box, s) & filled[s]
        while ours != 0:
            lane = np.uint64(first_lane(ours))
            ours &= ours - 1
            i, j = corner[s, lane], corner[s, lane + np.uint64(SIXTEEN)]
            for g in range(first, end):
                met = meeting(row, np.uint64(SIXTEEN) * s + lane, box, g) & filled[g] & ~having(corner, g, i, j)
                if once:
                    met &= (-2 << lane) if g == s else -int(g > s)
                at = write_chosen(met, number, g, number[s, lane], found, at)
    return at


@forced_inline
def vertices_of(tree: MovingTree, of_edges: bool, e: int, f: int) -> tuple[int, int, int, int]:
    """Return the vertices of edges e and f, or of a vertex e and a triangle f."""
    if of_edges:
        return tree.edges[e, 0], tree.edges[e, 1], tree.edges[f, 0], tree.edges[f, 1]
    return e, tree.faces[f, 0], tree.faces[f, 1], tree.faces[f, 2]


@block_kernel
def find_pairs(tree: MovingTree, of_edges: bool, leaves: Long, first: int, found: Int, four: Int) -> tuple[int, int]:
    """Write pairs of edges, or of vertices and triangles, without a common vertex, whose boxes meet, into found (2, c),
    and their vertices into four (c, 4): those of leaves (p, 2) from the first on, as many as there is room for. Return
    the next pair of leaves, and the number of pairs. The first edge is of the first leaf, or has a lower number.
    """
    at, g = 0, first
    while g < leaves.shape[0] and at + 2 * PER_TWO <= found.shape[1]:
        one, two = leaves[g, 0], leaves[g, 1]
        if of_edges:
            at = write_meeting(tree, one, EDGES, two, EDGES, one == two, found, at)
        else:
            at = write_meeting(tree, one, VERTICES, two, FACES, False, found, at)
            if one != two:
                at = write_meeting(tree, two, VERTICES, one, FACES, False, found, at)
        g += 1
    for c in range(at):
        e, f = int(found[0, c]), int(found[1, c])
        four[c, 0], four[c, 1], four[c, 2], four[c, 3] = vertices_of(tree, of_edges, e, f)
    return g, at


@block_kernel
def edges_at_faces(tree: MovingTree, one: int, two: int, found: Int) -> int:
    """Write edges of a leaf and triangles of another whose boxes meet, without a common vertex, into found (2, c);
    return their number.
    """
    return int(write_meeting(tree, one, EDGES, two, FACES, False, found, 0))
