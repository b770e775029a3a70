"""Triangles of a panel: evenly spread inside of an outline whose points are given and stay.

Points begin as a triangular grid, as dense as is wanted, where the outline's own points are no closer than that; the
rest is filled by Delaunay refinement (Ruppert 1995, J. Algorithms 18, 548-585): triangles that are too large or too
thin get a point in the middle of their circumcircle, unless it came too close to the outline, whose sides must stay
whole. Then each point inside moves to the mean of the triangles round it, again and again, and Delaunay's triangles are
found anew.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from nuno_cloth.models.delaunay import distances, is_inside, lay_grid, triangulate
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.vectors import CERTAIN, dot, norm, sides

# Delaunay triangles of points in an outline, every side of which is a side of a triangle.
#
# Delaunay's triangulation of the points has most of the outline's sides; it lacks those near which the outline comes
# back, as at the tip of a dart. These are brought in by flips of what crosses them (Sloan 1993, Adv. Eng. Software 17,
# 49-55), and what lies beyond the outline is left out.

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


GRADE = 0.4
"""By how much of the distance from a shorter side of the outline triangles may be larger there."""
LEAST = 0.4
"""Sides shorter than so many spacings do not make triangles small beyond those that touch them."""
INSET = 0.65
"""Least distance from the outline of points of the grid, in its spacings."""
APART = 0.75
"""Least distance between points that come in at once, in sides of the triangles wanted there."""
LARGE = 1.3
"""A circumcircle so much larger than that of the triangle wanted is too large."""
THIN, SMALL = 1.25, 0.7
"""A circumradius of so many shortest sides is a triangle too thin, with a least angle of 23.6 degrees; one whose
circumcircle is so small in that measure has no room for another point."""
REFINED, ROUNDS = 12, 12
AT_ONCE = 4096


def fill(outline: Float, spacing: float) -> tuple[Float, Int]:
    """Points (n, 2), the outline's (m, 2) first, and triangles (f, 3), counter-clockwise, with sides of `spacing` [m].

    The outline is simple and counter-clockwise. Raises ValueError where a side of it cannot be had.
    """
    wanted = Wanted(outline, spacing)
    points = np.concatenate([outline, _grid(wanted)])
    for _ in range(REFINED):
        new = _refine(points, triangulate_inside(points, len(outline)), wanted)
        if not len(new):
            break
        points = _smooth(np.concatenate([points, new]), wanted, 2)
    points = _smooth(points, wanted, ROUNDS)
    return points, triangulate_inside(points, len(outline))


class Wanted:
    """How large triangles should be within an outline (m, 2), by its sides."""

    def __init__(self, outline: Float, spacing: float) -> None:
        self.outline, self.spacing = outline, spacing
        self.sides = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
        length = np.clip(norm(self.sides[:, 1] - self.sides[:, 0]), LEAST * spacing, spacing)
        short = length < 0.95 * spacing
        self.short, self.length = self.sides[short], length[short]

    def size(self, points: Float) -> Float:
        """(n,) sides that triangles should have at points (n, 2) [m]."""
        found = np.full(len(points), self.spacing)
        if len(self.length):
            for at in range(0, len(points), AT_ONCE):
                far = distances(points[at : at + AT_ONCE], self.short)
                found[at : at + AT_ONCE] = np.minimum((self.length + GRADE * far).min(axis=1), self.spacing)
        return found

    def inside(self, points: Float, far: Float) -> Bool:
        """(n,) whether points (n, 2) lie inside, and further from the outline than (n,) [m]."""
        found = np.zeros(len(points), np.bool_)
        for at in range(0, len(points), AT_ONCE):
            some = points[at : at + AT_ONCE]
            near = distances(some, self.sides).min(axis=1)
            found[at : at + AT_ONCE] = is_inside(some, self.outline) & (near > far[at : at + AT_ONCE])
        return found


def _grid(wanted: Wanted) -> Float:
    spacing, grid = wanted.spacing, lay_grid(wanted.outline, wanted.spacing)
    grid = grid[wanted.inside(grid, np.full(len(grid), INSET * spacing))]
    return grid[wanted.size(grid) >= 0.9 * spacing]


def _refine(points: Float, faces: Int, wanted: Wanted) -> Float:
    """Circumcentres of triangles that are too large or too thin, the worst first, as far as they are apart."""
    centre, radius, shortest = _circles(points, faces)
    large = radius * np.sqrt(3.0) / wanted.size(points[faces].mean(axis=1))
    bad = np.flatnonzero((large > LARGE) | ((radius > THIN * shortest) & (large > SMALL)))
    centre = centre[bad[np.argsort(-large[bad], kind="stable")]]
    size = wanted.size(centre)
    free = wanted.inside(centre, 0.5 * size)
    if free.any():
        near, _ = cKDTree(points).query(centre[free])
        free[free] = near > 0.6 * size[free]
    centre, size = centre[free], size[free]
    chosen, left = [], np.ones(len(centre), np.bool_)
    tree = cKDTree(centre) if len(centre) else None
    for i in range(len(centre)):
        if left[i] and tree is not None:
            chosen.append(i)
            left[tree.query_ball_point(centre[i], APART * size[i])] = False
    return centre[chosen]


def _circles(points: Float, faces: Int) -> tuple[Float, Float, Float]:
    """Centres (f, 2) and radii (f,) of circumcircles, and the shortest sides (f,)."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    one, two = b - a, c - a
    double = 2.0 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    p, q = dot(one, one), dot(two, two)
    x = (two[:, 1] * p - one[:, 1] * q) / double
    y = (one[:, 0] * q - two[:, 0] * p) / double
    shortest = np.minimum(np.minimum(np.sqrt(p), np.sqrt(q)), norm(c - b))
    return a + np.stack([x, y], axis=1), np.hypot(x, y), shortest


def _smooth(points: Float, wanted: Wanted, rounds: int) -> Float:
    """Each point moves to the mean of the centroids of the triangles round it, by their areas over the wanted ones."""
    points, fixed, size = points.copy(), len(wanted.outline), wanted.size(points)
    for k in range(rounds):
        if k % 2 == 0:
            faces = triangulate_inside(points, fixed)
            corner = faces.reshape(-1)
            density = size[faces].mean(axis=1) ** -3
        one, two = points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
        weight = (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) * density
        middle = points[faces].mean(axis=1)
        total = np.bincount(corner, np.repeat(weight, 3), len(points))
        moved = [np.bincount(corner, np.repeat(weight * middle[:, d], 3), len(points)) for d in (0, 1)]
        points[fixed:] = (np.stack(moved, axis=1) / total[:, None])[fixed:]
    return points
