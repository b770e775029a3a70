"""Compiled functions on a triangle mesh: neighbours, and the path of a line over triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_geometry.poses import blend
from nuno_geometry.sections import crossed_edge, edge_share, make_chord
from nuno_kernels import kernel
from nuno_kernels.lanes import dot, minus
from nuno_schemas.fabric import Bool, Float, Int

BORDER, CROWDED = -1, -2
"""Values of `link_faces` for an edge with one triangle, and for one with more than two or opposite orientations."""
WAY, NO_BORDER, NO_CROWDED, NO_WAY = 0, 1, 2, 3
"""Statuses of `walk_line`."""
TOUCH = 1e-9
"""Length that counts for a triangle that a line only touches, as a share of the line's longest part."""


@kernel
def link_faces(faces: Int, n: int) -> Int:
    """Return the triangle (f, 3) across the edge that leaves each corner, or BORDER or CROWDED, for n vertices.
    Half-edges are sorted by the vertex they leave, so that each is found in its end's short list.
    """
    f = faces.shape[0]
    start = np.zeros(n + 1, np.int64)
    for i in range(f):
        for c in range(3):
            start[faces[i, c] + 1] += 1
    for v in range(n):
        start[v + 1] += start[v]
    at = start[:-1].copy()
    owner, tip = np.empty(3 * f, np.int32), np.empty(3 * f, np.int32)
    for i in range(f):
        for c in range(3):
            place = at[faces[i, c]]
            owner[place], tip[place] = i, faces[i, (c + 1) % 3]
            at[faces[i, c]] = place + 1
    across = np.full((f, 3), BORDER, np.int32)
    for i in range(f):
        for c in range(3):
            a, b = faces[i, c], faces[i, (c + 1) % 3]
            same, opposite_count, other = 0, 0, -1
            for e in range(start[a], start[a + 1]):
                same += tip[e] == b
            for e in range(start[b], start[b + 1]):
                if tip[e] == a:
                    opposite_count, other = opposite_count + 1, owner[e]
            if same > 1 or opposite_count > 1:
                across[i, c] = CROWDED
            elif opposite_count == 1:
                across[i, c] = other
    return across


class Way(NamedTuple):
    """A polyline of height `height` [m] over triangles: its points' triangles (p,), barycentric coordinates (p, 3),
    places (p, 3) [m], and normals (p, 3) of the surface there.
    """

    face: Int
    at: Float
    points: Float
    normal: Float
    height: float


class Passed(NamedTuple):
    """Sums of lines over f triangles.

    total (f + 1, 5)  length times the middle of each part (barycentric), length, length times height; total[f, 0] is
                      the least length of a part
    up    (f, 2)      whether a valley, a ridge passes
    path  (q,)        triangles of one line in order
    """

    total: Float
    up: Bool
    path: Int
    leave: Float


@kernel
def _count(i: int, entry: Float, leave: Float, x: Float, faces: Int, height: float, passed: Passed) -> None:
    """Add one line's part in triangle i, from `entry` to `leave` (3,) barycentric."""
    total, way = passed.total, blend(minus(leave, entry), x, faces[i])
    length = max(np.sqrt(dot(way, way)), total[-1, 0])
    for c in range(3):
        total[i, c] += 0.5 * length * (entry[c] + leave[c])
    total[i, 3] += length
    total[i, 4] += length * height
    passed.up[i, 1 if height > 0.0 else 0] = True


@kernel
def walk_line(x: Float, faces: Int, across: Int, way: Way, passed: Passed) -> tuple[int, int, int]:
    """Follow a polyline over the triangles. Return its status, the point where it ended, and the number of triangles
    passed. Between two points a line follows the cut of the surface with the plane through both along the mean of their
    normals (nuno_geometry.sections).
    """
    face, at, path, count = way.face, way.at, passed.path, 0
    entry, leave = np.empty(3), np.empty(3)
    for p in range(len(face) - 1):
        chord = make_chord(way.points, way.normal, p, p + 1)
        current, goal = face[p], face[p + 1]
        for c in range(3):
            entry[c] = at[p, c]
        for _ in range(faces.shape[0] + 1):
            if count == len(path):
                return NO_WAY, p, count
            path[count] = current
            passed.leave[count] = at[p + 1]
            count += 1
            if current == goal:
                _count(current, entry, at[p + 1], x, faces, way.height, passed)
                break
            out = crossed_edge(chord, current, True, x, faces) if chord.length > 0.0 else -1
            if out < 0:
                return NO_WAY, p, count
            ahead = (out + 1) % 3
            cut = edge_share(chord, faces[current, out], faces[current, ahead], x)
            leave[:] = 0.0
            leave[out], leave[ahead] = 1.0 - cut, cut
            passed.leave[count - 1] = leave
            _count(current, entry, leave, x, faces, way.height, passed)
            next_face = across[current, out]
            if next_face < 0:
                return (NO_BORDER if next_face == BORDER else NO_CROWDED), p, count
            entry[:] = 0.0
            for c in range(3):
                if faces[next_face, c] == faces[current, ahead] and across[next_face, c] == current:
                    entry[c], entry[(c + 1) % 3] = cut, 1.0 - cut
            current = next_face
        else:
            return NO_WAY, p, count
    return WAY, -1, count
