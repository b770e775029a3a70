"""Sections of a triangle mesh by a plane or a level: walks along the cut, and loops of a closed mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nuno_geometry.normals import edge_numbers
from nuno_geometry.poses import Vector, row_at
from nuno_kernels import kernel
from nuno_kernels.lanes import cross, dot, minus, over, plus, times
from nuno_kernels.step.blocks import Long
from nuno_schemas import vectors
from nuno_schemas.fabric import Float, Int

# Sections of a closed mesh: the loops in which a plane, or a level of values on the vertices, cuts it.


@dataclass(frozen=True)
class Loop:
    """A closed polygon in a section: its corners (k, 3) [m], each on an edge of the mesh.

    edges (k, 2) vertices of those edges
    """

    points: Float
    edges: Int

    @property
    def girth(self) -> float:
        """Return the length round it [m]."""
        return float(np.linalg.norm(self.points - np.roll(self.points, 1, axis=0), axis=1).sum())

    def centroid(self) -> Float:
        """Return the centroid (3,) of the enclosed area [m], by triangles about the mean of its corners.

        Independent of how the corners lie on the outline; the mean of the corners where there is no area.
        """
        middle = self.points.mean(axis=0)
        here, after = self.points - middle, np.roll(self.points, -1, axis=0) - middle
        areas = np.cross(here, after)
        normal = areas.sum(axis=0)
        size = float(vectors.dot(normal, normal))
        if size == 0.0:
            return np.asarray(middle)
        weight = vectors.dot(areas, normal) / size
        return np.asarray(middle + (weight[:, None] * (here + after)).sum(axis=0) / 3.0)


def cut_mesh(x: Float, faces: Int, value: Float) -> list[Loop]:
    """Return the loops in which the level 0 of values (n,) on the vertices cuts a closed mesh (n, 3), (f, 3).

    A vertex of value 0 counts as above, so that no loop ever passes through a vertex and each triangle that is
    cut joins just two cut edges.
    """
    above = value >= 0.0
    count = above[faces].sum(axis=1)
    cut = faces[(count == 1) | (count == 2)]
    if len(cut) == 0:
        return []
    ends = np.stack([cut, np.roll(cut, -1, axis=1)], axis=-1)
    crossing = above[ends[..., 0]] != above[ends[..., 1]]
    pairs = np.sort(ends[crossing], axis=-1).astype(np.int64)
    keys, number = np.unique(pairs[:, 0] * len(x) + pairs[:, 1], return_inverse=True)
    low, high = np.divmod(keys, len(x))
    share = value[low] / (value[low] - value[high])
    place = x[low] + share[:, None] * (x[high] - x[low])
    edges = np.stack([low, high], axis=1)
    return [Loop(place[order], edges[order]) for order in _chain(number.reshape(-1, 2))]


def _chain(links: Int) -> list[list[int]]:
    """Return closed chains of links (m, 2) between numbers with two links each; from the lowest number on."""
    neighbours: dict[int, list[int]] = {}
    for a, b in links.tolist():
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    chains, used = [], set()
    for first in sorted(neighbours):
        if first in used:
            continue
        chain, here, last = [first], neighbours[first][0], first
        used.add(first)
        while here != first:
            chain.append(here)
            used.add(here)
            one, other = neighbours[here]
            here, last = (other if one == last else one), here
        chains.append(chain)
    return chains


def section_about(x: Float, faces: Int, point: Float, normal: Float) -> Loop | None:
    """Return the loop that the plane through `point` (3,) across `normal` (3,) cuts round it; if none goes round it,
    that with the nearest middle, and None if the plane cuts nothing.
    """
    loops = cut_mesh(x, faces, vectors.dot(x - point, normal))
    if not loops:
        return None
    round_it = [loop for loop in loops if _goes_round(loop.points - point, normal)]
    return min(round_it or loops, key=lambda loop: float(vectors.norm(loop.centroid() - point)))


def _goes_round(points: Float, normal: Float) -> bool:
    """Whether a polygon in the plane across `normal` winds round the origin."""
    after = np.roll(points, -1, axis=0)
    unit = normal / vectors.norm(normal)
    angle = np.arctan2(vectors.dot(np.cross(points, after), unit), (points * after).sum(axis=1))
    return bool(abs(angle.sum()) > np.pi)


# Walks over a triangle mesh along the line in which a plane cuts it.
#
# The plane holds a chord between two points and the mesh's normal there. From the triangle below the first point the
# line is followed from triangle to triangle, over the edge where it leaves each, until it is below the second point;
# of the edges that it meets on the way come points (u, w) of it, u along the chord and w above.
#
# Which edge a triangle's line leaves by follows from the sides of the plane that its corners are on, computed once and
# alike for every triangle of a corner, so that the walk cannot get lost by rounding: on a closed mesh it
# comes back to where it began, if nothing stops it.

STEPS = 512
"""triangles that a walk passes at most"""
SLACK = 1e-3
"""height of the mesh above an end of a chord that is rounding, as a share of its length"""
UPRIGHT = 0.05
"""sine of the least angle between chord and normal that makes a plane"""


class Joined(NamedTuple):
    """A closed mesh to walk on.

    vertices (n, 3) [m]; faces (f, 3) int32
    across   (f, 3) int32: triangle beyond the edges a-b, b-c, c-a, -1 where there is none
    ptr, around: triangles round vertex v are around[ptr[v]:ptr[v + 1]], int32
    """

    vertices: Float
    faces: Int
    across: Int
    ptr: Int
    around: Int


def join_faces(vertices: Float, faces: Int) -> Joined:
    """Return a mesh of vertices (n, 3) [m] and triangles (f, 3) with its adjacency."""
    numbers = edge_numbers(faces)[0].reshape(-1)
    order = np.argsort(numbers, kind="stable")
    twin = np.full(len(numbers), -1)
    same = np.flatnonzero(numbers[order[1:]] == numbers[order[:-1]])
    twin[order[same]], twin[order[same + 1]] = order[same + 1], order[same]
    across = np.where(twin >= 0, twin // 3, -1).reshape(-1, 3).astype(np.int32)
    flat = faces.reshape(-1)
    around = (np.argsort(flat, kind="stable") // 3).astype(np.int32)
    ptr = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=len(vertices)))]).astype(np.int32)
    return Joined(
        np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int32), across, ptr, around
    )


class Chord(NamedTuple):
    """A plane: its origin, its direction along, above and across, and its length [m]."""

    origin: Vector
    along: Vector
    above: Vector
    across: Vector
    length: float


@kernel
def make_chord(points: Float, normals: Float, i: int, j: int) -> Chord:
    """Return the plane through points i and j along the mean of their normals; of length 0 if there is none."""
    origin = row_at(points, i)
    u, w = minus(row_at(points, j), origin), plus(row_at(normals, i), row_at(normals, j))
    length = math.sqrt(dot(u, u))
    if length > 0.0:
        u = over(u, length)
    w = minus(w, times(dot(w, u), u))
    size = math.sqrt(dot(w, w))
    if size > 2.0 * UPRIGHT:
        w = over(w, size)
    else:
        length = 0.0
    return Chord(origin, u, w, cross(w, u), length)


@kernel
def side_of(chord: Chord, v: int, vertices: Float) -> float:
    """Return how far to the left of the plane a vertex is [m], seen from above along the chord."""
    return float(dot(minus(row_at(vertices, v), chord.origin), chord.across))


@kernel
def crossed_edge(chord: Chord, face: int, onward: bool, vertices: Float, faces: Int) -> int:
    """Return the edge by which the plane's line leaves a triangle, or enters it if not `onward`; -1 if it is not cut.

    Triangles turn counter-clockwise seen from above, so the line leaves where the corner after is on the left.
    """
    left0 = side_of(chord, faces[face, 0], vertices) >= 0.0
    left1 = side_of(chord, faces[face, 1], vertices) >= 0.0
    left2 = side_of(chord, faces[face, 2], vertices) >= 0.0
    if left0 != left1 and left1 == onward:
        return 0
    if left1 != left2 and left2 == onward:
        return 1
    if left2 != left0 and left0 == onward:
        return 2
    return -1


@kernel
def edge_share(chord: Chord, i: int, j: int, vertices: Float) -> float:
    """Return the share of the way from vertex i to vertex j, on both sides of the plane, at which it is met."""
    si = side_of(chord, i, vertices)
    return si / (si - side_of(chord, j, vertices))


@kernel
def crossing(chord: Chord, face: int, edge: int, vertices: Float, faces: Int) -> tuple[float, float]:
    """Return (u, w) [m] of the point at which the plane meets an edge of a triangle."""
    i, j = faces[face, edge], faces[face, (edge + 1) % 3]
    t = edge_share(chord, i, j, vertices)
    start = row_at(vertices, i)
    x = minus(plus(start, times(t, minus(row_at(vertices, j), start))), chord.origin)
    return dot(x, chord.along), dot(x, chord.above)


@kernel
def find_start(chord: Chord, face: int, vertices: Float, faces: Int, ptr: Int, around: Int) -> int:
    """Return a triangle that the plane cuts, near the given one; -1 if none is found.

    From the corner nearest to the plane to the one nearest to it among its neighbours, until a triangle there is cut:
    of these the one whose line passes nearest to the chord's beginning.
    """
    if crossed_edge(chord, face, True, vertices, faces) >= 0:
        return face
    nearest = faces[face, 0]
    for k in range(1, 3):
        if abs(side_of(chord, faces[face, k], vertices)) < abs(side_of(chord, nearest, vertices)):
            nearest = faces[face, k]
    for _ in range(STEPS):
        best, found, vertex = math.inf, -1, nearest
        for at in range(ptr[vertex], ptr[vertex + 1]):
            other = around[at]
            edge = crossed_edge(chord, other, True, vertices, faces)
            if edge >= 0:
                u, w = crossing(chord, other, edge, vertices, faces)
                if u * u + w * w < best:
                    best, found = u * u + w * w, other
            for k in range(3):
                if abs(side_of(chord, faces[other, k], vertices)) < abs(side_of(chord, nearest, vertices)):
                    nearest = faces[other, k]
        if found >= 0 or nearest == vertex:
            return found
    return -1


@kernel
def follow_section(
    chord: Chord, start: int, below: float, vertices: Float, faces: Int, across: Int, u: Float, w: Float, met: Long
) -> int:  # fmt: skip
    """Write the points of the plane's line between the ends of a chord; return their number, -1 if it misses its end.

    `below` [m] is how far beneath the mesh the ends of the chord are allowed to be. Of each point u, w (STEPS,) and the
    triangle and its edge in met (STEPS, 2).
    """
    allowed, face = SLACK * chord.length + below, start
    edge = crossed_edge(chord, face, False, vertices, faces)
    u0, w0 = crossing(chord, face, edge, vertices, faces)
    for _ in range(STEPS):
        if u0 <= 0.0:
            break
        face = across[face, edge]
        if face < 0:
            return -1
        edge = crossed_edge(chord, face, False, vertices, faces)
        u0, w0 = crossing(chord, face, edge, vertices, faces)
    if u0 > 0.0:
        return -1
    count = 0
    for _ in range(STEPS):
        edge = crossed_edge(chord, face, True, vertices, faces)
        u1, w1 = crossing(chord, face, edge, vertices, faces)
        for end in (0.0, chord.length):
            # At an end of the chord the line lies below it, or the end is inside, or under something.
            if u0 <= end < u1 and w0 + (end - u0) / (u1 - u0) * (w1 - w0) > allowed:
                return -1
        if u1 >= chord.length:
            return count
        if u1 > 0.0:
            u[count], w[count], met[count, 0], met[count, 1] = u1, w1, face, edge
            count += 1
        face, u0, w0 = across[face, edge], u1, w1
        if face < 0:
            return -1
    return -1
