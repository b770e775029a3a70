"""An order of elimination that keeps a factor of the matrix sparse: nested dissection by coordinates.

A set of vertices is cut into two halves and the few vertices between them, its separator, which come
last; so are the halves in turn (George 1973, SIAM J. Numer. Anal. 10, 345-363). On a sheet of n vertices the
factor then has O(n log n) entries and takes O(n^1.5) operations, a band O(n^1.5) and O(n^2). Cuts go across a
coordinate axis: cloth at rest is flat or a tube, and its own graph says less about where it is narrow.

Weighed: METIS, which cuts graphs whose vertices have no places, and whose cuts are another version's another time; the
order decides the bits of every solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Float

LEAF = 20
"""vertices of a set that is not cut further: its block is nearly dense"""
MIDDLE = 0.4
"""share of the vertices that each half has at least; within that the smallest separator is taken"""


@dataclass
class Tree:
    """Nodes of the dissection, children before their parents.

    vertices  of each node, in the order of elimination
    parent    of each node, -1 for roots
    """

    vertices: list[Long]
    parent: list[int]

    def add(self, vertices: Long, children: list[int]) -> int:
        """Add a node above these children; return its number."""
        self.vertices.append(vertices)
        self.parent.append(-1)
        for child in children:
            self.parent[child] = len(self.parent) - 1
        return len(self.parent) - 1


def dissect(position: Float, edges: Long) -> Tree:
    """Order vertices (n, 3) that are coupled by edges (e, 2)."""
    tree = Tree([], [])
    local = np.zeros(position.shape[0], np.int64)
    _dissect(np.arange(position.shape[0]), edges, position, local, tree)
    return tree


def _dissect(vertices: Long, edges: Long, position: Float, local: Long, tree: Tree) -> list[int]:
    """Return the roots of the tree of these vertices; `local` is scratch."""
    if vertices.shape[0] <= LEAF:
        return [tree.add(vertices, [])] if vertices.shape[0] else []
    local[vertices] = np.arange(vertices.shape[0])
    part = _cut(position[vertices], local[edges])
    halves = [vertices[part == side] for side in (0, 1)]
    within = part[local[edges]]
    inner = [edges[(within == side).all(axis=1)] for side in (0, 1)]
    tops = []
    for half, own in zip(halves, inner, strict=True):
        tops += _dissect(half, own, position, local, tree)
    between = vertices[part == 2]
    return [tree.add(between, tops)] if between.shape[0] else tops


def _cut(position: Float, edges: Long) -> Long:
    """Return (n,) 0 or 1 for the halves, 2 for the separator, of vertices (n, 3) with local edges (e, 2)."""
    n = position.shape[0]
    low, high = int(MIDDLE * n), n - int(MIDDLE * n)
    found = []
    for axis in range(3):
        # Ties go by the other axes, so that a cut runs along a row and not through it at random.
        order = np.lexsort((position[:, axis - 2], position[:, axis - 1], position[:, axis]))
        rank = np.empty(n, np.int64)
        rank[order] = np.arange(n)
        ends = np.sort(rank[edges], axis=1)
        reach = np.arange(n)
        np.maximum.at(reach, ends[:, 0], ends[:, 1])
        # A vertex is in the separator of every cut between it and the furthest that it is coupled to:
        # cut c has the vertices of rank < c on its left.
        change = np.bincount(np.arange(n) + 1, minlength=n + 2) - np.bincount(reach + 1, minlength=n + 2)
        size = np.cumsum(change)[low : high + 1]
        best = np.flatnonzero(size == size.min()) + low
        cut = int(best[np.argmin(np.abs(2 * best - n))])
        found.append((int(size.min()), axis, np.where(rank >= cut, 1, np.where(reach[rank] >= cut, 2, 0))))
    return min(found, key=lambda item: item[:2])[2]
