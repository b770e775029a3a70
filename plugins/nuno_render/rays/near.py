"""Points near a place: sorted into cells as wide as the reach, so that near ones are in nine runs of three cells."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import kernel
from nuno_schemas.fabric import Float


class SortedPoints(NamedTuple):
    """Points sorted into cells: points (n, 3) [m] in the order of their cells, key (n,) of each cell, values (n,); the
    lowest corner (3,), cells along each axis (3,), and the reach [m].
    """

    points: Float
    key: NDArray[np.int64]
    values: Float
    low: Float
    shape: NDArray[np.int64]
    reach: float


def sort_points(points: Float, values: Float, reach: float) -> SortedPoints:
    """Sort points (n, 3) [m] into cells of a reach, without those that are not finite."""
    finite = np.logical_and.reduce(np.isfinite(points), axis=1)
    points, values = points[finite], values[finite]
    low = points.min(axis=0) - reach if len(points) else np.zeros(3)
    cell = np.floor((points - low) / reach).astype(np.int64)
    shape = cell.max(axis=0, initial=0) + 3
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    return SortedPoints(
        np.ascontiguousarray(points[order]), key[order], values[order].astype(np.float64), low, shape, reach
    )


@kernel
def sum_near(x: float, y: float, z: float, cells: Any) -> tuple[int, float]:
    """Return (count, sum of values) of the points within the reach of a place."""
    reach, low, shape = cells.reach, cells.low, cells.shape
    i, j = int(np.floor((x - low[0]) / reach)), int(np.floor((y - low[1]) / reach))
    k = int(np.floor((z - low[2]) / reach))
    count, total = 0, 0.0
    first, last = max(k - 1, 0), min(k + 1, shape[2] - 1)
    if last < first:
        return count, total
    for a in range(max(i - 1, 0), min(i + 1, shape[0] - 1) + 1):
        for b in range(max(j - 1, 0), min(j + 1, shape[1] - 1) + 1):
            row = (a * shape[1] + b) * shape[2]
            for p in range(np.searchsorted(cells.key, row + first), np.searchsorted(cells.key, row + last + 1)):
                dx, dy, dz = cells.points[p, 0] - x, cells.points[p, 1] - y, cells.points[p, 2] - z
                if dx * dx + dy * dy + dz * dz <= reach * reach:
                    count += 1
                    total += cells.values[p]
    return count, total
