"""Triangles of a panel: evenly spread inside of an outline whose points are given and stay.

Points begin as a triangular grid, as dense as is wanted, where the outline's own points are no closer than that; the
rest is filled by Delaunay refinement (Ruppert 1995, J. Algorithms 18, 548-585): triangles that are too large or too
thin get a point in the middle of their circumcircle, unless it came too close to the outline, whose sides must stay
whole. Then each point inside moves to the mean of the triangles round it, again and again, and Delaunay's triangles are
found anew.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from nuno_cloth.models.delaunay import distances, is_inside, lay_grid
from nuno_cloth.sewing.constrained import triangulate_inside
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.vectors import dot, norm

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
