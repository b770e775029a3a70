"""Delaunay triangles of points in an outline, every side of which is a side of a triangle.

Delaunay's triangulation of the points has most of the outline's sides; it lacks those near which the outline comes
back, as at the tip of a dart. These are brought in by flips of what crosses them (Sloan 1993, Adv. Eng. Software 17,
49-55), and what lies beyond the outline is left out.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from nuno_cloth.models.delaunay import triangulate
from nuno_schemas.fabric import Float, Int
from nuno_schemas.vectors import CERTAIN, sides

Edge = tuple[int, int]
FAR, CORNERS = 3.0, np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def triangulate_inside(points: Float, outline: int) -> Int:
    """(f, 3) counter-clockwise triangles of points (n, 2), the first `outline` of which go round counter-clockwise.

    Raises ValueError where a side of the outline runs through a point, or cannot be had.
    """
    # Four points far off: no side of the outline is then one of the convex hull, where rounding decides which of
    # several points in a row belong to it.
    low, high = points.min(axis=0), points.max(axis=0)
    middle, wide = 0.5 * (low + high), FAR * float((high - low).max())
    points = np.concatenate([points, middle + wide * CORNERS])
    faces = triangulate(points)
    start = np.arange(outline, dtype=np.int64)
    end = np.roll(start, -1)
    keys = _directed(faces, len(points)).reshape(-1)
    there = np.isin(start * len(points) + end, keys)
    if not there.all():
        faces = _recover(points, faces, [(int(a), int(b)) for a, b in zip(start[~there], end[~there], strict=True)])
    return _inside(faces, len(points), start * len(points) + end)


def _directed(faces: Int, n: int) -> Int:
    """(f, 3) number of the side from each corner to the next."""
    return np.asarray(faces.astype(np.int64) * n + np.roll(faces, -1, axis=1))


def _inside(faces: Int, n: int, border: Int) -> Int:
    """Triangles that are joined, across no side of the outline, with one to the left of a side of it."""
    keys = _directed(faces, n)
    low, high = np.divmod(keys, n)
    back = high * n + low
    order = np.argsort(keys.reshape(-1))
    at = order[np.minimum(np.searchsorted(keys.reshape(-1), back.reshape(-1), sorter=order), keys.size - 1)]
    joined = (keys.reshape(-1)[at] == back.reshape(-1)) & ~np.isin(keys, border).reshape(-1)
    joined &= ~np.isin(back, border).reshape(-1)
    face = np.repeat(np.arange(len(faces)), 3)
    links = coo_array((np.ones(int(joined.sum())), (face[joined], at[joined] // 3)), shape=(len(faces),) * 2)
    part = connected_components(links, directed=False)[1]
    return np.ascontiguousarray(faces[np.isin(part, part[np.isin(keys, border).any(axis=1)])])


def _recover(points: Float, faces: Int, wanted: list[Edge]) -> Int:
    """Triangles with the wanted sides among theirs."""
    third: dict[Edge, int] = {}
    for a, b, c in faces.tolist():
        third[a, b], third[b, c], third[c, a] = c, a, b
    place = [(float(x), float(y)) for x, y in points]

    def side(a: int, b: int, c: int) -> float:
        """More than 0 where c lies to the left of the way from a to b, less to the right, 0 on the line."""
        (ax, ay), (bx, by), (cx, cy) = place[a], place[b], place[c]
        one, other = (bx - ax) * (cy - ay), (by - ay) * (cx - ax)
        sure = abs(one - other) > CERTAIN * (abs(one) + abs(other))
        return one - other if sure else float(sides(points[[a]], points[[b]], points[[c]])[0])

    def cross(a: int, b: int, c: int, d: int) -> bool:
        return (side(a, b, c) > 0.0) != (side(a, b, d) > 0.0) and (side(c, d, a) > 0.0) != (side(c, d, b) > 0.0)

    for a, b in wanted:
        others = [(c, d) for c, d in third if c < d and (d, c) in third and not {a, b} & {c, d}]
        waiting = [(c, d) for c, d in others if cross(a, b, c, d)]
        for _ in range(50 * (len(waiting) + 1) ** 2):
            if not waiting:
                break
            c, d = waiting.pop(0)
            left, right = third[c, d], third[d, c]
            # The two triangles can be flipped where the four corners are convex.
            if side(right, left, c) <= 0.0 or side(left, right, d) <= 0.0:
                waiting.append((c, d))
                continue
            del third[c, d], third[d, c]
            for one, two, three in ((right, left, c), (left, right, d)):
                third[one, two], third[two, three], third[three, one] = three, one, two
            if left not in (a, b) and right not in (a, b) and cross(a, b, left, right):
                waiting.append((left, right))
        if (a, b) not in third and (b, a) not in third:
            raise ValueError(f"{a} {b}")
    found = {min(((a, b, c), (b, c, a), (c, a, b))) for (a, b), c in third.items()}
    return np.array(sorted(found), np.int32)
