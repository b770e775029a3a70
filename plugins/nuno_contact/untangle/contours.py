"""Contours: the lines along which cloth passes through cloth.

Where an edge goes through a triangle there is a node. The triangles at the edge each cut the one that is gone through
in a segment that begins at the node and ends at the other node that the same two triangles have, or in a vertex that
they share. Segments joined at nodes are contours (Baraff, Witkin, Kass: Untangling cloth, SIGGRAPH 2003). Along a
contour two sheets cross, which may be parts of one piece; edges of either make nodes. The sheet of a node's edge is the
same as that of the next one's just if their segment lies on a triangle that has both edges.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_contact.untangle.cloth import Cloth, Long
from nuno_schemas.fabric import Bool, Float
from nuno_schemas.vectors import dot, norm


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


def units(v: Float) -> Float:
    """Return v (k, 3) at length 1; of none, 0."""
    length = norm(v)[:, None]
    return np.divide(v, length, out=np.zeros_like(v), where=length > 0.0)


def make_nodes(cloth: Cloth, x: Float, edge: Long, face: Long) -> Nodes:
    """Return the nodes of edges (k,) that go through triangles (k,), at vertices x (n, 3)."""
    ends, corners = cloth.tree.edges[edge].astype(np.int64), cloth.tree.faces[face].astype(np.int64)
    a, b, c = (x[corners[:, k]] for k in range(3))
    normals = units(np.cross(b - a, c - a))
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
    along = units(nodes.places[two] - nodes.places[one])
    np.add.at(pull, one, along)
    np.add.at(pull, two, -along)
    alone = np.ones(len(order), bool)
    alone[same] = alone[same + 1] = False
    left = order[alone]
    shared = (faces[own[left]][:, :, None] == faces[other[left]][:, None, :]).any(axis=2)
    to = faces[own[left], shared.argmax(axis=1)]
    ending = shared.any(axis=1)
    np.add.at(pull, node[left][ending], units(x[to] - nodes.places[node[left]])[ending])
    # Twice the nodes, one for each sheet that the edge may be of: a contour comes out twice, the sheets exchanged.
    turned = (own[first] != own[second]).astype(np.int64)
    begins, stops = np.concatenate([one, one + k]), np.concatenate([two + k * turned, two + k * (1 - turned)])
    graph = coo_array((np.ones(len(begins)), (begins, stops)), shape=(2 * k, 2 * k))
    label = connected_components(graph, directed=False)[1].astype(np.int64).reshape(2, k)
    least, contour = np.unique(label.min(axis=0), return_inverse=True)
    return Contours(one, two, len(least), contour, (label[0] > label[1]).astype(np.int64), count == 1, pull)
