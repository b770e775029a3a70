"""Triangles of a flat piece of cloth: a Delaunay triangulation of points spread evenly inside an outline."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.vectors import sides

INSET = 0.6
"""Least distance of inner points from the outline, in spacings: nearer ones would give flat triangles."""
ROUNDS = 10
"""Number of times that inner points move to the mean of their neighbours."""


def fill_outline(outline: Float, spacing: float) -> tuple[Float, Int]:
    """Return points (n, 2), the outline's (m, 2) first, and triangles (f, 3), counter-clockwise.

    The outline is simple, counter-clockwise, and has its points about `spacing` apart.
    """
    grid = lay_grid(outline, spacing)
    far = distances(grid, np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)).min(axis=1)
    inner = grid[is_inside(grid, outline) & (far > INSET * spacing)]
    points = np.concatenate([outline, inner])
    faces = triangulate(points)
    faces = faces[is_inside(points[faces].mean(axis=1), outline)]
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    count = np.bincount(start, minlength=len(points))[:, None]
    for _ in range(ROUNDS):
        mean = np.stack([np.bincount(start, points[end, k], len(points)) for k in (0, 1)], axis=1) / count
        points[len(outline) :] = mean[len(outline) :]
    return points, faces


def lay_grid(outline: Float, spacing: float) -> Float:
    """Return the points (n, 2) of a grid of equilateral triangles over the box round an outline (m, 2)."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    rows = np.arange(low[1], high[1], spacing * np.sqrt(0.75))
    across = np.arange(low[0], high[0] + spacing, spacing)
    lines = [np.stack([across - 0.5 * spacing * (r % 2), np.full(len(across), y)], 1) for r, y in enumerate(rows)]
    return np.concatenate(lines)


def is_inside(points: Float, outline: Float) -> Bool:
    """Return which points (n, 2) lie inside a polygon (m, 2): its sides cross a ray to the right an odd number of
    times.
    """
    a, b = outline, np.roll(outline, -1, axis=0)
    above = points[:, 1:]
    point, side = np.nonzero((a[:, 1] > above) != (b[:, 1] > above))
    # To the left of a side that goes up, to the right of one that goes down.
    crossed = sides(a[side], b[side], points[point]) == np.where(a[side, 1] < b[side, 1], 1, -1)
    return np.asarray(np.bincount(point[crossed], minlength=len(points)) % 2 == 1)


def distances(points: Float, sides: Float) -> Float:
    """Return the distances (n, m) of points (n, 2) from sides (m, 2, 2)."""
    (px, py), (ax, ay) = points.T[..., None], sides[:, 0].T
    wx, wy = (sides[:, 1] - sides[:, 0]).T
    dx, dy = px - ax, py - ay
    share = np.clip((dx * wx + dy * wy) / (wx * wx + wy * wy), 0.0, 1.0)
    return np.asarray(np.hypot(dx - share * wx, dy - share * wy))


def triangulate(points: Float) -> Int:
    """Return the Delaunay triangles (f, 3) of points (n, 2), no two of them at one place: counter-clockwise, each from
    its lowest vertex, sorted.
    """
    from scipy.spatial import Delaunay  # half a second to import, for shirts alone

    faces = Delaunay(points).simplices
    one, other = (points[faces[:, k]] - points[faces[:, 0]] for k in (1, 2))
    clockwise = one[:, 0] * other[:, 1] < one[:, 1] * other[:, 0]
    faces[clockwise] = faces[clockwise, ::-1]
    first = faces.argmin(axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return np.ascontiguousarray(faces[np.lexsort(faces.T[::-1])], np.int32)
