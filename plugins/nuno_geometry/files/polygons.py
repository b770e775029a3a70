"""The content of a mesh file, and triangles of its polygons: convex or not, flat or not, the same ones whichever corner
comes first.

A fan is right where a polygon is convex; a quad with one corner that is not convex is a fan from there. All else loses
its ears one by one, the roundest first, so that no triangle is thinner than need be. Corners on a straight side stay:
the polygon beyond that side may end there. Rejected: mapbox_earcut, which drops such corners and so opens the surface;
a fan from the first corner, whose triangles overlap on a concave polygon.
"""

from __future__ import annotations

import codecs
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int

Places = NDArray[np.int64]
ROUNDING = 1e-10
"""share of the squared extent that an area is off by at most"""
STRAIGHT = 1e-3
"""Sine of the turn at a corner on a straight side, or less, as files round it; and the share of a triangle's side that
no other corner lies nearer to it than, if it can be. Else triangles would be slivers."""
FLAT = 1e-6
"""share of the extent by which corners of a flat polygon may lie off its plane"""
MOST_CORNERS = 2048
"""most corners of a polygon that is not convex: ears take quadratic time"""


@dataclass(frozen=True)
class RawMesh:
    """A file's triangles, with its own numbers and in its order.

    points (n, 3) in the file's unit, also those of no triangle; faces (f, 3); uv (f, 3, 2) texture coordinates of each
    corner, v upwards, NaN where it has none; None where none has any; lines: of each line of an OBJ file the points
    """

    points: Float
    faces: Int
    uv: NDArray[np.float32] | None = None
    lines: tuple[Places, ...] = ()


def plain(data: bytes) -> bytes:
    r"""Text in UTF-8 whose lines end in \n, without a byte order mark. Raises ValueError for broken UTF-16."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = data.decode("utf-16").encode()
    return data.removeprefix(codecs.BOM_UTF8).replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def triangulate(points: Float, corner: Places, count: Places, lines: Sequence[int] = ()) -> Places:
    """Return the triangles (t, 3) of polygons with `count` (p,) corners each, `corner` (c,) vertices of points (n, 3),
    as places in `corner`: polygon by polygon, counter-clockwise as these are.

    Corners that repeat the one before them are left out. Raises BadInput, with the polygon's number and its line in the
    file, for one that passes through itself.
    """
    owner, place = np.repeat(np.arange(len(count)), count), np.arange(len(corner))
    if (count > 3).any():
        following = place + 1
        following[np.cumsum(count) - 1] -= count
        kept = (count[owner] <= 3) | (corner != corner[following])
        owner, place = owner[kept], place[kept]
        count = np.bincount(owner, minlength=len(count))
    first = np.cumsum(count) - count
    found, of = [], []
    for n in np.unique(count[count >= 3]).tolist():
        corners = np.flatnonzero(count == n)
        each = place[first[corners, None] + np.arange(n)]
        x = points[corner[each]]
        fan, start = _fans(x) if n > 3 else (np.ones(len(corners), bool), np.zeros(len(corners), np.int64))
        turned = np.take_along_axis(each, (start[:, None] + np.arange(n)) % n, axis=1)
        fans = np.stack([np.repeat(turned[:, :1], n - 2, axis=1), turned[:, 1:-1], turned[:, 2:]], axis=2)[fan]
        found.append(fans.reshape(-1, 3))
        of.append(np.repeat(corners[fan], n - 2))
        for k in np.flatnonzero(~fan).tolist():
            try:
                ears = _clip(np.roll(x[k], -start[k], axis=0))
            except ValueError as error:
                number = int(corners[k])
                raise BadInput(
                    f"a polygon {error}", field=f"face {number}", value=f"{n} corners",
                    line=lines[number] if number < len(lines) else None,
                    remedy="triangulate it in the program that it comes from",
                ) from None  # fmt: skip
            found.append(turned[k][ears])
            of.append(np.full(len(ears), corners[k]))
    if not found:
        return np.zeros((0, 3), np.int64)
    return np.concatenate(found)[np.argsort(np.concatenate(of), kind="stable")]


def _fans(x: Float) -> tuple[Bool, Places]:
    """Return whether polygons (m, n, 3) are a fan from one of their corners (m,), and the corner to begin at (m,).

    A flat one begins where its file does. How one bends that is not flat follows from where it is cut, so it begins at
    the corner nearest to its middle, of equally near ones the first by x, y and z.
    """
    n = x.shape[1]
    with np.errstate(invalid="ignore", over="ignore"):
        middle = x.mean(axis=1, keepdims=True)
        y = x - middle
        extent = np.abs(y).max(axis=(1, 2))[:, None]
        normal = np.cross(y, np.roll(y, -1, axis=1)).sum(axis=1)
        length = np.linalg.norm(normal, axis=1)[:, None]
        normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)[:, None]

        def turns(one: Float, other: Float, least: float) -> Bool:
            size = np.linalg.norm(one, axis=2) * np.linalg.norm(other, axis=2)
            return np.asarray((np.cross(one, other) * normal).sum(axis=2) > least * size)

        side = np.roll(y, -1, axis=1) - y
        left = turns(np.roll(side, 1, axis=1), side, STRAIGHT)
        fan: Bool = np.asarray(left.all(axis=1))
        if (
            n > 4
        ):  # all corners turn left in a star too: only in a convex polygon is each side seen alike from the first
            first, beyond = y[:, 1:-1] - y[:, :1], y[:, 2:] - y[:, :1]
            fan &= (turns(first, beyond, ROUNDING) & turns(first[:, :1], beyond, ROUNDING)).all(axis=1)
        flat = (np.abs((y * normal).sum(axis=2)) <= FLAT * extent).all(axis=1)
        near = np.round((y * y).sum(axis=2) / np.where(extent > 0.0, extent, 1.0) ** 2, 6)
    start, cut = np.zeros(len(x), np.int64), ~(fan & flat)
    start[cut] = np.lexsort((*np.moveaxis(x[cut], 2, 0)[::-1], near[cut]), axis=1)[:, 0]
    if n == 4:
        one = (~left).sum(axis=1) == 1
        start[one] = np.argmin(left[one], axis=1)
        fan |= one | ~flat
    return fan, start


def _clip(x: Float) -> Places:
    """Return the corners (n - 2, 3) of a polygon's (n, 3) triangles. Raises ValueError for one that crosses itself."""
    n = len(x)
    if n > MOST_CORNERS:
        raise ValueError(f"has more than {MOST_CORNERS} corners")
    y = x - x.mean(axis=0)
    least = ROUNDING * float(np.abs(y).max()) ** 2
    normal = np.cross(y, np.roll(y, -1, axis=0)).sum(axis=0)
    size = float(np.linalg.norm(normal))
    if not size > least:
        if not (np.linalg.norm(np.cross(y[1:-1] - y[0], y[2:] - y[0]), axis=1) > least).any():
            return np.stack([np.zeros(n - 2, np.int64), np.arange(1, n - 1), np.arange(2, n)], axis=1)  # a line
        raise ValueError("passes through itself")
    u = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
    u /= np.linalg.norm(u)
    p = np.stack([y @ u, y @ np.cross(normal, u) / size], axis=1)
    _check_simple(p, least)
    left, ears, width = list(range(n)), [], [_width(p, k, list(range(n)), least) for k in range(n)]
    while len(left) > 3:
        k = int(np.argmax(width))
        if not width[k] > 0.0:  # its obstacle may be gone
            width = [_width(p, j, left, least) for j in range(len(left))]
            k = int(np.argmax(width))
        if not width[k] > 0.0:
            raise ValueError("touches itself, so that it has no inside")
        ears.append([left[k - 1], left[k], left[(k + 1) % len(left)]])
        del left[k], width[k]
        for j in (k - 1, k % len(left)):
            width[j] = _width(p, j % len(left), left, least)
    return np.array([*ears, left])


