"""Compiled functions on a triangle mesh: neighbours, nearest places, and the way of a line over triangles."""

from __future__ import annotations

import numpy as np

from nuno_kernels import kernel
from nuno_schemas.fabric import Bool, Float, Int

BORDER, CROWDED = -1, -2
"""What `link_faces` says of an edge with one triangle, and of one with more than two or turned against each other."""
WAY, NO_BORDER, NO_CROWDED, NO_WAY = 0, 1, 2, 3
"""How `walk_lines` ends."""
TOUCH = 1e-9
"""Length, of the longest part of a line, that a triangle counts which the line only touches."""


@kernel
def link_faces(faces: Int, n: int) -> Int:
    """(f, 3) the triangle across the edge that leaves each corner, BORDER or CROWDED, for n vertices.

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
            same, found, other = 0, 0, -1
            for e in range(start[a], start[a + 1]):
                same += tip[e] == b
            for e in range(start[b], start[b + 1]):
                if tip[e] == a:
                    found, other = found + 1, owner[e]
            if same > 1 or found > 1:
                across[i, c] = CROWDED
            elif found == 1:
                across[i, c] = other
    return across


@kernel
def nearest_faces(points: Float, x: Float, faces: Int, face: Int, at: Float, distance: Float) -> None:
    """The triangle nearest to each of points (p, 3), into face (p,), at (p, 3) barycentric, distance (p,).

    Triangles are passed over by their bounding spheres; of equally near ones the first is taken. The nearest
    place of a triangle is found as in C. Ericson, Real-Time Collision Detection (2005), 5.1.5.
    """
    f = faces.shape[0]
    sphere = np.empty((f, 4))
    for i in range(f):
        most = 0.0
        for k in range(3):
            sphere[i, k] = (x[faces[i, 0], k] + x[faces[i, 1], k] + x[faces[i, 2], k]) / 3.0
        for c in range(3):
            d = 0.0
            for k in range(3):
                d += (x[faces[i, c], k] - sphere[i, k]) ** 2
            most = max(most, d)
        sphere[i, 3] = np.sqrt(most)
    ab, ac, ap = np.empty(3), np.empty(3), np.empty(3)
    for p in range(points.shape[0]):
        best = np.inf
        for i in range(f):
            d = 0.0
            for k in range(3):
                d += (points[p, k] - sphere[i, k]) ** 2
            if d > (best + sphere[i, 3]) ** 2:
                continue
            d1, d2, d3, d4, d5, d6 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(3):
                a = x[faces[i, 0], k]
                ab[k], ac[k], ap[k] = x[faces[i, 1], k] - a, x[faces[i, 2], k] - a, points[p, k] - a
                d1 += ab[k] * ap[k]
                d2 += ac[k] * ap[k]
                d3 += ab[k] * (ap[k] - ab[k])
                d4 += ac[k] * (ap[k] - ab[k])
                d5 += ab[k] * (ap[k] - ac[k])
                d6 += ac[k] * (ap[k] - ac[k])
            va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
            v, w = 0.0, 0.0
            if d1 <= 0.0 and d2 <= 0.0:
                pass
            elif d3 >= 0.0 and d4 <= d3:
                v = 1.0
            elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
                v = d1 / (d1 - d3)
            elif d6 >= 0.0 and d5 <= d6:
                w = 1.0
            elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
                w = d2 / (d2 - d6)
            elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
                w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
                v = 1.0 - w
            else:
                v, w = vb / (va + vb + vc), vc / (va + vb + vc)
            d = 0.0
            for k in range(3):
                d += (ap[k] - v * ab[k] - w * ac[k]) ** 2
            if d < best * best:
                best = np.sqrt(d)
                face[p] = i
                at[p, 0], at[p, 1], at[p, 2] = 1.0 - v - w, v, w
        distance[p] = best


@kernel
def _count(i: int, entry: Float, leave: Float, x: Float, faces: Int, height: float, total: Float, up: Bool) -> None:
    """Add one line's part in triangle i, from `entry` to `leave` (3,) barycentric, to total (f, 5) and up (f, 2)."""
    length = 0.0
    for k in range(3):
        d = 0.0
        for c in range(3):
            d += (leave[c] - entry[c]) * x[faces[i, c], k]
        length += d * d
    length = max(np.sqrt(length), total[-1, 0])
    for c in range(3):
        total[i, c] += 0.5 * length * (entry[c] + leave[c])
    total[i, 3] += length
    total[i, 4] += length * height
    up[i, 1 if height > 0.0 else 0] = True


