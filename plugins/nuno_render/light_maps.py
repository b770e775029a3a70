"""Depth maps seen along a direction, and what they tell: shadows and how open a point is."""

from __future__ import annotations

import numpy as np
from numba import njit

# mypy: disable-error-code="no-untyped-def"


@njit(cache=True, nogil=True)
def draw_depths(positions, faces, basis, centre, scale, nearest, farthest):
    """Parallel projection of all faces into two maps of signed distance along basis[2].

    positions (n, 3); faces (f, 3); basis (3, 3) rows u, v and the direction toward the light;
    centre (3,) is at the middle of the maps; scale [texels/m]; nearest (r, r) float32 starts at
    -inf and keeps the largest distance; farthest likewise at +inf the smallest, unless (0, 0).
    Edges count as inside: a crack would let light through, a hit too many shows nowhere.
    """
    size = nearest.shape[0]
    both = farthest.shape[0] > 0
    count = positions.shape[0]
    seen = np.empty((count, 3))
    for i in range(count):
        x = positions[i, 0] - centre[0]
        y = positions[i, 1] - centre[1]
        z = positions[i, 2] - centre[2]
        seen[i, 0] = (basis[0, 0] * x + basis[0, 1] * y + basis[0, 2] * z) * scale + 0.5 * size
        seen[i, 1] = (basis[1, 0] * x + basis[1, 1] * y + basis[1, 2] * z) * scale + 0.5 * size
        seen[i, 2] = basis[2, 0] * x + basis[2, 1] * y + basis[2, 2] * z
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, bx, by, cx, cy = seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if not abs(area) > 1e-12:
            continue
        inverse = 1.0 / area
        left = int(max(np.ceil(min(ax, bx, cx) - 0.5), 0.0))
        right = int(min(np.floor(max(ax, bx, cx) - 0.5), size - 1.0))
        top = int(max(np.ceil(min(ay, by, cy) - 0.5), 0.0))
        bottom = int(min(np.floor(max(ay, by, cy) - 0.5), size - 1.0))
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                wb = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) * inverse
                wc = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) * inverse
                if wb < -1e-9 or wc < -1e-9 or wb + wc > 1.0 + 1e-9:
                    continue
                z = np.float32(seen[a, 2] + wb * (seen[b, 2] - seen[a, 2]) + wc * (seen[c, 2] - seen[a, 2]))
                if z > nearest[row, column]:
                    nearest[row, column] = z
                if both and z < farthest[row, column]:
                    farthest[row, column] = z


@njit(cache=True, nogil=True)
def open_part(depths, x, y, z, sign):
    """Part of a bilinear texel footprint at (x, y) that does not block a point at z.

    sign +1: blocked by what lies above z; -1: by what lies below (farthest map).
    """
    size = depths.shape[0]
    x -= 0.5
    y -= 0.5
    column, row = int(np.floor(x)), int(np.floor(y))
    if column < 0 or row < 0 or column + 1 >= size or row + 1 >= size:
        return 1.0
    fx, fy = x - column, y - row
    result = 0.0
    if sign * (depths[row, column] - z) <= 0.0:
        result += (1.0 - fx) * (1.0 - fy)
    if sign * (depths[row, column + 1] - z) <= 0.0:
        result += fx * (1.0 - fy)
    if sign * (depths[row + 1, column] - z) <= 0.0:
        result += (1.0 - fx) * fy
    if sign * (depths[row + 1, column + 1] - z) <= 0.0:
        result += fx * fy
    return result


