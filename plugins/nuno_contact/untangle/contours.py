"""The cloth as untangling sees it, the contours along which it passes through itself, and the side that each part
belongs to.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_contact.offset.tree import MovingTree, fit_tree, lay_out, make_tree
from nuno_geometry.normals import edge_numbers
from nuno_kernels import block_kernel
from nuno_schemas.fabric import Bool, Fabric, Float, Int
from nuno_schemas.operation import Surface
from nuno_schemas.vectors import dot, norm, unit_rows, vertex_areas

# The cloth as untangling sees it: its mesh, the vertices that may move, and the pieces that meet.

Long = NDArray[np.int64]
HELD = 1e6
"""weight that a held vertex adds to its part of the cloth, in areas of all"""
JITTER = 1e-6
"""Share of the mean edge by which vertices are shifted before they are examined. Grids laid on each other meet edge on
edge and vertex on edge; where nothing does so exactly, a crossing is a crossing."""


class Cloth(NamedTuple):
    """Cloth of n vertices, e edges and f triangles.

    tree  of boxes (nuno_contact.offset.tree), which also has `edges` (e, 2) and `faces` (f, 3)
    side_start (e + 1,), side   triangles at each edge
    ring_start (n + 1,), ring, ring_edge   neighbours of each vertex, and by which edge
    border (n,)  whether a vertex is at an edge of one triangle
    mean  sparse (n, n), the mean of a vertex' neighbours
    weight (n,)  area of a vertex [m^2], more if it is held
    free (n, 1)  1 for vertices that may move, 0 for others
    piece (n,)  the object that a vertex is of; meets (o, o) which objects meet each other
    begun (n, 3)  vertices at the start, put off a little [m]
    edge  mean length of the cloth's edges [m]
    bodies  the piece that bodies are, -1 where there are none
    """

    tree: MovingTree
    side_start: Long
    side: Long
    ring_start: Long
    ring: Long
    ring_edge: Long
    border: Bool
    mean: Any
    weight: Float
    free: Float
    piece: Int
    meets: Bool
    begun: Float
    edge: float
    bodies: int


def make_cloth(fabric: Fabric, objects: Mapping[str, Int], meets: Bool, bodies: Surface | None) -> Cloth:
    """Return the cloth of a fabric and of bodies: one more piece, all held, that does not meet itself."""
    from scipy.sparse import csr_array  # slow to import, for tangled cloth alone

    x, faces, pinned, known = fabric.position, fabric.faces, fabric.pinned, len(objects)
    if bodies is not None:
        x, faces = np.concatenate([x, bodies.vertices]), np.concatenate([faces, bodies.faces + np.int32(fabric.number)])
        pinned = np.concatenate([pinned, np.ones(len(bodies.vertices), np.bool_)])
        meets = np.pad(meets, (0, 1), constant_values=True)
        meets[-1, -1] = False
    n, tree = len(x), make_tree(x, faces, len(fabric.faces))
    numbers, edges = edge_numbers(tree.faces)
    flat, every = numbers.ravel(), np.arange(len(edges))
    order = np.argsort(flat, kind="stable")
    side_start = np.searchsorted(flat[order], np.arange(len(edges) + 1))
    both, through = np.concatenate([edges, edges[:, ::-1]]), np.concatenate([every, every])
    by_vertex = np.lexsort((both[:, 1], both[:, 0]))
    ring_start = np.searchsorted(both[by_vertex, 0], np.arange(n + 1))
    ring, degree = both[by_vertex, 1].astype(np.int64), np.diff(ring_start)
    mean = csr_array((1.0 / np.repeat(degree, degree), ring, ring_start), shape=(n, n))
    border = np.zeros(n, bool)
    border[edges[np.diff(side_start) == 1]] = True
    area = vertex_areas(x, tree.faces)
    of_cloth = edges[edges[:, 1] < fabric.number]
    length = norm(x[of_cloth[:, 1]] - x[of_cloth[:, 0]])
    edge = float(np.cumsum(length)[-1] / len(length))
    piece = np.full(n, known, np.int32)
    for number, vertices in enumerate(objects.values()):
        piece[vertices] = number
    off = JITTER * edge * np.random.default_rng(0).uniform(-1.0, 1.0, x.shape)
    return Cloth(
        tree, side_start, order // 3, ring_start, ring, through[by_vertex], border, mean,
        area + HELD * np.cumsum(area)[-1] * pinned, np.where(pinned, 0.0, 1.0)[:, None],
        piece, meets, x + off, edge, known if bodies is not None else -1,
    )  # fmt: skip


def fit(tree: MovingTree, x: Float, radius: float) -> Float:
    """Fit a tree to vertices x (n, 3), for pairs within a radius [m]; return them as (3, n)."""
    rows, ways = np.ascontiguousarray(x.T), np.zeros((len(x), 8))
    lay_out(rows, np.zeros_like(rows), np.zeros(len(x)), ways)
    fit_tree(tree, ways, radius)
    return rows


# Contours: the lines along which cloth passes through cloth.
#
# Where an edge goes through a triangle there is a node. The triangles at the edge each cut the one that is gone through
# in a segment that begins at the node and ends at the other node that the same two triangles have, or in a vertex that
# they share. Segments joined at nodes are contours (Baraff, Witkin, Kass: Untangling cloth, SIGGRAPH 2003). Along a
# contour two sheets cross, which may be parts of one piece; edges of either make nodes. The sheet of a node's edge is
# the same as that of the next one's just if their segment lies on a triangle that has both edges.


class Nodes(NamedTuple):
    """k edges that go through triangles: by number, and by vertices ends (k, 2) and corners (k, 3).

    shares (k, 2) and (k, 3) of the vertices at the place where they meet, places (k, 3) [m]
    normals (k, 3) of the triangles; heights (k, 2) of the edges' ends above them [m]
    """

    edge: Long
    face: Long
    ends: Long
    corners: Long
    end_shares: Float
    corner_shares: Float
    places: Float
    normals: Float
    heights: Float


class Contours(NamedTuple):
    """The nodes' segments and what they make up.

    one, two (s,)  nodes at both ends of each segment
    number  of contours
    contour (k,)  of each node, and which of its contour's sheets its edge is of: sheet (k,) 0 or 1
    ends (k,)  whether the node is on an edge of one triangle, where its contour ends
    pull (k, 3)  sum of the unit vectors from the node along its segments
    """

    one: Long
    two: Long
    number: int
    contour: Long
    sheet: Long
    ends: Bool
    pull: Float


def make_nodes(cloth: Cloth, x: Float, edge: Long, face: Long) -> Nodes:
    """Return the nodes of edges (k,) that go through triangles (k,), at vertices x (n, 3)."""
    ends, corners = cloth.tree.edges[edge].astype(np.int64), cloth.tree.faces[face].astype(np.int64)
    a, b, c = (x[corners[:, k]] for k in range(3))
    normals = unit_rows(np.cross(b - a, c - a))
    heights = np.stack([dot(x[ends[:, k]] - a, normals) for k in (0, 1)], axis=1)
    way = heights[:, 0] - heights[:, 1]
    t = np.clip(np.divide(heights[:, 0], way, out=np.full(len(way), 0.5), where=way != 0.0), 0.0, 1.0)
    places = x[ends[:, 0]] + t[:, None] * (x[ends[:, 1]] - x[ends[:, 0]])
    u, v, w = b - a, c - a, places - a
    uu, uv, vv, wu, wv = dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v)
    area = uu * vv - uv * uv
    second, third = (
        np.divide(top, area, out=np.full(len(area), 1.0 / 3.0), where=area > 0.0)
        for top in (vv * wu - uv * wv, uu * wv - uv * wu)
    )
    corner_shares = np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, 1.0)
    return Nodes(edge, face, ends, corners, np.stack([1.0 - t, t], axis=1), corner_shares, places, normals, heights)


def find_contours(cloth: Cloth, x: Float, nodes: Nodes) -> Contours:
    """Return the contours of vertices x (n, 3)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    k, faces = len(nodes.edge), cloth.tree.faces
    count = np.diff(cloth.side_start)[nodes.edge]
    node = np.repeat(np.arange(k), count)
    at = np.arange(len(node)) + np.repeat(cloth.side_start[nodes.edge] - (np.cumsum(count) - count), count)
    own, other = cloth.side[at], nodes.face[node]
    key = np.minimum(own, other) * len(faces) + np.maximum(own, other)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    same = same[np.diff(same, prepend=-2) > 1]  # triangles in one plane to rounding may have more than two
    first, second = order[same], order[same + 1]
    one, two = node[first], node[second]
    pull = np.zeros((k, 3))
    along = unit_rows(nodes.places[two] - nodes.places[one])
    np.add.at(pull, one, along)
    np.add.at(pull, two, -along)
    alone = np.ones(len(order), bool)
    alone[same] = alone[same + 1] = False
    left = order[alone]
    shared = (faces[own[left]][:, :, None] == faces[other[left]][:, None, :]).any(axis=2)
    to = faces[own[left], shared.argmax(axis=1)]
    ending = shared.any(axis=1)
    np.add.at(pull, node[left][ending], unit_rows(x[to] - nodes.places[node[left]])[ending])
    # Twice the nodes, one for each sheet that the edge may be of: a contour comes out twice, the sheets exchanged.
    turned = (own[first] != own[second]).astype(np.int64)
    begins, stops = np.concatenate([one, one + k]), np.concatenate([two + k * turned, two + k * (1 - turned)])
    graph = coo_array((np.ones(len(begins)), (begins, stops)), shape=(2 * k, 2 * k))
    label = connected_components(graph, directed=False)[1].astype(np.int64).reshape(2, k)
    least, contour = np.unique(label.min(axis=0), return_inverse=True)
    return Contours(one, two, len(least), contour, (label[0] > label[1]).astype(np.int64), count == 1, pull)


