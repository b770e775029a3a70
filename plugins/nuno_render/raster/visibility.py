"""Which triangle each sample of the picture sees: a z-buffer over exact integer coverage.

Vertices arrive in homogeneous pixel coordinates (X w, Y w, w): the pixel is (X, Y), y down,
and w the distance along the line of sight. Screen positions are rounded to 1/256 pixel and the
edge functions are integers, so that with the top-left rule a sample on an edge shared by two
triangles belongs to exactly one of them, whatever their shapes (Pineda 1988).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import kernel
from nuno_schemas.fabric import Bool, Float, Int

GUARD = 2.0**21
"""Pixels kept around the picture: beyond it triangles are cut, and within it the edge functions
(24 + 8 bits, squared, summed) stay inside 63 bits."""

PATTERNS: dict[int, NDArray[np.int64]] = {
    1: np.array([[0, 0]]),
    4: np.array([[-2, -6], [6, -2], [-6, 2], [2, 6]]),
    8: np.array([[1, -3], [-1, 3], [5, 1], [-3, -5], [-5, 5], [-7, -1], [3, 7], [7, -7]]),
    16: np.array(
        [[1, 1], [-1, -3], [-3, 2], [4, -1], [-5, -2], [2, 5], [5, 3], [3, -5],
         [-2, 6], [0, -7], [-4, -6], [-6, 4], [-8, 0], [7, -4], [6, 7], [-7, -8]]
    ),
}  # fmt: skip
"""Sample positions in 1/16 pixel from the pixel's centre: the usual n-rooks patterns, which have
as many distinct rows and columns as samples and so smooth steep and flat edges alike."""


def sample_offsets(samples: int) -> NDArray[np.int64]:
    """(samples, 2) positions in 1/256 pixel from the pixel's upper left corner."""
    return PATTERNS[samples].astype(np.int64) * 16 + 128


@kernel
def _cut(source: Float, count: int, target: Float, plane: int, near: float) -> int:
    """Sutherland-Hodgman: cut polygon `source` (count, 3) by one plane into `target`."""
    made = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        da = _inside(source[i, 0], source[i, 1], source[i, 2], plane, near)
        db = _inside(source[j, 0], source[j, 1], source[j, 2], plane, near)
        if da >= 0.0:
            for k in range(3):
                target[made, k] = source[i, k]
            made += 1
        if (da >= 0.0) != (db >= 0.0):
            s = da / (da - db)
            for k in range(3):
                target[made, k] = source[i, k] + s * (source[j, k] - source[i, k])
            made += 1
    return made


@kernel
def _inside(x: float, y: float, w: float, plane: int, near: float) -> float:
    """Signed measure of a homogeneous point against a plane: near, then left, right, top, bottom."""
    if plane == 0:
        return w - near
    along = x if plane < 3 else y
    return GUARD * w + along if plane % 2 == 1 else GUARD * w - along


