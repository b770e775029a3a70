"""How deep points lie inside a closed mesh, found apart from the search that contact uses.

A point is inside where a ray from it along x crosses the mesh an odd number of times. Triangles are listed by
the cells of a grid over y and z, so that a ray looks at those of its own cell. Which side of an edge a ray
passes is computed from the edge's ends in the order of their numbers, and so with the same bits for both of
its triangles: a ray that hits an edge or a vertex crosses exactly one. Only of points inside is the distance taken, to
the triangles that reach as near as the nearest middle of one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.collision.clearance import to_triangles
from nuno.collision.pairs import Boxes, boxes_of, overlap
from nuno_schemas.bodies import Geometry
from nuno_schemas.fabric import Bool, Float, Int

AT_ONCE = 2_000_000
"""Pairs of a point and a triangle whose distances are taken together."""
ROUNDING = 1e-9
"""Share of a cell by which a triangle may be crossed beside its box, and of a distance by which its bound is off."""


@dataclass(frozen=True)
class Columns:
    """A mesh whose triangles are listed by the cells (y, z) that they reach into.

    low (2,) [m] and size [m] of the cells, shape: how many; triangles of cell k are listed[start[k]:start[k + 1]].
    Rays that cross a triangle start in its box of `reached`, which has no end towards -x.
    """

    vertices: Float
    faces: Int
    low: Float
    size: float
    shape: tuple[int, int]
    start: NDArray[np.int64]
    listed: NDArray[np.int64]
    reached: Boxes

    @cached_property
    def trees(self) -> tuple[Any, list[tuple[Any, float, NDArray[np.int64]]]]:
        """A tree of the triangles' middles, and for triangles of like size one of theirs, the largest distance of a
        corner from its middle [m], and which they are.
        """
        corners = self.vertices[self.faces]
        middle = corners.mean(axis=1)
        size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        alike = [np.flatnonzero(np.frexp(size)[1] == like) for like in np.unique(np.frexp(size)[1])]
        return _tree(middle), [(_tree(middle[which]), float(size[which].max()), which) for which in alike]


def _tree(points: Float) -> Any:
    """Not balanced: that takes longer than it saves, since what bends has a new one in every frame."""
    from scipy.spatial import KDTree  # it takes a second, and not all that import this look for a distance

    return KDTree(points, compact_nodes=False, balanced_tree=False)


def make_columns(vertices: Float, faces: Int) -> Columns:
    """Cells about as wide as the triangles, so that a cell lists a few."""
    lowest, highest = boxes_of(np.ascontiguousarray(vertices.T), faces)
    least, most = lowest[1:].T, highest[1:].T
    low, high = least.min(axis=0), most.max(axis=0)
    size = max(float((most - least).mean()), float((high - low).max()) / 2048) or 1.0
    shape = (int((high - low)[0] / size) + 1, int((high - low)[1] / size) + 1)
    first = ((least - low) / size).astype(np.int64)
    last = np.minimum(((most - low) / size).astype(np.int64), np.array(shape) - 1)
    wide = last - first + 1
    count = wide.prod(axis=1)
    face = np.repeat(np.arange(len(faces)), count)
    step = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    row, column = first[face, 0] + step // wide[face, 1], first[face, 1] + step % wide[face, 1]
    cell = row * shape[1] + column
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(shape[0] * shape[1] + 1))
    lowest[0] = -np.inf
    reached = lowest - ROUNDING * size, highest + ROUNDING * size
    return Columns(vertices, faces, low, size, shape, start.astype(np.int64), face[order], reached)


def are_inside(points: Float, columns: Columns) -> Bool:
    """(n,) whether points (n, 3) lie inside."""
    place = (points[:, 1:] - columns.low) / columns.size
    within = ((place >= 0.0) & (place < np.array(columns.shape))).all(axis=1)
    which = np.flatnonzero(within)
    cell = place[which].astype(np.int64) @ np.array([columns.shape[1], 1])
    count = columns.start[cell + 1] - columns.start[cell]
    point = np.repeat(which, count)
    step = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    along = np.ascontiguousarray(points.T)
    face = columns.listed[np.repeat(columns.start[cell], count) + step]
    point, face = overlap(point, (along, along), face, columns.reached)
    crossed = np.bincount(point[_cross(points[point], columns, face)], minlength=len(points))
    return np.asarray(crossed % 2 == 1)


def _cross(p: Float, columns: Columns, face: NDArray[np.int64]) -> Bool:
    """(m,) whether the rays from p (m, 3) towards +x cross the triangles `face` (m,)."""
    corner = columns.faces[face]
    sides = []
    for k in range(3):
        a, b = corner[:, k], corner[:, (k + 1) % 3]
        first, second = np.minimum(a, b), np.maximum(a, b)
        start, along = columns.vertices[first, 1:], columns.vertices[second, 1:] - columns.vertices[first, 1:]
        off = p[:, 1:] - start
        left = along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0] >= 0.0
        sides.append(left == (a < b))
    around = (sides[0] == sides[1]) & (sides[1] == sides[2])
    start, second_corner, third = (columns.vertices[corner[:, k]] for k in range(3))
    normal = np.cross(second_corner - start, third - start)
    height = ((p - start) * normal).sum(axis=1)
    return np.asarray(around & (height * normal[:, 0] < 0.0))


def distances(points: Float, columns: Columns) -> Float:
    """(n,) distance [m] of points (n, 3) to the nearest triangle."""
    (near, groups), corners = columns.trees, columns.vertices[columns.faces]
    bound = near.query(points)[0] * (1.0 + ROUNDING)
    least = np.full(len(points), np.inf)
    for tree, size, which in groups:
        reach = bound + size
        count = np.cumsum(tree.query_ball_point(points, reach, return_length=True))
        at = 0
        while at < len(points):
            end = max(at + 1, int(np.searchsorted(count, (count[at - 1] if at else 0) + AT_ONCE, side="right")))
            found = tree.query_ball_point(points[at:end], reach[at:end])
            point = np.repeat(np.arange(at, end), [len(one) for one in found])
            face = which[np.concatenate([*found, []]).astype(np.int64)]
            np.minimum.at(least, point, to_triangles(points[point], corners[face]))
            at = end
    return least


_COLUMNS: dict[int, tuple[Geometry, Columns]] = {}
"""By the identity of the geometry that they are of: the last mesh or few of a run."""


def columns_of(geometry: Geometry, primitive: int) -> Columns:
    """The columns of a primitive that has a mesh, made once."""
    name = hash((id(geometry), primitive))
    kept = _COLUMNS.get(name)
    if kept is None or kept[0] is not geometry:
        while len(_COLUMNS) >= 16:
            del _COLUMNS[next(iter(_COLUMNS))]
        kept = _COLUMNS[name] = (geometry, make_columns(*geometry.mesh(primitive)))
    return kept[1]
