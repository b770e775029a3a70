"""The plan of a factorisation: an order of elimination, dense fronts, and where every element goes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nuno_integrators.implicit.matrix import Linear
from nuno_kernels.step.blocks import Long
from nuno_kernels.terms import kernels_of
from nuno_schemas.fabric import Float

# An order of elimination that keeps a factor of the matrix sparse: nested dissection by coordinates.
#
# A set of vertices is cut into two halves and the few vertices between them, its separator, which come
# last; so are the halves in turn (George 1973, SIAM J. Numer. Anal. 10, 345-363). On a sheet of n vertices the
# factor then has O(n log n) entries and takes O(n^1.5) operations, a band O(n^1.5) and O(n^2). Cuts go across a
# coordinate axis: cloth at rest is flat or a tube, and its own graph says less about where it is narrow.
#
# Weighed: METIS, which cuts graphs whose vertices have no places, and whose cuts are another version's another time;
# the order decides the bits of every solution.

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


# The dense fronts that a sparse factorisation goes through.
#
# Multifrontal Cholesky (Duff & Reid 1983, ACM Trans. Math. Softw. 9, 302-325): every node of the dissection
# has a dense front over its own vertices and the later ones that they are coupled to, themselves or through
# what was eliminated before them. Its own rows are eliminated there; what is left is added to the parent's.
# nuno_integrators.implicit.factor says which libraries were weighed.

OVERHANG = 16
"""Columns after a row that a tile of the kernels may reach into."""
TILE = 4
"""Rows of a tile: rows are padded to whole ones."""


class Fronts(NamedTuple):
    """Fronts of f nodes, children before parents; sizes are in vertices, places in numbers.

    own, size    (f,) vertices eliminated in a front, and all of it
    parent       (f,) or -1
    fresh        (f,) bit 0: nothing was added to this front before; bit 1: it is the first to add to its parent's
    start        (f,) where each front's vertices begin in
    vertices     (s,) its own, then the others, in the order of elimination
    place        (s,) where each of the others stands in the parent's front
    panel, width (f,) where a front's own rows begin in the factor, and their length
    rest, reach  (f,) where the rows left over begin in the scratch, and their length
    """

    own: Long
    size: Long
    parent: Long
    fresh: Long
    start: Long
    vertices: Long
    place: Long
    panel: Long
    width: Long
    rest: Long
    reach: Long


def fill_fronts(tree: Tree, edges: Long) -> list[Long]:
    """Return, for every node, the ranks of its front, given the ranks of edges (e, 2)."""
    edges = np.sort(edges, axis=1)
    edges = edges[np.argsort(edges[:, 0], kind="stable")]
    sizes = np.array([part.shape[0] for part in tree.vertices], np.int64)
    ends = np.cumsum(sizes)
    bounds = np.searchsorted(edges[:, 0], np.concatenate([[0], ends]))
    others: list[list[Long]] = [[edges[a:b, 1]] for a, b in itertools.pairwise(bounds)]
    ranks = []
    for node, (end, parent) in enumerate(zip(ends, tree.parent, strict=True)):
        later = np.unique(np.concatenate(others[node]))
        later = later[later >= end]
        if parent >= 0:
            others[parent].append(later)
        ranks.append(np.concatenate([np.arange(end - sizes[node], end), later]))
    return ranks


def _row_length(vertices: Long) -> Long:
    """Return the length of rows over this many vertices with the overhang: an odd number of vectors, since a power of
    two would put all rows into the same cache lines.
    """
    return 8 * ((3 * vertices + OVERHANG + 7) // 8 | 1)


def lay_out(tree: Tree, ranks: list[Long], vertices: Long) -> tuple[Fronts, int, int]:
    """Return the fronts, and the sizes of factor and scratch, for `vertices` by rank."""
    own = np.array([part.shape[0] for part in tree.vertices], np.int64)
    size = np.array([part.shape[0] for part in ranks], np.int64)
    parent = np.array(tree.parent, np.int64)
    width, reach = _row_length(size), _row_length(size - own)
    panels = np.cumsum(-(-3 * own // TILE) * TILE * width)
    left = -(-3 * (size - own) // TILE) * TILE * reach
    # A front's remainder is added to its parent's at once, so that it needs room beyond its ancestors' only.
    rest, fresh = np.zeros_like(own), np.ones_like(own)
    for node in range(own.shape[0] - 1, -1, -1):
        if parent[node] >= 0:
            rest[node] = rest[parent[node]] + left[parent[node]]
    place = np.zeros(int(size.sum()), np.int64)
    start = np.cumsum(size) - size
    for node, above in enumerate(tree.parent):
        if above >= 0:
            fresh[node] |= 2 * (fresh[above] & 1)
            fresh[above] &= 2
            found = np.searchsorted(ranks[above], ranks[node][own[node] :])
            place[start[node] + own[node] : start[node] + size[node]] = found
    everything = vertices[np.concatenate([*ranks, np.empty(0, np.int64)])]
    fronts = Fronts(
        own, size, parent, fresh, start, everything, place, panels - np.diff(panels, prepend=0), width, rest, reach
    )
    return fronts, int(panels[-1]) if panels.size else 0, int((rest + left).max(initial=0))


# The plan of a factorisation: where every element goes, found before any of its numbers is known.


class Elements(NamedTuple):
    """Places of p springs, hinges or pairs of links in the factor.

    column    (p,) of their rows
    vertices  (2, 3 or 4, p)
    at        (1, 3 or 6, p) where the block of each pair of vertices begins in the factor, -1 if one is pinned
    width     (1, 3 or 6, p) distance of that block's rows, negative where the second is eliminated first
    """

    column: Long
    vertices: Long
    at: Long
    width: Long


class Plan(NamedTuple):
    """A factorisation: its fronts, the number of entries that it keeps and of those that it needs meanwhile, and where
    the elements of each term go, None for one without a matrix.
    """

    fronts: Fronts
    entries: int
    scratch: int
    elements: tuple[Elements | None, ...]


def make_plan(position: Float, linear: Linear) -> Plan:
    """Return the plan for vertices at rest at (n, 3) that a matrix couples, without the pinned ones."""
    free = np.flatnonzero(linear.inverse_mass > 0.0)
    number = np.full(position.shape[0], -1, np.int64)
    number[free] = np.arange(free.shape[0])
    found = [
        None if rows is None or (find := kernels_of(term).find("elements")) is None else find(rows)
        for term, rows in zip(linear.forces, linear.forces.rows, strict=True)
    ]
    pairs = [np.empty((0, 2), np.int64), *(_edges(number[item[1]]) for item in found if item is not None)]
    edges = np.unique(np.concatenate(pairs), axis=0)
    tree = dissect(position[free], edges)
    order = np.concatenate([*tree.vertices, np.empty(0, np.int64)])
    rank = np.full(position.shape[0], -1, np.int64)
    rank[free[order]] = np.arange(order.shape[0])
    ranks = fill_fronts(tree, rank[free[edges]])
    fronts, entries, scratch = lay_out(tree, ranks, free[order])
    elements = tuple(None if item is None else _place(fronts, ranks, rank, *item) for item in found)
    return Plan(fronts, entries, scratch, elements)


def _pairs(corners: int) -> list[tuple[int, int]]:
    return list(itertools.combinations(range(corners), 2))


def _edges(corners: Long) -> Long:
    """Return pairs (e, 2), lower first, among the corners (2, 3 or 4, p) of elements, without pinned ones (-1)."""
    pairs = np.concatenate([corners[[i, j]] for i, j in _pairs(corners.shape[0])], axis=1).T
    return np.sort(pairs[(pairs >= 0).all(axis=1) & (pairs[:, 0] != pairs[:, 1])], axis=1)


def _place(fronts: Fronts, ranks: list[Long], rank: Long, column: Long, vertices: Long) -> Elements:
    """Return where elements go: a pair's block is in the front that eliminates the first of the two."""
    total = max(1, rank.shape[0])
    node_of = np.repeat(np.arange(fronts.own.shape[0]), fronts.own)
    keys = np.concatenate([part + node * total for node, part in enumerate(ranks)] or [np.empty(0, np.int64)])
    at = np.full((len(_pairs(vertices.shape[0])), column.shape[0]), -1, np.int64)
    width = np.zeros_like(at)
    for row, (i, j) in enumerate(_pairs(vertices.shape[0])):
        a, b = rank[vertices[i]], rank[vertices[j]]
        free = np.flatnonzero((a >= 0) & (b >= 0) & (a != b))
        low, high = np.minimum(a, b)[free], np.maximum(a, b)[free]
        node = node_of[low]
        first, second = (np.searchsorted(keys, node * total + part) - fronts.start[node] for part in (low, high))
        length = fronts.width[node]
        at[row, free] = fronts.panel[node] + 3 * first * length + 3 * second
        width[row, free] = np.where(a[free] < b[free], length, -length)
    return Elements(column, np.ascontiguousarray(vertices), at, width)
