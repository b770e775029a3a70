"""The plan of a factorisation: where every element goes, found before any of its numbers is known."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from nuno_integrators.implicit.dissection import dissect
from nuno_integrators.implicit.fronts import Fronts, fill_fronts, lay_out
from nuno_integrators.implicit.matrix import Linear
from nuno_kernels.step.blocks import Long
from nuno_kernels.terms import role_of
from nuno_schemas.fabric import Float


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
        None if rows is None or (find := role_of(type(term), "elements")) is None else find(rows)
        for term, rows in zip(linear.forces, linear.rows, strict=True)
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