# The direction in which cloth has to move: the part on the wrong side of a contour, and the right side.
#
# A contour that cuts a sheet in two has the smaller part on the wrong side (Baraff, Witkin, Kass 2003). Cut are edges
# that the contour crosses an odd number of times; where a contour ends within a triangle at the sheet's border, what
# little is left of it counts as cut. Both sheets go where the contour is closed and neither part is much larger than
# the other, otherwise only the one that has the smaller part. A part that is held counts as large.
#
# A contour that cuts neither sheet, as where two borders have slid into each other, is made shorter (Volino, Magnenat-
# Thalmann: Resolving surface collisions through intersection contour minimization, SIGGRAPH 2006). With unit vectors r
# from a node along its segments, the edge's direction e and the triangle's normal n, a displacement a of the edge and b
# of the triangle there moves the node by a + e ((b - a) . n) / (e . n), and the contour gets shorter by that times the
# sum of r: steepest for a - b along r - 2 n (r . e) / (n . e). What moves is a sheet, so that all of a contour's nodes
# go the mean way.

ALIKE = 4.0
"""Both sheets of a closed contour move if neither's part is larger than this factor on the other's."""
HALF = 0.5
"""A sheet is cut if at least this share of the nodes on its edges have their ends in different parts."""
GRAZING = 0.1
"""least cosine between an edge and a normal for the change of a contour"""
ONE_WAY = 0.1
"""share of the sum of their lengths that a contour's vectors' sum has at least; otherwise they point all ways"""


