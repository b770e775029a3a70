"""Chords between points on a triangle mesh as strings: the shortest path in one plane that stays outside.

The path is the upper hull of the line in which the plane cuts the mesh (nuno_kernels.meshes.section) and of both ends:
it bends round ridges and is straight over hollows. All its inner points are on edges of the mesh.

Rejected: the knit paper's path, which projects the rest of the chord onto every triangle again, so that the plane turns
a little at each edge. It may not arrive, but turn round near the second point. In one plane it arrives if the plane's
line joins both points.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import kernel
from nuno_kernels.meshes.section import STEPS, Joined, edge_share, find_start, follow_section, make_chord
from nuno_schemas.fabric import Float, Int


@kernel
def upper_hull(count: int, length: float, tolerance: float, u: Float, w: Float, order: NDArray[np.int64]) -> int:
    """Return the number of `count` points (u, w) on the upper hull of these, (0, 0) and (length, 0); order[:..] are
    their indices. Points at most `tolerance` [m] above the path without them are left out.
    """
    for k in range(count):
        place = k
        while place > 0 and u[order[place - 1]] > u[k]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = k
    kept = 0
    for k in range(count + 1):
        point = order[k] if k < count else -1
        x, y = (u[point], w[point]) if point >= 0 else (length, 0.0)
        while kept > 0:
            bx, by = u[order[kept - 1]], w[order[kept - 1]]
            ax, ay = (u[order[kept - 2]], w[order[kept - 2]]) if kept > 1 else (0.0, 0.0)
            if (bx - ax) * (y - ay) < (by - ay) * (x - ax):
                break
            kept -= 1
        if point >= 0:
            order[kept] = point
            kept += 1
    return thin_hull(kept, length, tolerance, u, w, order)


@kernel
def thin_hull(count: int, length: float, tolerance: float, u: Float, w: Float, order: NDArray[np.int64]) -> int:
    """Leave points of a hull out while all of these stay within `tolerance` of the path. Return the number kept."""
    kept, x0, y0, last = 0, 0.0, 0.0, 0
    for k in range(1, count + 1):
        x, y = (u[order[k]], w[order[k]]) if k < count else (length, 0.0)
        for m in range(last, k):
            a, b = u[order[m]] - x0, w[order[m]] - y0
            if b * (x - x0) - a * (y - y0) > tolerance * (x - x0):
                last = k
                break
        if last == k:
            order[kept] = order[k - 1]
            x0, y0 = u[order[kept]], w[order[kept]]
            kept += 1
    return kept


LIES, CLEAR, LOST = 1, 0, -1
"""Status of a chord: laid over the mesh, straight and outside, or without a path."""


class NearPoints(NamedTuple):
    """Points (n, 3) [m] near a mesh, with normals (n, 3), distance (n,) [m] and triangle (n,) of the closest point."""

    points: Float
    normals: Float
    distance: Float
    foot: Int


class Laid(NamedTuple):
    """Chords over a mesh: status (s,) LIES, CLEAR or LOST; chord k gains points[ptr[k]:ptr[k + 1]] on faces `face`."""

    status: NDArray[np.int8]
    ptr: NDArray[np.int64]
    points: Float
    face: Int


@kernel
def lay_chords(
    begin: int, near: NearPoints, pairs: NDArray[np.int64], tolerance: float, mesh: Joined, laid: Laid
) -> int:
    """Lay chords from `begin` over the mesh. Return the first one without space in laid.points."""
    points, distance, status, ends, added = near.points, near.distance, laid.status, laid.ptr, laid.points
    vertices, faces = mesh.vertices, mesh.faces
    u, w = np.empty(STEPS), np.empty(STEPS)
    met, order = np.empty((STEPS, 2), np.int64), np.empty(STEPS, np.int64)
    for k in range(begin, pairs.shape[0]):
        i, j, at = pairs[k, 0], pairs[k, 1], ends[k]
        if at + STEPS > added.shape[0]:
            return k
        ends[k + 1], status[k] = at, CLEAR
        dx, dy, dz = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
        # A point of a chord is at least as far from the mesh as an end, less its distance from that end.
        if max(distance[i], 0.0) + max(distance[j], 0.0) >= math.sqrt(dx * dx + dy * dy + dz * dz):
            continue
        chord = make_chord(points, near.normals, i, j)
        start = find_start(chord, near.foot[i], vertices, faces, mesh.ptr, mesh.around) if chord.length > 0.0 else -1
        count = -1
        if start >= 0:
            below = 2.0 * max(-distance[i], -distance[j], 0.0)
            count = follow_section(chord, start, below, vertices, faces, mesh.across, u, w, met)
        if count < 0:
            status[k] = LOST
            continue
        kept = upper_hull(count, chord.length, tolerance, u, w, order)
        for m in range(kept):
            face, edge = met[order[m], 0], met[order[m], 1]
            first, second = faces[face, edge], faces[face, (edge + 1) % 3]
            t = edge_share(chord, first, second, vertices)
            for c in range(3):
                added[at + m, c] = vertices[first, c] + t * (vertices[second, c] - vertices[first, c])
            laid.face[at + m] = face
        if kept > 0:
            status[k], ends[k + 1] = LIES, at + kept
    return int(pairs.shape[0])


def lay_over(mesh: Joined, near: NearPoints, pairs: Int, tolerance: float) -> Laid:
    """Lay chords between points, pairs (s, 2) of them, as strings over a closed mesh. A chord at most `tolerance` [m]
    deep stays straight.
    """
    every = np.ascontiguousarray(pairs, np.int64)
    status, ends = np.zeros(len(every), np.int8), np.zeros(len(every) + 1, np.int64)
    added, face = np.empty((len(every) + 2 * STEPS, 3)), np.empty(len(every) + 2 * STEPS, np.int32)
    next_chord = 0
    while next_chord < len(every):
        next_chord = lay_chords(next_chord, near, every, tolerance, mesh, Laid(status, ends, added, face))
        if next_chord < len(every):
            added, face = np.concatenate([added, np.empty_like(added)]), np.concatenate([face, np.empty_like(face)])
    return Laid(status, ends, added[: ends[-1]].copy(), face[: ends[-1]].copy())
