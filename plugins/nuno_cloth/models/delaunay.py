"""Triangles of a flat piece of cloth: points spread evenly inside of an outline, joined after Delaunay."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Bool, Float, Int

INSET = 0.6
"""Least distance of points inside from the outline, in spacings: nearer ones would give flat triangles."""
ROUNDS = 10
"""Times that points inside are moved to the mean of their neighbours."""


def fill_outline(outline: Float, spacing: float) -> tuple[Float, Int]:
    """Points (n, 2), the outline's (m, 2) first, and triangles (f, 3), counter-clockwise.

    The outline is simple, counter-clockwise, and has its points about `spacing` apart.
    """
    low, high = outline.min(axis=0), outline.max(axis=0)
    rows = np.arange(low[1], high[1], spacing * np.sqrt(0.75))
    across = np.arange(low[0], high[0] + spacing, spacing)
    grid = np.concatenate(
        [np.stack([across - 0.5 * spacing * (r % 2), np.full(len(across), y)], 1) for r, y in enumerate(rows)]
    )
    inner = grid[is_inside(grid, outline) & (_distance(grid, outline) > INSET * spacing)]
    points = np.concatenate([outline, inner])
    faces = triangulate(points)
    faces = faces[is_inside(points[faces].mean(axis=1), outline)]
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    count = np.bincount(start, minlength=len(points))[:, None]
    for _ in range(ROUNDS):
        mean = np.stack([np.bincount(start, points[end, k], len(points)) for k in (0, 1)], axis=1) / count
        points[len(outline) :] = mean[len(outline) :]
    return points, faces


def is_inside(points: Float, outline: Float) -> Bool:
    """(n,) whether points (n, 2) lie inside of a polygon (m, 2): its sides cross a ray to the right an odd number of
    times.
    """
    a, b = outline, np.roll(outline, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    crossed = ((a[:, 1] > y) != (b[:, 1] > y)) & (x < at)
    return np.asarray(crossed.sum(axis=1) % 2 == 1)


def _distance(points: Float, outline: Float) -> Float:
    """(n,) distance of points (n, 2) to the nearest side of a polygon (m, 2)."""
    a, side = outline, np.roll(outline, -1, axis=0) - outline
    way = points[:, None] - a
    share = np.clip((way * side).sum(axis=2) / (side * side).sum(axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(way - share[..., None] * side, axis=2).min(axis=1))


def triangulate(points: Float) -> Int:
    """(f, 3) Delaunay triangles of points (n, 2), no two of them at one place: counter-clockwise, each from its first
    vertex on, sorted.
    """
    from scipy.spatial import Delaunay  # half a second to import, for shirts alone

    faces = Delaunay(points).simplices
    one, other = (points[faces[:, k]] - points[faces[:, 0]] for k in (1, 2))
    clockwise = one[:, 0] * other[:, 1] < one[:, 1] * other[:, 0]
    faces[clockwise] = faces[clockwise, ::-1]
    first = faces.argmin(axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return np.ascontiguousarray(faces[np.lexsort(faces.T[::-1])], np.int32)
