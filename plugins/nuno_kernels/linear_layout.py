"""Where the rows of linear springs and hinges are kept."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_kernels.blocks import Long
from nuno_kernels.hinges import HingeLists, HingeRuns
from nuno_kernels.simd import WIDTH
from nuno_kernels.springs import SpringLists, SpringRuns
from nuno_schemas.fabric import Float, Int

SPRING_ROWS, HINGE_ROWS = 4, 9


class LinearRuns(NamedTuple):
    """Runs of springs or hinges: their tasks, each with the column of its first element, and (4 or 9, c) rows."""

    start: Long
    task: Long
    column: Long
    rows: Float


class LinearLists(NamedTuple):
    """Listed springs or hinges: their indices and (4 or 9, p) rows."""

    start: Long
    indices: Int
    rows: Float


def linear_runs(runs: SpringRuns | HingeRuns | None, rows: int, counts: int) -> LinearRuns | None:
    """Room for the rows of runs, whose tasks hold their length in column `counts`."""
    if runs is None:
        return None
    ends = np.cumsum(runs.task[:, counts])
    return LinearRuns(runs.start, runs.task, ends - runs.task[:, counts], np.zeros((rows, int(ends[-1]) + WIDTH)))


def linear_lists(start: Long, indices: Int, rows: int) -> LinearLists:
    """Room for the rows of lists."""
    return LinearLists(start, indices, np.zeros((rows, indices.shape[1])))


def linear_springs(runs: SpringRuns | None, lists: SpringLists | None) -> tuple[LinearRuns | None, LinearLists | None]:
    """Room for the springs' rows."""
    found = None if lists is None else linear_lists(lists.start, lists.ends, SPRING_ROWS)
    return linear_runs(runs, SPRING_ROWS, 2), found


def linear_hinges(runs: HingeRuns | None, lists: HingeLists | None) -> tuple[LinearRuns | None, LinearLists | None]:
    """Room for the hinges' rows."""
    found = None if lists is None else linear_lists(lists.start, lists.corners, HINGE_ROWS)
    return linear_runs(runs, HINGE_ROWS, 4), found