class Sides(NamedTuple):
    """Directions of nodes: way (k, 3) that each edge has to go in relation to its triangle; wrong (k,) the vertex of
    the edge that is on the wrong side, -1 if that is unknown. And tangled (n,), vertices that are on the wrong side or
    at a node.
    """

    way: Float
    wrong: Long
    tangled: Bool


@block_kernel
def flood(start: Long, ring: Long, ring_edge: Long, cut: Bool, seeds: Long, label: Long, weight: Float) -> Long:
    """Return the numbers (s,) of the parts that uncut edges join seeds to; label (n,) gets them as well, -1 elsewhere.
    The weight of each part goes into the beginning of weight (n,).
    """
    waiting, count, own = np.empty(label.shape[0], np.int64), 0, weight.copy()
    found = np.empty(seeds.shape[0], np.int64)
    for s in range(seeds.shape[0]):
        if label[seeds[s]] < 0:
            top, total = 1, 0.0
            waiting[0] = seeds[s]
            label[seeds[s]] = count
            while top > 0:
                top -= 1
                v = waiting[top]
                total += own[v]
                for q in range(start[v], start[v + 1]):
                    if not cut[ring_edge[q]] and label[ring[q]] < 0:
                        label[ring[q]] = count
                        waiting[top] = ring[q]
                        top += 1
            weight[count] = total
            count += 1
        found[s] = label[seeds[s]]
    return found


