"""The dense fronts that a sparse factorisation goes through.

Multifrontal Cholesky (Duff & Reid 1983, ACM Trans. Math. Softw. 9, 302-325): every node of the dissection
has a dense front over its own vertices and the later ones that they are coupled to, themselves or through
what was eliminated before them. Its own rows are eliminated there; what is left is added to the parent's.
nuno_integrators.implicit.factor says which libraries were weighed.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from nuno_integrators.implicit.dissection import Tree
from nuno_kernels.step.blocks import Long

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
