"""The axis of a limb: given as points, or found from its mesh, with the girth along it.

Between two ends the axis is found in two passes. First along the surface: every vertex gets the length of the shortest
way to it over the edges from the section at the start, and the middles of its level lines are a line that follows any
bend. Then across: planes across that line cut loops, whose centroids are the next line, a few times, which removes the
inaccuracy of ways over edges. In between the line is smoothed and its points set at equal distances. Not chosen:
marching from plane to plane, which leaves the limb at a heel.

Planes that stand askew, as those near an end off the middle or beside a flat cap do, meet the limb farther on than
their neighbours, and the line folds back on itself. Then it is the middles of levels of a harmonic field between
sections at both ends (nuno_geometry.harmonic), which never cross; the sections stand across what the line does
over a width of the limb.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_geometry.check import place_of
from nuno_geometry.closest_point import closest_points
from nuno_geometry.harmonic import solve_harmonic
from nuno_geometry.normals import edge_numbers
from nuno_geometry.sections import Loop, cut_mesh, section_about
from nuno_geometry.tree import Tree, build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.vectors import dot, norm

ROUNDS = 4
"""times that planes across the line are cut"""
SMOOTHED = 2
"""times that the line is smoothed by (1, 2, 1) / 4 in each round"""
TURNS = 3
"""times that sections at both ends and the levels between them are found, each from the others"""


@dataclass(frozen=True)
class Centreline:
    """An axis inside of a closed mesh.

    points (k, 3) [m], at equal distances if found; girth (k,) of the section across it [m]
    """

    points: Float
    girth: Float

    @property
    def along(self) -> Float:
        """Return the length of the axis up to each point (k,) [m]."""
        return lengths(self.points)

    def at(self, share: Float) -> Float:
        """Return places (m, 3) at shares (m,) of the axis's length."""
        return place_at(self.points, np.asarray(share) * self.along[-1])


def lengths(points: Float) -> Float:
    """Return the length of a line of points (k, d) up to each of them (k,) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def place_at(points: Float, along: Float) -> Float:
    """Return places (m, 3) on a line of points after lengths (m,) [m]."""
    have = lengths(points)
    return np.stack([np.interp(along, have, points[:, c]) for c in range(3)], axis=1)


def tangents(points: Float) -> Float:
    """Return unit directions (k, 3) of a line of points, by central differences."""
    difference = np.gradient(points, lengths(points), axis=0)
    return np.asarray(difference / np.linalg.norm(difference, axis=1, keepdims=True))


def follow_axis(x: Float, faces: Int, points: Float, tree: Tree | None = None) -> Centreline:
    """Return the given axis points (k, 3) [m], at least two, with the girths of a closed mesh along them.

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
    """Raise BadInput, with the distance, for the first of points (k, 3) outside of a closed mesh."""
    distance = closest_points(build_tree(x, faces) if tree is None else tree, points).distance
    if (distance >= 0.0).any():
        first = int(np.argmax(distance >= 0.0))
        raise BadInput(
            "an axis point lies outside of the mesh", field=f"axis[{first}]", value=place_of(points[first]),
            limit=f"inside; it is {distance[first]:.3g} m away from the surface",
        )  # fmt: skip


def find_axis(x: Float, faces: Int, start: Float, end: Float, count: int = 64) -> Centreline:
    """Find the axis of a closed mesh between two places inside of it, of `count` points.

    It begins and ends with the sections across it through the two places; its points are centroids of sections, or of
    levels between them. Raises BadInput for ends outside of the mesh, and for ends that no single tube joins.
    """
    tree = build_tree(x, faces)
    ends = np.array([start, end], np.float64)
    check_inside(x, faces, ends, tree)
    if np.array_equal(ends[0], ends[1]):
        raise BadInput("both ends of the axis are in the same place", field="axis", value=place_of(ends[0]))
    if count < 4:
        raise BadInput("an axis needs two ends and points between them", field="axis", value=count, limit=">= 4 points")
    line = axis_by_planes(x, faces, ends, tree, count)
    return follow_axis(x, faces, axis_by_levels(x, faces, ends, count) if line is None else line, tree)


