"""Topology of a grid of quads, written as runs: faces, springs and hinges.

Vertex (r, c) has number r * cols + c. Columns run to the right and rows down as seen from
outside. Warp yarns run down (from row to row), weft yarns to the right (from column to column).
A periodic grid is a tube: its last column is joined to its first.

    v00 --- v01    Diagonals alternate like a chessboard: cell (r, c) is cut from v00 to v11
     |       |     where r + c is even, from v01 to v10 where it is odd, so that the drawn surface
    v10 --- v11    has no grain. Springs and hinges do not depend on it (constants.py).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from nuno_cloth.fabrics.constants import Constants
from nuno_schemas.fabric import BENDING, SHEAR, STRUCTURAL, Float, Hinges, Int, Springs


@dataclass(frozen=True)
class Grid:
    """A grid of rows x cols vertices. A periodic one has an even number of columns, at least 4."""

    rows: int
    cols: int
    periodic: bool = False

    @property
    def number(self) -> int:
        return self.rows * self.cols

    @property
    def cells_across(self) -> int:
        return self.cols if self.periodic else self.cols - 1

    def at(self, row: int, col: int) -> int:
        return row * self.cols + (col % self.cols if self.periodic else col)

    def segments(self, low: int, high: int, reach: tuple[int, int]) -> Iterator[tuple[int, int]]:
        """Yield column ranges [first, last] within low..high inside which no column wraps.

        `reach` is the lowest and highest column offset that an element at a column uses.
        """
        left, right = max(low, -reach[0]), min(high, self.cols - 1 - reach[1])
        for col in range(low, left):
            yield col, col
        if left <= right:
            yield left, right
        for col in range(right + 1, high + 1):
            yield col, col


def build_faces(grid: Grid) -> Int:
    """Return triangles (2 cells, 3) int32, counter-clockwise seen from outside."""
    rows = np.arange(grid.rows - 1, dtype=np.int32)[:, None]
    cols = np.arange(grid.cells_across, dtype=np.int32)[None, :]
    v00, v10 = rows * grid.cols + cols, (rows + 1) * grid.cols + cols
    right = (cols + 1) % grid.cols if grid.periodic else cols + 1
    v01, v11 = rows * grid.cols + right, (rows + 1) * grid.cols + right
    even = ((rows + cols) % 2 == 0)[..., None]
    first = np.where(even, np.stack([v00, v10, v11], -1), np.stack([v00, v10, v01], -1))
    second = np.where(even, np.stack([v00, v11, v01], -1), np.stack([v01, v10, v11], -1))
    return np.ascontiguousarray(np.stack([first, second], 2).reshape(-1, 3), np.int32)


class _Runs:
    """A list of runs. Runs of one row stay together, so that a sweep reads memory in order."""

    def __init__(self) -> None:
        self.first: list[tuple[int, ...]] = []
        self.count: list[int] = []
        self.values: list[tuple[float, ...]] = []

    def add(self, first: tuple[int, ...], count: int, *values: float) -> None:
        self.first.append(first)
        self.count.append(count)
        self.values.append(values)

    def arrays(self) -> tuple[Int, Int, Int, Float]:
        count = np.array(self.count, np.int32)
        values = np.ascontiguousarray(np.array(self.values, np.float64).T)
        return np.array(self.first, np.int32), count, np.ones_like(count), values


def build_springs(grid: Grid, constants: Constants) -> Springs | None:
    """Return springs as runs along rows, with constants per run, without families of stiffness 0."""
    runs = _Runs()
    for row in range(grid.rows):
        _add_structural(runs, grid, constants, row)
        if row + 1 < grid.rows and constants.shear_k[row] > 0:
            for side in (1, -1):
                low, high = (0, grid.cells_across - 1) if side == 1 else ((0 if grid.periodic else 1), grid.cols - 1)
                spring = constants.shear_k[row], constants.shear_rest[row], constants.shear_c[row], SHEAR
                _add_springs(runs, grid, row, (low, high), (1, side), spring)
        _add_bending(runs, grid, constants, row)
    if not runs.count:
        return None
    first, count, stride, values = runs.arrays()
    return Springs(
        first, count, stride, values[0].copy(), values[1].copy(), values[2].copy(), values[3].astype(np.int8)
    )


def _add_structural(runs: _Runs, grid: Grid, constants: Constants, row: int) -> None:
    if constants.weft_k[row] > 0:
        spring = constants.weft_k[row], constants.weft_rest[row], constants.weft_c[row], STRUCTURAL
        _add_springs(runs, grid, row, (0, grid.cells_across - 1), (0, 1), spring)
    if row + 1 == grid.rows or constants.warp_k[row] <= 0:
        return
    k, rest, c = constants.warp_k[row], constants.warp_rest[row], constants.warp_c[row]
    border, last = constants.border, grid.cols - 1
    if grid.periodic or border == 1.0:
        runs.add((grid.at(row, 0), grid.at(row + 1, 0)), grid.cols, k, rest, c, STRUCTURAL)
        return
    # A border spring has half the stiffness and half the mass, so half the damping too.
    runs.add((grid.at(row, 0), grid.at(row + 1, 0)), 1, k * border, rest, c * border, STRUCTURAL)
    if last > 1:
        runs.add((grid.at(row, 1), grid.at(row + 1, 1)), last - 1, k, rest, c, STRUCTURAL)
    runs.add((grid.at(row, last), grid.at(row + 1, last)), 1, k * border, rest, c * border, STRUCTURAL)


def _add_bending(runs: _Runs, grid: Grid, constants: Constants, row: int) -> None:
    """Add the papers' bending springs, between vertices two apart."""
    if constants.bend_weft_k > 0:
        spring = constants.bend_weft_k, 2 * constants.weft_rest[row], constants.bend_weft_c[row], BENDING
        # On a tube of 4 columns the spring (c, c + 2) would be the spring (c + 2, c) again.
        high = grid.cols - 3 if not grid.periodic else (grid.cols - 1 if grid.cols > 4 else 1)
        _add_springs(runs, grid, row, (0, high), (0, 2), spring)
    if constants.bend_warp_k > 0 and row + 2 < grid.rows:
        rest = constants.warp_rest[row] + constants.warp_rest[row + 1]
        spring = constants.bend_warp_k, rest, constants.bend_warp_c[row], BENDING
        _add_springs(runs, grid, row, (0, grid.cols - 1), (2, 0), spring)


