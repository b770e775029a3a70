"""The cloth as untangling sees it: its mesh, the vertices that may move, and the pieces that meet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_contact.offset.tree import Tree, fit_tree, make_tree
from nuno_geometry.normals import edge_numbers
from nuno_schemas.fabric import Bool, Fabric, Float, Int
from nuno_schemas.operation import Surface
from nuno_schemas.vectors import norm

Long = NDArray[np.int64]
HELD = 1e6
"""weight that a held vertex adds to its part of the cloth, in areas of all (nuno_contact.untangle.sides)"""
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

    tree: Tree
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
    a, b, c = (x[tree.faces[:, k]] for k in range(3))
    area = np.bincount(tree.faces.ravel(), np.repeat(norm(np.cross(b - a, c - a)) / 6.0, 3), n)
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


def fit(tree: Tree, x: Float) -> Float:
    """Fit a tree to vertices x (n, 3); return them as (3, n)."""
    rows = np.ascontiguousarray(x.T)
    fit_tree(tree, rows, np.zeros_like(rows), np.zeros(len(x)))
    return rows