def axis_by_planes(x: Float, faces: Int, ends: Float, tree: Tree, count: int = 64) -> Float | None:
    """Return points (count, 3) of the axis between two places (2, 3) in the mesh, by planes; None if it folds back on
    itself or leaves the mesh. Raises BadInput for ends that the surface does not join.
    """
    value = way_from(x, faces, ends[0])
    last = float(value[faces[closest_points(tree, ends[1:]).face[0]]].mean())
    if not 0.0 < last < np.inf:
        raise BadInput("the ends of the axis are not joined by the surface", field="axis", value=last, limit="> 0 m")
    value = np.where(np.isfinite(value), value, 2.0 * last)
    middles = np.array([loop.centroid() for loop in _level_loops(x, faces, value, last, count)])
    # Ways go round the ends of the limb as well: only the part between the two places stays.
    first, final = (int(np.argmin(np.linalg.norm(middles - end, axis=1))) for end in ends)
    line = _between(np.array([ends[0], *middles[first + 1 : final], ends[1]]), count)
    for _ in range(ROUNDS):
        line = _between(_recentre(x, faces, _smooth(line)), count)
    step = np.diff(line, axis=0)
    folded = ((step[1:] * step[:-1]).sum(axis=1) <= 0.0).any()
    return None if folded or (closest_points(tree, line).distance >= 0.0).any() else line


def axis_by_levels(x: Float, faces: Int, ends: Float, count: int = 64) -> Float:
    """Return points (count, 3) of the axis between two places (2, 3) in the mesh, by levels of a harmonic field.

    Levels near a place that is off the middle go round it rather than round the limb: of the first field, between the
    vertices about the two places, those within a radius of a place are left out.
    """
    start, end = (_about(x, faces, place) for place in ends)
    field = solve_harmonic(x, faces, start | end, end.astype(np.float64))
    loops = _level_loops(x, faces, field, 1.0, count)
    middles = np.array([loop.centroid() for loop in loops])
    radius = np.array([loop.girth for loop in loops]) / (2.0 * np.pi)
    middles = middles[np.linalg.norm(middles[:, None] - ends, axis=2).min(axis=1) > radius]
    width = 2.0 * float(radius.mean())
    for _ in range(TURNS):
        line = np.array([ends[0], *middles, ends[1]])
        length = float(lengths(line)[-1])
        near = place_at(line, np.array([min(width, 0.5 * length), max(length - width, 0.5 * length)]))
        fixed, value = np.zeros(len(x), np.bool_), np.zeros(len(x))
        for i, way in enumerate((near[0] - ends[0], ends[1] - near[1])):
            section = section_about(x, faces, ends[i], way)
            assert section is not None  # the place is inside of the mesh
            section_vertices = np.unique(section.edges)
            fixed[section_vertices] = True
            value[section_vertices] = i * length + dot(x[section_vertices] - ends[i], way) / norm(way)
            ends = np.where(np.arange(2)[:, None] == i, section.centroid(), ends)
        loops = _level_loops(x, faces, solve_harmonic(x, faces, fixed, value), length, count)
        middles = np.array([loop.centroid() for loop in loops])
    return _between(np.array([ends[0], *middles, ends[1]]), count)


def _level_loops(x: Float, faces: Int, value: Float, last: float, count: int) -> list[Loop]:
    """Return the longest loop at each of `count` levels from 0 to `last` of values (n,) that has a loop."""
    found = (cut_mesh(x, faces, value - last * (k + 0.5) / count) for k in range(count))
    return [max(loops, key=lambda loop: loop.girth) for loops in found if loops]


def way_from(x: Float, faces: Int, start: Float) -> Float:
    """Return the length over edges (n,) [m] from the vertices about `start` as near to it as the surface is wide there.

    All that lie nearer than the farthest corner of the nearest triangles count as the start: a ring, if the
    start is in the middle of a tube.
    """
    pairs = edge_numbers(faces)[1]
    length = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    value = np.where(_about(x, faces, start), np.linalg.norm(x - start, axis=1), np.inf)
    while True:
        before = value.copy()
        for a, b in ((pairs[:, 0], pairs[:, 1]), (pairs[:, 1], pairs[:, 0])):
            np.minimum.at(value, b, before[a] + length)
        if np.array_equal(before, value):
            return np.asarray(value)


def _about(x: Float, faces: Int, place: Float) -> Bool:
    """Return the vertices (n,) nearest to a place (3,), to one and a half of the mesh's usual edges."""
    pairs = edge_numbers(faces)[1]
    length = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    away = np.linalg.norm(x - place, axis=1)
    return np.asarray(away <= float(away.min()) + 1.5 * float(np.median(length)))


def _between(line: Float, count: int) -> Float:
    """Return points (count, 3) of a line at equal distances, its ends among them."""
    return place_at(line, np.linspace(0.0, lengths(line)[-1], count))


def _smooth(line: Float) -> Float:
    for _ in range(SMOOTHED):
        line = np.concatenate([line[:1], 0.25 * line[:-2] + 0.5 * line[1:-1] + 0.25 * line[2:], line[-1:]])
    return line


def _recentre(x: Float, faces: Int, line: Float) -> Float:
    """Move every point to the centroid of the section across the line there."""
    moved = line.copy()
    for k, (point, normal) in enumerate(zip(line, tangents(line), strict=True)):
        loop = section_about(x, faces, point, normal)
        if loop is not None:
            moved[k] = loop.centroid()
    return moved
