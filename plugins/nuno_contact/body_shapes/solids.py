"""Boxes, cylinders and cones as closed meshes, with rounded edges if requested; y up, their middle at 0."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from nuno_schemas.fabric import Float, Int

CORNER = 4
"""least number of sides round a quarter of a rounded edge"""


def box_mesh(size: tuple[float, float, float], rounding: float, resolution: int) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] and triangles (f, 3), seen counter-clockwise from outside.

    size [m] along x, y and z; rounding [m] is the radius of edges and corners; sides of triangles are about as long as
    the longest way round over `resolution`.
    """
    half = 0.5 * np.asarray(size)
    step = 8.0 * float(np.sort(half)[1:].sum()) / 2.0 / resolution
    corner = max(CORNER, math.ceil(0.5 * math.pi * rounding / step)) if rounding > 0.0 else 0
    # Along each axis; in a rounded edge the points of a cube that map to even angles of a circle.
    bent = rounding * np.tan(np.linspace(0.0, 0.25 * math.pi, corner + 1)[1:]) if corner else np.zeros(0)
    axes = []
    for one in half:
        flat = one - rounding
        middle = np.linspace(-flat, flat, max(1, math.ceil(2.0 * flat / step)) + 1) if flat > 0.0 else np.zeros(1)
        axes.append(np.concatenate([-(flat + bent[::-1]), middle, flat + bent]))
    points, faces, number = [], [], 0
    for axis in range(3):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        u, v = np.meshgrid(axes[one], axes[other], indexing="ij")
        for sign in (-1.0, 1.0):
            side = np.empty((u.size, 3))
            side[:, axis], side[:, one], side[:, other] = sign * half[axis], u.reshape(-1), v.reshape(-1)
            points.append(side)
            faces.append(number + _grid(len(axes[one]), len(axes[other]), sign < 0.0))
            number += u.size
    x = np.concatenate(points)
    inner = np.clip(x, rounding - half, half - rounding)
    out = x - inner
    length = np.linalg.norm(out, axis=1, keepdims=True)
    if rounding > 0.0:
        x = inner + rounding * out / length
    return _welded(x, np.concatenate(faces), 1e-9 * float(half.max()))


def cone_mesh(size: tuple[float, float, float], top: float, rounding: float, resolution: int) -> tuple[Float, Int]:
    """Return a cone whose top is this share of its base as wide: 1 is a cylinder, 0 has a tip. Else as `box_mesh`.

    size [m] is the base's width, the height, and the base's depth; round it go `resolution` vertices.
    """
    radius, height = 0.5 * size[0], size[1]
    step = max(2.0 * math.pi * radius, 4.0 * radius + 2.0 * height) / resolution
    outline = _outline(radius, top * radius, height, rounding, step)
    turn = 2.0 * math.pi * np.arange(resolution) / resolution
    ring = np.stack([np.sin(turn), np.zeros(resolution), np.cos(turn)], axis=1)
    inside = outline[1:-1]
    x = np.concatenate([
        [[0.0, outline[0, 1], 0.0]],
        (inside[:, :1, None] * ring + inside[:, 1:, None] * [0.0, 1.0, 0.0]).reshape(-1, 3),
        [[0.0, outline[-1, 1], 0.0]],
    ])  # fmt: skip
    k, after = np.arange(resolution), np.roll(np.arange(resolution), -1)
    rows = 1 + resolution * np.arange(len(inside))
    faces = [np.stack([np.zeros(resolution, np.int64), 1 + after, 1 + k], axis=1)]
    for below, above in pairwise(rows):
        faces += [np.stack([below + k, below + after, above + after], axis=1),
                  np.stack([below + k, above + after, above + k], axis=1)]  # fmt: skip
    faces.append(np.stack([rows[-1] + k, rows[-1] + after, np.full(resolution, len(x) - 1)], axis=1))
    x[:, 1] -= 0.5 * height
    x[:, 2] *= size[2] / size[0]
    return x, np.concatenate(faces).astype(np.int32)


def _outline(base: float, top: float, height: float, rounding: float, step: float) -> Float:
    """Return radius and height (k, 2) of an outline from the middle of the base to that of the top."""
    corners = np.array([[0.0, 0.0], [base, 0.0], [top, height], [0.0, height]])
    if top == 0.0:
        corners = np.array([[0.0, 0.0], [base, 0.0], [0.0, height], [-base, 0.0]])
    parts, at = list[Float](), corners[0]
    for i in (1, 2):
        before, corner, after = corners[i - 1 : i + 2]
        arc = _fillet(before, corner, after, rounding, step)
        if top == 0.0 and i == 2:
            arc = arc[: len(arc) // 2 + 1]  # up to the axis
            arc[-1, 0] = 0.0
        parts += [_between(at, arc[0], step), arc]
        at = arc[-1]
    if top > 0.0:
        parts.append(_between(at, corners[3], step))
    found = np.concatenate([corners[:1], *parts])
    keep = np.concatenate([[True], np.linalg.norm(np.diff(found, axis=0), axis=1) > 1e-9 * height])
    return np.asarray(found[keep])


def _fillet(before: Float, corner: Float, after: Float, radius: float, step: float) -> Float:
    """Return an arc that rounds a corner on the way, an odd number of points; the corner itself for no radius."""
    if radius == 0.0:
        return corner[None].copy()
    one, other = before - corner, after - corner
    one, other = one / np.linalg.norm(one), other / np.linalg.norm(other)
    half = 0.5 * math.acos(float(np.clip(one @ other, -1.0, 1.0)))
    bisector = (one + other) / np.linalg.norm(one + other)
    centre = corner + bisector * radius / math.sin(half)
    sweep = math.pi - 2.0 * half
    number = 2 * max(CORNER // 2, math.ceil(0.5 * radius * sweep / step))
    angles = np.linspace(-0.5 * sweep, 0.5 * sweep, number + 1)
    across = np.array([bisector[1], -bisector[0]])
    across *= np.sign(across @ other)
    return np.asarray(centre + radius * (np.sin(angles)[:, None] * across - np.cos(angles)[:, None] * bisector))


def _between(start: Float, end: Float, step: float) -> Float:
    """Return points between two, about a step apart, without the ends."""
    number = max(1, math.ceil(float(np.linalg.norm(end - start)) / step))
    share = np.arange(1, number)[:, None] / number
    return np.asarray(start + share * (end - start))


def _grid(rows: int, columns: int, turned: bool) -> Int:
    """Return two triangles for each cell of a grid of vertices."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    b, c, d = a + columns, a + columns + 1, a + 1
    found = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.asarray(found[:, ::-1] if turned else found)


def _welded(x: Float, faces: Int, near: float) -> tuple[Float, Int]:
    """Merge vertices at the same place, and drop triangles with fewer than three."""
    _, first, which = np.unique(np.rint(x / near).astype(np.int64), axis=0, return_index=True, return_inverse=True)
    sewn = which.reshape(-1)[faces].astype(np.int32)
    return x[first], sewn[(sewn != np.roll(sewn, 1, axis=1)).all(axis=1)]