@kernel
def walk_lines(
    x: Float,
    faces: Int,
    across: Int,
    face: Int,
    at: Float,
    normal: Float,
    first: Int,
    height: Float,
    total: Float,
    up: Bool,
    path: Int,
    part: Int,
) -> tuple[int, int, int]:
    """Follow polylines over the triangles; how it ended, at which point, and how many triangles were passed.

    face (p,), at (p, 3), normal (p, 3)  the points' triangles, barycentric coordinates, and normals of the surface
    first (l + 1,), height (l,)          line i has the points first[i] to first[i + 1]
    total (f + 1, 5)                     out: length times the middle of each part (barycentric), length, length
                                         times height; total[f, 0] is the least length that a part counts
    up (f, 2)                            out: whether a valley, a ridge goes through
    path, part (q,)                      out: triangles in their order, and the line of each

    Between two points a line goes where the plane through both, along the mean of their normals, cuts the
    surface. A vertex in the plane counts as before it, always: so a triangle is cut at none of its edges or at
    two, and every way leads on, also one along edges and through vertices.
    """
    passed = 0
    side = np.empty(3)
    entry, leave, m, t = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    a, b = np.empty(3), np.empty(3)
    for line in range(len(height)):
        for p in range(first[line], first[line + 1] - 1):
            here, goal = face[p], face[p + 1]
            for c in range(3):
                entry[c] = at[p, c]
            for k in range(3):
                a[k], b[k] = 0.0, 0.0
                for c in range(3):
                    a[k] += at[p, c] * x[faces[here, c], k]
                    b[k] += at[p + 1, c] * x[faces[goal, c], k]
                t[k] = b[k] - a[k]
            n0, n1, n2 = (
                normal[p, 0] + normal[p + 1, 0],
                normal[p, 1] + normal[p + 1, 1],
                normal[p, 2] + normal[p + 1, 2],
            )
            if n0 * n0 + n1 * n1 + n2 * n2 < 1e-6:
                n0, n1, n2 = normal[p, 0], normal[p, 1], normal[p, 2]
            m[0], m[1], m[2] = t[1] * n2 - t[2] * n1, t[2] * n0 - t[0] * n2, t[0] * n1 - t[1] * n0
            came = -1
            for _ in range(faces.shape[0] + 1):
                if passed == len(path):
                    return NO_WAY, p, passed
                path[passed], part[passed] = here, line
                passed += 1
                if here == goal:
                    for c in range(3):
                        leave[c] = at[p + 1, c]
                    _count(here, entry, leave, x, faces, height[line], total, up)
                    break
                for c in range(3):
                    side[c] = 0.0
                    for k in range(3):
                        side[c] += (x[faces[here, c], k] - a[k]) * m[k]
                out, furthest, cut = -1, -np.inf, 0.0
                for c in range(3):
                    d = (c + 1) % 3
                    if c != came and (side[c] >= 0.0) != (side[d] >= 0.0):
                        s = side[c] / (side[c] - side[d])
                        way = 0.0
                        for k in range(3):
                            way += ((1.0 - s) * x[faces[here, c], k] + s * x[faces[here, d], k] - a[k]) * t[k]
                        if way > furthest:
                            out, furthest, cut = c, way, s
                if out < 0:
                    return NO_WAY, p, passed
                leave[:] = 0.0
                leave[out], leave[(out + 1) % 3] = 1.0 - cut, cut
                _count(here, entry, leave, x, faces, height[line], total, up)
                after = across[here, out]
                if after < 0:
                    return (NO_BORDER if after == BORDER else NO_CROWDED), p, passed
                for c in range(3):
                    if faces[after, c] == faces[here, (out + 1) % 3] and across[after, c] == here:
                        came = c
                entry[:] = 0.0
                entry[came], entry[(came + 1) % 3] = cut, 1.0 - cut
                here = after
            else:
                return NO_WAY, p, passed
    return WAY, -1, passed
