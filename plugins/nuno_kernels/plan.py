"""The plan of a factorisation: where every element goes, all that is known before any number is."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from nuno_kernels.blocks import BLOCK, Long
from nuno_kernels.dissection import dissect
from nuno_kernels.fronts import Fronts, fill_fronts, lay_out
from nuno_kernels.linear_layout import LinearLists, LinearRuns
from nuno_kernels.matrix import Linear
from nuno_schemas.fabric import Float


class Elements(NamedTuple):
    """Where p springs, hinges or pairs of links go.

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
    """A factorisation: its fronts, the numbers that it keeps and those that it needs meanwhile, and where each
    kind of element goes.
    """

    fronts: Fronts
    entries: int
    scratch: int
    runs: Elements | None
    lists: Elements | None
    hinge_runs: Elements | None
    hinge_lists: Elements | None
    yarns: Elements | None


def make_plan(position: Float, linear: Linear) -> Plan:
    """Plan for vertices at rest at (n, 3) that a matrix couples; pinned ones are not part of it."""
    free = np.flatnonzero(linear.inverse_mass > 0.0)
    number = np.full(position.shape[0], -1, np.int64)
    number[free] = np.arange(free.shape[0])
    found = [
        None if linear.runs is None else _run_elements(linear.runs, 2),
        None if linear.lists is None else _list_elements(linear.lists, 2),
        None if linear.hinge_runs is None else _run_elements(linear.hinge_runs, 4),
        None if linear.hinge_lists is None else _list_elements(linear.hinge_lists, 4),
        None if linear.yarns is None else _list_elements(linear.yarns, 3),
    ]
    pairs = [np.empty((0, 2), np.int64), *(_edges(number[item[1]]) for item in found if item is not None)]
    edges = np.unique(np.concatenate(pairs), axis=0)
    tree = dissect(position[free], edges)
    order = np.concatenate([*tree.vertices, np.empty(0, np.int64)])
    rank = np.full(position.shape[0], -1, np.int64)
    rank[free[order]] = np.arange(order.shape[0])
    ranks = fill_fronts(tree, rank[free[edges]])
    fronts, entries, scratch = lay_out(tree, ranks, free[order])
    elements = [None if item is None else _place(fronts, ranks, rank, *item) for item in found]
    return Plan(fronts, entries, scratch, *elements)


def _run_elements(runs: LinearRuns, corners: int) -> tuple[Long, Long]:
    """(p,) columns and (corners, p) vertices of the elements in runs, each once: by its first vertex's block."""
    block = np.repeat(np.arange(runs.start.shape[0] - 1), np.diff(runs.start))
    once = runs.task[:, 0] // BLOCK == block
    task, column = runs.task[once], runs.column[once]
    count = task[:, corners]
    step = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    return np.repeat(column, count) + step, np.repeat(task[:, :corners], count, axis=0).T + step


def _list_elements(lists: LinearLists, corners: int) -> tuple[Long, Long]:
    """The same of lists; what pads them is at one vertex only."""
    block = np.repeat(np.arange(lists.start.shape[0] - 1), np.diff(lists.start))
    vertices = lists.indices[:corners]
    once = (vertices[0] // BLOCK == block) & (vertices != vertices[0]).any(axis=0)
    return np.flatnonzero(once), vertices[:, once].astype(np.int64)


def _pairs(corners: int) -> list[tuple[int, int]]:
    return list(itertools.combinations(range(corners), 2))


def _edges(corners: Long) -> Long:
    """(e, 2) pairs, the lower first, among the corners (2, 3 or 4, p) of elements, without the pinned ones (-1)."""
    pairs = np.concatenate([corners[[i, j]] for i, j in _pairs(corners.shape[0])], axis=1).T
    return np.sort(pairs[(pairs >= 0).all(axis=1) & (pairs[:, 0] != pairs[:, 1])], axis=1)


def _place(fronts: Fronts, ranks: list[Long], rank: Long, column: Long, vertices: Long) -> Elements:
    """Where elements go: a pair's block is in the front that eliminates the first of the two."""
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
