"""Triangles of a flat piece of cloth: points spread evenly inside of an outline, joined after Delaunay.

Each point digs out the triangles whose circumcircles hold it and is joined to the hole's rim (A. Bowyer, D. F. Watson,
Computer Journal 24(2), 1981). Triangles are kept as a map from their edges, ways round included, to the corner
opposite, which is all that digging and walking need.
"""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Bool, Float, Int

INSET = 0.6
"""Least distance of points inside from the outline, in spacings: nearer ones would give flat triangles."""
FAR = 1e3
"""Corners of the triangle that everything is put into, in sizes of the outline."""
ROUNDS = 10
"""Times that points inside are moved to the mean of their neighbours."""

Edges = dict[tuple[int, int], int]


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
    """(f, 3) Delaunay triangles of points (n, 2), no two of them at one place, counter-clockwise."""
    n, middle = len(points), points.mean(axis=0)
    size = FAR * float(np.ptp(points, axis=0).max())
    corners = middle + size * np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]])
    at = [(float(x), float(y)) for x, y in np.concatenate([points, corners])]
    edges: Edges = {}
    _add(edges, n, n + 1, n + 2)
    last = (n, n + 1)
    # Along the rows of a grid each point lies near the one before it, which keeps the walks short.
    for p in range(n):
        last = _insert(edges, at, p, last)
    found = [(a, b, c) for (a, b), c in edges.items() if a < min(b, c) and max(a, b, c) < n]
    return np.array(sorted(found), np.int32)


def _add(edges: Edges, a: int, b: int, c: int) -> None:
    edges[a, b], edges[b, c], edges[c, a] = c, a, b


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Twice the area of a triangle, positive counter-clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _insert(edges: Edges, at: list[tuple[float, float]], p: int, start: tuple[int, int]) -> tuple[int, int]:
    """Put point p into the triangulation; an edge at it, from which to look for the next."""
    a, b = start
    walking = True
    while walking:
        c, walking = edges[a, b], False
        for i, j in ((a, b), (b, c), (c, a)):
            if _turn(at[i], at[j], at[p]) < 0.0:
                a, b, walking = j, i, True
                break
    c = edges[a, b]
    waiting, rim = [(a, b), (b, c), (c, a)], []
    for edge in waiting:
        del edges[edge]
    while waiting:
        i, j = waiting.pop()
        k = edges.get((j, i))
        if k is None or not _in_circle(at[j], at[i], at[k], at[p]):
            rim.append((i, j))
            continue
        for edge in ((j, i), (i, k), (k, j)):
            del edges[edge]
        waiting += [(i, k), (k, j)]
    for i, j in rim:
        _add(edges, i, j, p)
    return p, rim[0][0]


def _in_circle(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float], p: tuple[float, float]) -> bool:
    """Whether p lies within the circle through a, b, c, which go round it counter-clockwise."""
    ax, ay, bx, by, cx, cy = a[0] - p[0], a[1] - p[1], b[0] - p[0], b[1] - p[1], c[0] - p[0], c[1] - p[1]
    aa, bb, cc = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    value = aa * (bx * cy - cx * by) - bb * (ax * cy - cx * ay) + cc * (ax * by - bx * ay)
    return value > 0.0