def _cross(a: Float, b: Float, c: Float) -> Float:
    """Return twice the area of triangles in the plane."""
    return np.asarray(
        (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    )


def _check_simple(p: Float, least: float) -> None:
    """Raise ValueError for a polygon in the plane (n, 2) two of whose sides cross; they may touch, as a slit's do."""
    end = np.roll(p, -1, axis=0)
    for k in range(len(p) - 2):
        a, b, c, d = p[k], end[k], p[k + 2 :], end[k + 2 :]
        sides = np.stack([_cross(a, b, c), _cross(a, b, d), _cross(c, d, a), _cross(c, d, b)])
        way = np.where(np.abs(sides) > least, np.sign(sides), 0.0)
        if ((way[0] * way[1] < 0.0) & (way[2] * way[3] < 0.0)).any():
            raise ValueError("passes through itself")


def _width(p: Float, k: int, left: list[int], least: float) -> float:
    """Return the roundness of the ear at the k-th corner left, its area over its longest side squared; 0 for none, and
    little if a corner lies next to the side that is cut, for that would leave a sliver.
    """
    a, b, c = p[left[k - 1]], p[left[k]], p[left[(k + 1) % len(left)]]
    area = float(_cross(a, b, c))
    if area <= least:
        return 0.0
    others = p[left]
    inside = (_cross(a, b, others) >= -least) & (_cross(b, c, others) >= -least) & (_cross(c, a, others) >= -least)
    apart = np.all([(others != corner).any(axis=1) for corner in (a, b, c)], axis=0)
    if (inside & apart).any():
        return 0.0
    side, along = float(((c - a) ** 2).sum()), ((others - a) * (c - a)).sum(axis=1)
    near = (np.abs(_cross(a, c, others)) < STRAIGHT * side) & (along > 0.0) & (along < side) & apart
    width = area / max(side, float(((b - a) ** 2).sum()), float(((c - b) ** 2).sum()))
    return 1e-6 * width if near.any() else width
