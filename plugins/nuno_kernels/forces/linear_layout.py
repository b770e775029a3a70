"""The layout of the rows of linear springs and hinges."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from nuno_kernels.compile.reference import by_reference
from nuno_kernels.lanes.simd import WIDTH, Lanes
from nuno_kernels.step.blocks import BLOCK, Long
from nuno_schemas.fabric import Float, Int

if TYPE_CHECKING:
    from nuno_kernels.forces.hinges import HingeRuns
    from nuno_kernels.forces.springs import SpringRuns

SPRING_ROWS, HINGE_ROWS = 4, 9
Rows = tuple[Lanes, ...]
"""rows of eight springs or hinges"""


@by_reference
class LinearRuns(NamedTuple):
    """Runs of springs or hinges: their tasks, each with the column of its first element, and (4 or 9, c) rows."""

    start: Long
    task: Long
    column: Long
    rows: Float


@by_reference
class LinearLists(NamedTuple):
    """Listed springs or hinges: their indices and (4 or 9, p) rows."""

    start: Long
    indices: Int
    rows: Float


Linear = LinearRuns | LinearLists


def linear_runs(rows: int, counts: int) -> Callable[[SpringRuns | HingeRuns], LinearRuns]:
    """Return a function that allocates the rows of runs, whose tasks hold their length in column `counts`."""

    def make(runs: SpringRuns | HingeRuns) -> LinearRuns:
        ends = np.cumsum(runs.task[:, counts])
        return LinearRuns(runs.start, runs.task, ends - runs.task[:, counts], np.zeros((rows, int(ends[-1]) + WIDTH)))

    return make


def linear_lists(rows: int, name: str) -> Callable[[Any], LinearLists]:
    """Return a function that allocates the rows of lists, whose indices are in the field `name`."""

    def make(lists: Any) -> LinearLists:
        indices = getattr(lists, name)
        return LinearLists(lists.start, indices, np.zeros((rows, indices.shape[1])))

    return make


def run_elements(corners: int) -> Callable[[LinearRuns], tuple[Long, Long]]:
    """Return a function that finds columns (p,) and vertices (corners, p) of elements in runs, each once."""

    def find(runs: LinearRuns) -> tuple[Long, Long]:
        block = np.repeat(np.arange(runs.start.shape[0] - 1), np.diff(runs.start))
        once = runs.task[:, 0] // BLOCK == block
        task, column = runs.task[once], runs.column[once]
        count = task[:, corners]
        step = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        return np.repeat(column, count) + step, np.repeat(task[:, :corners], count, axis=0).T + step

    return find


def listed_elements(corners: int) -> Callable[[LinearLists], tuple[Long, Long]]:
    """Return the same for lists, whose padding is at one vertex only."""

    def find(lists: LinearLists) -> tuple[Long, Long]:
        block = np.repeat(np.arange(lists.start.shape[0] - 1), np.diff(lists.start))
        vertices = lists.indices[:corners]
        once = (vertices[0] // BLOCK == block) & (vertices != vertices[0]).any(axis=0)
        return np.flatnonzero(once), vertices[:, once].astype(np.int64)

    return find
