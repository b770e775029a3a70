"""A circle skirt: a ring of flat cloth, or half or a quarter of one, sewn to itself and worn by its inner rim.

The cloth lies flat between two circles about one centre. The skirt takes the share f of the inner circle, which is as
long as the waist: W = 2 pi f r. Vertices are on circles, evenly round each, with half a step between neighbouring ones;
triangles join each circle to the next. So no seam shows: a cone is as flat as a plane, and only the yarns, which run
one way in the plane, meet at an angle at the seam, on the left.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from nuno_schemas.fabric import Float, Int

Cut = Literal["cone", "circle", "half", "quarter"]
SHARES = {"circle": 1.0, "half": 0.5, "quarter": 0.25}
"""Share of a full circle of each cut."""
STANDARD = 0.7
"""A skirt that is cut to a body has the triangles that it would have round a waist of this girth [m]."""
LEAST = 12
"""The fewest vertices round each circle."""
FRONT = 0.75
"""Where the middle of the front is, as a share of the way round from the left side by the back."""


class Ring(NamedTuple):
    """A piece of a flat ring.

    row (n,) circle of each vertex; share (n,) its share of the way round, from the left side by the back; faces (f, 3)
    counter-clockwise seen from outside; corners (f, 3, 3) of each triangle in the flat ring about the centre [m]; warp
    (3,) direction of the yarns there: down the middle of the front
    """

    row: Int
    share: Float
    faces: Int
    corners: Float
    warp: Float


def count_round(length: float, waist: float, part: float, edge: float) -> Int:
    """Return the numbers (rows,) of vertices round each circle of a ring cut `length` wide round a `waist` [m]."""
    rows = max(2, round(length / (np.sqrt(0.75) * edge)) + 1)
    girth = waist + 2.0 * np.pi * part * length * np.linspace(0.0, 1.0, rows)
    return np.maximum(LEAST, np.round(girth / edge)).astype(np.int32)


def lay_ring(around: Int, length: float, waist: float, part: float) -> Ring:
    """Return a ring `length` wide round a `waist` [m], the share `part` of a circle, of `around` (rows,) vertices."""
    radius = waist / (2.0 * np.pi * part) + np.linspace(0.0, length, len(around))
    first = np.concatenate([[0], np.cumsum(around)])
    row = np.repeat(np.arange(len(around), dtype=np.int32), around)
    share = (np.arange(first[-1]) - first[row] + 0.5 * (row % 2)) / around[row]
    joined = [_join(i, *around[i : i + 2].tolist()) for i in range(len(around) - 1)]
    circle, place = (np.concatenate(each) for each in zip(*joined, strict=True))
    faces = first[circle] + place % around[circle]
    angle = 2.0 * np.pi * part * (share[faces] + place // around[circle])
    corners = radius[circle][..., None] * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=2)
    front = 2.0 * np.pi * part * FRONT
    return Ring(row, share, faces.astype(np.int32), corners, np.array([np.cos(front), np.sin(front), 0.0]))


def _join(row: int, above: int, below: int) -> tuple[Int, Int]:
    """Return triangles between a circle of `above` vertices and the next, of `below`: the circle (t, 3) of each corner
    and its place on it (t, 3), which counts on beyond the last.
    """
    up, down = np.arange(above), np.arange(below)
    upper, lower = (up + 1 + 0.5 * (row % 2)) / above, (down + 1 + 0.5 * ((row + 1) % 2)) / below
    opposite_upper, opposite_lower = (
        np.searchsorted(lower, upper, side="left"),
        np.searchsorted(upper, lower, side="right"),
    )
    place = np.concatenate([np.stack([up, opposite_upper, up + 1], 1), np.stack([opposite_lower, down, down + 1], 1)])
    circle = np.repeat([[row, row + 1, row], [row, row + 1, row + 1]], [above, below], axis=0)
    return circle, place


def place_ring(ring: Ring, position: Float) -> Float:
    """Return places (n, 3) of a ring's vertices between points of their rows (rows, columns, 3) [m], even on each."""
    columns = position.shape[1]
    at = ring.share * columns
    i = at.astype(np.int64) % columns
    part = (at - np.floor(at))[:, None]
    return np.asarray((1.0 - part) * position[ring.row, i] + part * position[ring.row, (i + 1) % columns])