@njit(cache=True, nogil=True)
def gather_openness(points, normals, basis, centre, scale, nearest, farthest, offset, open_light, all_light):
    """Add one axis' two directions to the sky light that reaches both sides of each point.

    points, normals (n, 3); basis, centre, scale and maps as in draw_depths; offset [m] lifts a
    point off its own surface; open_light, all_light (n, 2): light of the directions that are
    free, and of all, each times its cosine, for the side of the normal and the other side.
    """
    size = nearest.shape[0]
    for i in range(points.shape[0]):
        cosine = normals[i, 0] * basis[2, 0] + normals[i, 1] * basis[2, 1] + normals[i, 2] * basis[2, 2]
        for side in range(2):
            # The direction +axis lights the side it faces and -axis the other one.
            out = 1.0 if side == 0 else -1.0
            sign = 1.0 if out * cosine >= 0.0 else -1.0
            x = points[i, 0] - centre[0] + out * offset * normals[i, 0]
            y = points[i, 1] - centre[1] + out * offset * normals[i, 1]
            z = points[i, 2] - centre[2] + out * offset * normals[i, 2]
            u = (basis[0, 0] * x + basis[0, 1] * y + basis[0, 2] * z) * scale + 0.5 * size
            v = (basis[1, 0] * x + basis[1, 1] * y + basis[1, 2] * z) * scale + 0.5 * size
            w = basis[2, 0] * x + basis[2, 1] * y + basis[2, 2] * z
            # A steep surface rises within a texel: the slack grows with its slope, up to a limit.
            slack = offset * (0.5 + min(np.sqrt(max(1.0 - cosine * cosine, 0.0)) / max(abs(cosine), 0.1), 4.0))
            light = 0.5 * (1.0 + sign * basis[2, 2]) + 0.3
            weight = abs(cosine) * light
            free = open_part(nearest if sign > 0.0 else farthest, u, v, w + sign * slack, sign)
            all_light[i, side] += weight
            open_light[i, side] += weight * free


@njit(cache=True, nogil=True)
def shadow(depths, disc, basis, centre, scale, px, py, pz, nx, ny, nz, spread):
    """Part of the key light that reaches a point, 0 to 1: percentage-closer soft shadows.

    (px, py, pz) the point, lifted off its surface; (nx, ny, nz) its surface's unit normal on the
    lit side; disc (k, 2) taps in the unit disc; spread: tangent of the light's angular radius.

    The taps compare with the receiver's own tangent plane rather than with one depth, so that a
    wide filter neither darkens a slope (acne) nor needs a large bias (detached shadows). The
    width is that of the penumbra: distance to the mean blocker times the spread (Fernando 2005).
    """
    size = depths.shape[0]
    x, y, z = px - centre[0], py - centre[1], pz - centre[2]
    u = (basis[0, 0] * x + basis[0, 1] * y + basis[0, 2] * z) * scale + 0.5 * size
    v = (basis[1, 0] * x + basis[1, 1] * y + basis[1, 2] * z) * scale + 0.5 * size
    w = basis[2, 0] * x + basis[2, 1] * y + basis[2, 2] * z
    facing = max(basis[2, 0] * nx + basis[2, 1] * ny + basis[2, 2] * nz, 0.15)
    gu = -(basis[0, 0] * nx + basis[0, 1] * ny + basis[0, 2] * nz) / (facing * scale)
    gv = -(basis[1, 0] * nx + basis[1, 1] * ny + basis[1, 2] * nz) / (facing * scale)
    search = 0.02 * size
    blockers, total = 0, 0.0
    taps = disc.shape[0]
    for k in range(0, taps, 2):
        du, dv = disc[k, 0] * search, disc[k, 1] * search
        column, row = int(np.floor(u + du)), int(np.floor(v + dv))
        if column < 0 or row < 0 or column >= size or row >= size:
            continue
        above = depths[row, column] - (w + gu * du + gv * dv)
        if above > (abs(gu) + abs(gv)):
            blockers += 1
            total += above
    mean = total / blockers if blockers > 0 else 0.0
    radius = min(max(mean * spread * scale, 1.5), search)
    result = 0.0
    for k in range(taps):
        du, dv = disc[k, 0] * radius, disc[k, 1] * radius
        result += open_part(depths, u + du, v + dv, w + gu * du + gv * dv, 1.0)
    return result / taps