def _add_springs(
    runs: _Runs, grid: Grid, row: int, cols: tuple[int, int], step: tuple[int, int], spring: tuple[float, ...]
) -> None:
    """Add springs from (row, c) to (row + step[0], c + step[1]) for all columns c in `cols`."""
    reach = min(step[1], 0), max(step[1], 0)
    for low, high in grid.segments(*cols, reach):
        runs.add((grid.at(row, low), grid.at(row + step[0], low + step[1])), high - low + 1, *spring)


Corners = tuple[tuple[int, int], tuple[int, int], tuple[int, int], tuple[int, int]]
"""Edge start, edge end, opposite left, opposite right as (row, column) offsets; the triangle
(start, end, left) is counter-clockwise seen from outside."""

WARP_LINE: Corners = ((0, 0), (0, 1), (-1, 0), (1, 0))
WARP_LINE_LAST: Corners = ((0, -1), (0, 0), (-1, 0), (1, 0))
WEFT_LINE: Corners = ((0, 0), (1, 0), (0, 1), (0, -1))
WEFT_LINE_LAST: Corners = ((-1, 0), (0, 0), (0, 1), (0, -1))
TWIST: Corners = ((0, 0), (1, 1), (0, 1), (1, 0))


def build_hinges(grid: Grid, constants: Constants) -> Hinges | None:
    """Return hinges as runs along rows, flat at rest, with constants per run."""
    runs = _Runs()
    last_row, last = grid.rows - 1, grid.cols - 1
    inner = (0, last) if grid.periodic else (1, last - 1)
    for row in range(grid.rows):
        if 0 < row < last_row:
            k = constants.hinge_warp[row]
            if grid.periodic:
                _add_hinges(runs, grid, row, (0, last), WARP_LINE, k)
            else:
                _add_hinges(runs, grid, row, (0, 0), WARP_LINE, k * constants.border)
                _add_hinges(runs, grid, row, (1, last - 1), WARP_LINE, k)
                _add_hinges(runs, grid, row, (last, last), WARP_LINE_LAST, k * constants.border)
        line = WEFT_LINE if row < last_row else WEFT_LINE_LAST
        _add_hinges(runs, grid, row, inner, line, constants.hinge_weft[row])
        if row < last_row:
            _add_hinges(runs, grid, row, (0, grid.cells_across - 1), TWIST, constants.hinge_twist[row])
    if not runs.count:
        return None
    first, count, stride, values = runs.arrays()
    return Hinges(first, count, stride, values[0].copy(), np.zeros_like(values[0]))


def _add_hinges(runs: _Runs, grid: Grid, row: int, cols: tuple[int, int], corners: Corners, k: float) -> None:
    if k <= 0:
        return
    offsets = [col for _, col in corners]
    for low, high in grid.segments(*cols, (min(offsets), max(offsets))):
        runs.add(tuple(grid.at(row + dr, low + dc) for dr, dc in corners), high - low + 1, k)
