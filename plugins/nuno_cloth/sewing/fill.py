"""Triangles of a panel, evenly spread inside of an outline with fixed points.

Points begin as a triangular grid of the wanted density where the outline's points are no denser; the rest is filled by
Delaunay refinement (Ruppert 1995, J. Algorithms 18, 548-585): triangles that are too large or too thin get a point in
the middle of their circumcircle, unless it would be too close to the outline, whose sides must stay whole. Then inner
points repeatedly move to the mean of the triangles round them, and the Delaunay triangulation is renewed.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from nuno_cloth.models.delaunay import distances, is_inside, lay_grid, triangulate
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.vectors import CERTAIN, dot, norm, sides

# Constrained Delaunay triangles of points in an outline: every side of it is a side of a triangle. The Delaunay
# triangulation of the points has most of the outline's sides. It lacks those close to another part of the outline, as
# at the tip of a dart. Flips of the sides that cross these recover them (Sloan 1993, Adv. Eng. Software 17, 49-55).
# Triangles outside of the outline are left out.

Edge = tuple[int, int]
FAR, CORNERS = 3.0, np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def triangulate_inside(points: Float, outline: int) -> Int:
    """Return triangles (f, 3), counter-clockwise, of points (n, 2). The first `outline` points are the outline.

    The outline is counter-clockwise. Raises ValueError if a side of it runs through a point, or cannot be recovered.
    """
    # With four distant points no side of the outline is on the convex hull, where rounding decides which of several
    # collinear points belong to it.
    low, high = points.min(axis=0), points.max(axis=0)
    middle, wide = 0.5 * (low + high), FAR * float((high - low).max())
    points = np.concatenate([points, middle + wide * CORNERS])
    faces = triangulate(points)
    start = np.arange(outline, dtype=np.int64)
    end = np.roll(start, -1)
    keys = _directed(faces, len(points)).reshape(-1)
    present = np.isin(start * len(points) + end, keys)
    if not present.all():
        faces = _recover(points, faces, [(int(a), int(b)) for a, b in zip(start[~present], end[~present], strict=True)])
    return _inside(faces, len(points), start * len(points) + end)


def _directed(faces: Int, n: int) -> Int:
    """Return the key (f, 3) of the directed side from each corner to the next."""
    return np.asarray(faces.astype(np.int64) * n + np.roll(faces, -1, axis=1))


def _inside(faces: Int, n: int, border: Int) -> Int:
    """Return the triangles that are connected, without crossing the outline, to one on the left of a side of it."""
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


def _recover(points: Float, faces: Int, missing: list[Edge]) -> Int:
    """Return triangles that have the missing sides, by flips."""
    third: dict[Edge, int] = {}
    for a, b, c in faces.tolist():
        third[a, b], third[b, c], third[c, a] = c, a, b
    place = [(float(x), float(y)) for x, y in points]

    def side(a: int, b: int, c: int) -> float:
        """Return more than 0 if c is to the left of the line from a to b, less if to the right, 0 if on it."""
        (ax, ay), (bx, by), (cx, cy) = place[a], place[b], place[c]
        one, other = (bx - ax) * (cy - ay), (by - ay) * (cx - ax)
        certain = abs(one - other) > CERTAIN * (abs(one) + abs(other))
        return one - other if certain else float(sides(points[[a]], points[[b]], points[[c]])[0])

    def cross(a: int, b: int, c: int, d: int) -> bool:
        return (side(a, b, c) > 0.0) != (side(a, b, d) > 0.0) and (side(c, d, a) > 0.0) != (side(c, d, b) > 0.0)

    for a, b in missing:
        others = [(c, d) for c, d in third if c < d and (d, c) in third and not {a, b} & {c, d}]
        crossing = [(c, d) for c, d in others if cross(a, b, c, d)]
        for _ in range(50 * (len(crossing) + 1) ** 2):
            if not crossing:
                break
            c, d = crossing.pop(0)
            left, right = third[c, d], third[d, c]
            # The two triangles can be flipped where the four corners are convex.
            if side(right, left, c) <= 0.0 or side(left, right, d) <= 0.0:
                crossing.append((c, d))
                continue
            del third[c, d], third[d, c]
            for one, two, three in ((right, left, c), (left, right, d)):
                third[one, two], third[two, three], third[three, one] = three, one, two
            if left not in (a, b) and right not in (a, b) and cross(a, b, left, right):
                crossing.append((left, right))
        if (a, b) not in third and (b, a) not in third:
            raise ValueError(f"{a} {b}")
    triangles = {min(((a, b, c), (b, c, a), (c, a, b))) for (a, b), c in third.items()}
    return np.array(sorted(triangles), np.int32)


GRADE = 0.4
"""Growth of triangles' sides with the distance from a shorter side of the outline."""
LEAST = 0.4
"""Sides shorter than this many spacings make only the triangles that touch them smaller."""
INSET = 0.65
"""Least distance of the grid's points from the outline, in spacings."""
APART = 0.75
"""Least distance between points that are inserted at once, over the wanted side of triangles there."""
LARGE = 1.3
"""A circumcircle larger than that of the wanted triangle by this factor is too large."""
THIN, SMALL = 1.25, 0.7
"""Triangles with circumradii of THIN shortest sides are too thin: their least angle is 23.6 degrees. Those with
circumcircles below SMALL of the wanted one have no room for another point."""
REFINED, ROUNDS = 12, 12
AT_ONCE = 4096