def find_sides(cloth: Cloth, x: Float, nodes: Nodes, contours: Contours, shorten: bool) -> Sides:
    """Return the sides at vertices x (n, 3); with `shorten`, contours are made shorter also where they cut."""
    k, sign = len(nodes.edge), np.where(contours.sheet == 0, 1.0, -1.0)
    way, wrong, known = np.zeros((k, 3)), np.full(k, -1), np.zeros(k, bool)
    tangled = np.zeros(len(x), bool)
    tangled[nodes.ends] = tangled[nodes.corners] = True
    order = np.argsort(contours.contour, kind="stable")
    for own in np.split(order, np.cumsum(np.bincount(contours.contour))[:-1]):
        parted, ends, inside = part(cloth, nodes, contours, own)
        tangled |= inside
        if not parted.any() or shorten:
            way[own], known[own] = sign[own][:, None] * shortening(x, nodes, contours, own, sign[own]), True
            continue
        chosen, at = own[parted], np.arange(len(own))[parted]
        wrong[chosen] = nodes.ends[chosen, ends[at]]
        below = np.where(nodes.heights[chosen, ends[at]] > 0.0, -1.0, 1.0)
        way[chosen], known[chosen] = below[:, None] * nodes.normals[chosen], True
    spread(contours, sign, way, known)
    return Sides(way, wrong, tangled)


def part(cloth: Cloth, nodes: Nodes, contours: Contours, own: Long) -> tuple[Bool, Long, Bool]:
    """Return, for one contour's nodes (m,): which of them have a direction, and which end of the edge is on the wrong
    side; and (n,) the vertices on the wrong side.
    """
    n, edges = len(cloth.weight), cloth.tree.edges
    ends, sheet = nodes.ends[own], contours.sheet[own]
    crossed, times = np.unique(nodes.edge[own], return_counts=True)
    cut = np.zeros(len(edges), bool)
    cut[crossed[times % 2 == 1]] = True
    odd = cut[nodes.edge[own]]
    # If the contour ends inside of a triangle at the border, the triangle's part of the border is cut as well.
    last = nodes.corners[own[contours.ends[own]]]
    bare = np.zeros(n, bool)
    bare[last[cloth.border[last]]] = True
    for vertex in np.flatnonzero(bare):
        cut[cloth.ring_edge[cloth.ring_start[vertex] : cloth.ring_start[vertex + 1]]] = True
    label, weight = np.full(n, -1), cloth.weight.copy()
    label_of = flood(cloth.ring_start, cloth.ring, cloth.ring_edge, cut, ends.ravel(), label, weight).reshape(-1, 2)
    split = odd & (label_of[:, 0] != label_of[:, 1]) & ~bare[ends].any(axis=1)
    lighter = (weight[label_of[:, 0]] > weight[label_of[:, 1]]).astype(np.int64)
    lost = label_of[np.arange(len(own)), lighter]
    cost = [np.inf, np.inf]
    for side in (0, 1):
        mine = sheet == side
        if (here := split & mine).any() and here.sum() >= HALF * mine.sum():
            cost[side] = float(np.cumsum(weight[np.unique(lost[here])])[-1])
    goes = np.zeros(2, bool)
    if min(cost) < np.inf:
        goes[best := int(cost[1] < cost[0])] = True
        goes[1 - best] = not contours.ends[own].any() and cost[1 - best] <= ALIKE * cost[best]
    parted = split & goes[sheet]
    return parted, lighter, np.isin(label, lost[parted]) & (label >= 0)


def shortening(x: Float, nodes: Nodes, contours: Contours, own: Long, sign: Float) -> Float:
    """Return the way (m, 3) that the contour's first sheet has to go in relation to its second to make it shorter."""
    e, n, r = unit_rows(x[nodes.ends[own, 1]] - x[nodes.ends[own, 0]]), nodes.normals[own], contours.pull[own]
    cosine = dot(e, n)
    cosine = np.where(np.abs(cosine) < GRAZING, np.copysign(GRAZING, cosine), cosine)
    steepest = sign[:, None] * (r - 2.0 * (dot(r, e) / cosine)[:, None] * n)
    total, length = np.cumsum(steepest, axis=0)[-1:], norm(steepest)
    if float(norm(total)[0]) > ONE_WAY * float(np.cumsum(length)[-1]):
        return np.repeat(unit_rows(total), len(own), axis=0)
    longest = float(length.max())
    return steepest / longest if longest > 0.0 else steepest


def spread(contours: Contours, sign: Float, way: Float, known: Bool) -> None:
    """Give the nodes without a way that of those next to them on the contour, in place."""
    while True:
        total, count = np.zeros_like(way), np.zeros(len(way))
        for one, two in ((contours.one, contours.two), (contours.two, contours.one)):
            np.add.at(total, one, (sign * known)[two][:, None] * way[two])
            np.add.at(count, one, known[two])
        new = ~known & (count > 0)
        if not new.any():
            return
        way[new] = sign[new][:, None] * unit_rows(total[new])
        known |= new