@kernel
def _fill(
    polygon: Float, b: int, owner_id: int, cull: bool, offsets: NDArray[np.int64], reach: int,
    depth: NDArray[np.float32], owner: Int,
) -> int:  # fmt: skip
    """Draw the triangle of corners 0, b, b + 1 of a convex polygon that needs no cutting; returns samples written."""
    a, c = 0, b + 1
    height, width, samples = depth.shape
    ia, ib, ic = 1.0 / polygon[a, 2], 1.0 / polygon[b, 2], 1.0 / polygon[c, 2]
    ax, ay = round(polygon[a, 0] * ia * 256.0), round(polygon[a, 1] * ia * 256.0)
    bx, by = round(polygon[b, 0] * ib * 256.0), round(polygon[b, 1] * ib * 256.0)
    cx, cy = round(polygon[c, 0] * ic * 256.0), round(polygon[c, 1] * ic * 256.0)
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if area == 0 or (cull and area > 0):
        return 0
    if area < 0:
        bx, by, ib, cx, cy, ic = cx, cy, ic, bx, by, ib
        area = -area
    left, right = max(min(ax, bx, cx) >> 8, 0), min(max(ax, bx, cx) >> 8, width - 1)
    top, bottom = max(min(ay, by, cy) >> 8, 0), min(max(ay, by, cy) >> 8, height - 1)
    if left > right or top > bottom:
        return 0
    # Edge p -> q at a sample r: (q - p) x (r - p) >= 0, less one where the edge is neither top nor left.
    x0, y0, x1, y1, x2, y2 = bx - ax, by - ay, cx - bx, cy - by, ax - cx, ay - cy
    t0 = 0 if y0 < 0 or (y0 == 0 and x0 > 0) else 1
    t1 = 0 if y1 < 0 or (y1 == 0 and x1 > 0) else 1
    t2 = 0 if y2 < 0 or (y2 == 0 and x2 > 0) else 1
    m0, m1, m2 = reach * (abs(x0) + abs(y0)), reach * (abs(x1) + abs(y1)), reach * (abs(x2) + abs(y2))
    # 1/w is affine on the screen. The rounded corners are used, so that it stays between theirs.
    gx = ((ib - ia) * (cy - ay) - (ic - ia) * (by - ay)) / area
    gy = ((ic - ia) * (bx - ax) - (ib - ia) * (cx - ax)) / area
    low, high = min(ia, ib, ic), max(ia, ib, ic)
    written = 0
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            px, py = column << 8, row << 8
            mx, my = px + 128, py + 128
            miss = x0 * (my - ay) - y0 * (mx - ax) + m0 < 0 or x1 * (my - by) - y1 * (mx - bx) + m1 < 0
            if miss or x2 * (my - cy) - y2 * (mx - cx) + m2 < 0:
                continue
            for s in range(samples):
                rx, ry = px + offsets[s, 0], py + offsets[s, 1]
                miss = x0 * (ry - ay) - y0 * (rx - ax) < t0 or x1 * (ry - by) - y1 * (rx - bx) < t1
                if miss or x2 * (ry - cy) - y2 * (rx - cx) < t2:
                    continue
                written += 1
                iw = np.float32(min(max(ia + gx * (rx - ax) + gy * (ry - ay), low), high))
                if iw > depth[row, column, s]:
                    depth[row, column, s] = iw
                    owner[row, column, s] = owner_id
    return written


@kernel
def rasterise(
    clip: Float, faces: Int, mesh: Int, two_sided: Bool, near: float, offsets: NDArray[np.int64], reach: int,
    depth: NDArray[np.float32], owner: Int,
) -> int:  # fmt: skip
    """Draw all triangles; returns how many samples they covered, hidden ones included.

    clip (n, 3) homogeneous pixels; faces (f, 3); mesh (f,) index into two_sided (m,);
    near [m]; offsets (s, 2) [1/256 pixel], at most `reach` from the pixel's centre;
    depth (h, w, s) float32, nearest 1/w, and owner (h, w, s) int32, its face: both updated.
    Of two surfaces at one depth the first stays. Front faces, counter-clockwise seen by the
    viewer, have a negative area where y points down; a one-sided mesh shows only these.
    """
    first = np.empty((10, 3))
    second = np.empty((10, 3))
    covered = 0
    for f in range(faces.shape[0]):
        outside = False
        for k in range(3):
            x, y, w = clip[faces[f, k], 0], clip[faces[f, k], 1], clip[faces[f, k], 2]
            first[k, 0], first[k, 1], first[k, 2] = x, y, w
            outside |= not (w >= near and abs(x) <= GUARD * w and abs(y) <= GUARD * w)
        count = 3
        if outside:
            for plane in range(5):
                count = _cut(first, count, second, plane, near)
                first, second = second, first
        cull = not two_sided[mesh[f]]
        for k in range(1, count - 1):
            covered += _fill(first, k, f, cull, offsets, reach, depth, owner)
    return covered
