"""The axis of a limb: given as points, or found from its mesh, with the girth along it.

Between two ends the axis is found in two passes. First along the surface: every vertex gets the length of the
shortest way to it over the edges from the section at the start, and the middles of its level lines are a line
that follows any bend. Then across: planes across that line cut loops, whose centroids are the next line, a few times,
so that what the ways over edges lack in accuracy is gone. In between the line is smoothed and its
points set at equal distances. Not chosen: marching from plane to plane, which leaves the limb at a heel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_kernels.closest_point import closest_points
from nuno_kernels.mesh_check import place_of
from nuno_kernels.mesh_sections import cut_mesh, section_about
from nuno_kernels.surface_normals import edge_numbers
from nuno_kernels.surface_tree import Tree, build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

ROUNDS = 4
"""Times that planes across the line are cut."""
SMOOTHED = 2
"""Times that the line is smoothed by (1, 2, 1) / 4 in each round."""


@dataclass(frozen=True)
class Centreline:
    """An axis inside of a closed mesh.

    points (k, 3) [m], at equal distances if found; girth (k,) of the section across it [m]
    """

    points: Float
    girth: Float

    @property
    def along(self) -> Float:
        """(k,) length of the axis up to each point [m]."""
        return lengths(self.points)

    def at(self, share: Float) -> Float:
        """(m, 3) places at shares (m,) of the axis's length."""
        return place_at(self.points, np.asarray(share) * self.along[-1])


def lengths(points: Float) -> Float:
    """(k,) length of a line of points (k, 3) up to each of them [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def place_at(points: Float, along: Float) -> Float:
    """(m, 3) places on a line of points after lengths (m,) [m]."""
    have = lengths(points)
    return np.stack([np.interp(along, have, points[:, c]) for c in range(3)], axis=1)


def tangents(points: Float) -> Float:
    """(k, 3) unit directions of a line of points, by central differences."""
    difference = np.gradient(points, lengths(points), axis=0)
    return np.asarray(difference / np.linalg.norm(difference, axis=1, keepdims=True))


def follow_axis(x: Float, faces: Int, points: Float, tree: Tree | None = None) -> Centreline:
    """The given axis points (k, 3) [m], at least two, with the girths of a closed mesh along them.

    Raises BadInput for points that lie outside of the mesh, or on top of each other.
    """
    points = np.ascontiguousarray(points, np.float64)
    if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < 2:
        raise BadInput("an axis needs at least two points", field="axis", value=points.shape, limit="(k, 3), k >= 2")
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if (step == 0.0).any():
        raise BadInput("two axis points in the same place", field=f"axis[{int(np.argmin(step)) + 1}]")
    check_inside(x, faces, points, tree)
    girth = [
        loop.girth if (loop := section_about(x, faces, p, t)) else 0.0
        for p, t in zip(points, tangents(points), strict=True)
    ]
    return Centreline(points, np.array(girth))


def check_inside(x: Float, faces: Int, points: Float, tree: Tree | None = None) -> None:
    """Raises BadInput for the first of points (k, 3) outside of a closed mesh, and says how far off it is."""
    distance = closest_points(build_tree(x, faces) if tree is None else tree, points).distance
    if (distance >= 0.0).any():
        first = int(np.argmax(distance >= 0.0))
        raise BadInput(
            "an axis point lies outside of the mesh", field=f"axis[{first}]", value=place_of(points[first]),
            limit=f"inside; it is {distance[first]:.3g} m away from the surface",
        )  # fmt: skip


def find_axis(x: Float, faces: Int, start: Float, end: Float, count: int = 64) -> Centreline:
    """The axis of a closed mesh between two places inside of it, of `count` points.

    It begins at the section that the plane through `start` across the way to the nearest level line cuts, and ends
    likewise; between those its points are centroids of sections. Raises BadInput for ends outside of the mesh,
    and for ends that no single tube joins.
    """
    tree = build_tree(x, faces)
    ends = np.array([start, end], np.float64)
    check_inside(x, faces, ends, tree)
    if np.array_equal(ends[0], ends[1]):
        raise BadInput("both ends of the axis are in the same place", field="axis", value=place_of(ends[0]))
    if count < 4:
        raise BadInput("an axis needs two ends and points between them", field="axis", value=count, limit=">= 4 points")
    value = way_from(x, faces, ends[0])
    last = float(value[faces[closest_points(tree, ends[1:]).face[0]]].mean())
    if not 0.0 < last < np.inf:
        raise BadInput("the ends of the axis are not joined by the surface", field="axis", value=last, limit="> 0 m")
    levels = last * (np.arange(count) + 0.5) / count
    middles = []
    for level in levels:
        loops = cut_mesh(x, faces, np.where(np.isfinite(value), value, 2.0 * last) - level)
        if loops:
            longest = max(loops, key=lambda loop: loop.girth)
            middles.append(longest.centroid())
    # Ways reach round the ends of the limb as well: what is kept lies between the two places.
    first, final = (int(np.argmin(np.linalg.norm(np.array(middles) - end, axis=1))) for end in ends)
    line = _between(np.array([ends[0], *middles[first + 1 : final], ends[1]]), count)
    for _ in range(ROUNDS):
        line = _between(_recentre(x, faces, _smooth(line)), count)
    return follow_axis(x, faces, line, tree)


def way_from(x: Float, faces: Int, start: Float) -> Float:
    """(n,) length over edges [m] from the vertices about `start` as near to it as the surface is wide there.

    All that lie nearer than the farthest corner of the nearest triangles count as the start: a ring, if the
    start is in the middle of a tube.
    """
    pairs = edge_numbers(faces)[1]
    length = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    away = np.linalg.norm(x - start, axis=1)
    value = np.where(away <= float(away.min()) + 1.5 * float(np.median(length)), away, np.inf)
    while True:
        before = value.copy()
        for a, b in ((pairs[:, 0], pairs[:, 1]), (pairs[:, 1], pairs[:, 0])):
            np.minimum.at(value, b, before[a] + length)
        if np.array_equal(before, value):
            return np.asarray(value)


def _between(line: Float, count: int) -> Float:
    """(count, 3) points of a line at equal distances, its ends among them."""
    return place_at(line, np.linspace(0.0, lengths(line)[-1], count))


def _smooth(line: Float) -> Float:
    for _ in range(SMOOTHED):
        line = np.concatenate([line[:1], 0.25 * line[:-2] + 0.5 * line[1:-1] + 0.25 * line[2:], line[-1:]])
    return line


def _recentre(x: Float, faces: Int, line: Float) -> Float:
    """Every point moved to the centroid of the section across the line there."""
    moved = line.copy()
    for k, (point, normal) in enumerate(zip(line, tangents(line), strict=True)):
        loop = section_about(x, faces, point, normal)
        if loop is not None:
            moved[k] = loop.centroid()
    return moved