def fill(outline: Float, spacing: float) -> tuple[Float, Int]:
    """Return points (n, 2), the outline's (m, 2) first, and triangles (f, 3), counter-clockwise, of side `spacing` [m].

    The outline is simple and counter-clockwise. Raises ValueError if a side of it cannot be recovered.
    """
    sizes = SizeField(outline, spacing)
    points = np.concatenate([outline, _grid(sizes)])
    for _ in range(REFINED):
        new = _refine(points, triangulate_inside(points, len(outline)), sizes)
        if not len(new):
            break
        points = _smooth(np.concatenate([points, new]), sizes, 2)
    points = _smooth(points, sizes, ROUNDS)
    return points, triangulate_inside(points, len(outline))


class SizeField:
    """The wanted size of triangles within an outline (m, 2), which follows from its sides."""

    def __init__(self, outline: Float, spacing: float) -> None:
        self.outline, self.spacing = outline, spacing
        self.sides = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
        length = np.clip(norm(self.sides[:, 1] - self.sides[:, 0]), LEAST * spacing, spacing)
        short = length < 0.95 * spacing
        self.short, self.length = self.sides[short], length[short]

    def size(self, points: Float) -> Float:
        """Return the wanted sides (n,) of triangles at points (n, 2) [m]."""
        sizes = np.full(len(points), self.spacing)
        if len(self.length):
            for at in range(0, len(points), AT_ONCE):
                far = distances(points[at : at + AT_ONCE], self.short)
                sizes[at : at + AT_ONCE] = np.minimum((self.length + GRADE * far).min(axis=1), self.spacing)
        return sizes

    def inside(self, points: Float, far: Float) -> Bool:
        """Return which points (n, 2) are inside, and farther from the outline than `far` (n,) [m]."""
        mask = np.zeros(len(points), np.bool_)
        for at in range(0, len(points), AT_ONCE):
            some = points[at : at + AT_ONCE]
            near = distances(some, self.sides).min(axis=1)
            mask[at : at + AT_ONCE] = is_inside(some, self.outline) & (near > far[at : at + AT_ONCE])
        return mask


def _grid(sizes: SizeField) -> Float:
    spacing, grid = sizes.spacing, lay_grid(sizes.outline, sizes.spacing)
    grid = grid[sizes.inside(grid, np.full(len(grid), INSET * spacing))]
    return grid[sizes.size(grid) >= 0.9 * spacing]


def _refine(points: Float, faces: Int, sizes: SizeField) -> Float:
    """Return spread-out circumcentres of triangles that are too large or too thin, the worst first."""
    centre, radius, shortest = _circles(points, faces)
    large = radius * np.sqrt(3.0) / sizes.size(points[faces].mean(axis=1))
    bad = np.flatnonzero((large > LARGE) | ((radius > THIN * shortest) & (large > SMALL)))
    centre = centre[bad[np.argsort(-large[bad], kind="stable")]]
    size = sizes.size(centre)
    free = sizes.inside(centre, 0.5 * size)
    if free.any():
        near, _ = cKDTree(points).query(centre[free])
        free[free] = near > 0.6 * size[free]
    centre, size = centre[free], size[free]
    chosen, available = [], np.ones(len(centre), np.bool_)
    tree = cKDTree(centre) if len(centre) else None
    for i in range(len(centre)):
        if available[i] and tree is not None:
            chosen.append(i)
            available[tree.query_ball_point(centre[i], APART * size[i])] = False
    return centre[chosen]


def _circles(points: Float, faces: Int) -> tuple[Float, Float, Float]:
    """Return centres (f, 2) and radii (f,) of circumcircles, and the shortest sides (f,)."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    one, two = b - a, c - a
    double = 2.0 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    p, q = dot(one, one), dot(two, two)
    x = (two[:, 1] * p - one[:, 1] * q) / double
    y = (one[:, 0] * q - two[:, 0] * p) / double
    shortest = np.minimum(np.minimum(np.sqrt(p), np.sqrt(q)), norm(c - b))
    return a + np.stack([x, y], axis=1), np.hypot(x, y), shortest


def _smooth(points: Float, sizes: SizeField, rounds: int) -> Float:
    """Move each point to the mean of its triangles' centroids, weighted by their areas over the wanted ones."""
    points, fixed, size = points.copy(), len(sizes.outline), sizes.size(points)
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
