"""What a knit shows, in numbers: how its links stretch, how its wales and courses run, how close its stitches are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Float, Int

BAND = 0.02
"""Height of the band around a place that is averaged over [m], as the report's pressure has it."""
RIM = 0.3
"""Share of a panel's columns at either side that is left out: its edges are held, or curl."""


class Knitted(NamedTuple):
    """A knit of rows of points, from the bottom, and its links.

    x (rows, columns, 3) [m]; edges (e, 2) of points row by row, rest (e,) [m], kind (e,) of `names`, -1 for none;
    a ring's last column is joined to its first.
    """

    x: Float
    edges: Int
    rest: Float
    kind: NDArray[np.int8]
    names: tuple[str, ...]
    ring: bool


def stretch(knit: Knitted) -> dict[str, float]:
    """Mean |d| / L - 1 of the arcs and of the legs of each yarn that has any, e.g. of `nylon arcs`."""
    points = knit.x.reshape(-1, 3)
    length = np.linalg.norm(points[knit.edges[:, 1]] - points[knit.edges[:, 0]], axis=1)
    own, leg = length / knit.rest - 1.0, np.diff(knit.edges, axis=1)[:, 0] == knit.x.shape[1]
    found = {}
    for index, name in enumerate(knit.names):
        for part, there in (("arcs", ~leg), ("legs", leg)):
            mine = there & (knit.kind == index)
            if mine.any():
                found[f"{name} {part}"] = float(own[mine].mean())
    return found


def zigzag(knit: Knitted) -> float:
    """How far the middle wales run to and fro: mean second difference to the side along a column, in rest lengths."""
    return float(np.abs(np.diff(_middle(knit)[..., 0], n=2, axis=0)).mean() / knit.rest.mean())


def unevenness(knit: Knitted) -> float:
    """Height of the most open course over that of the least, between the first and the last row, in the middle."""
    heights = np.diff(_middle(knit)[1:-1, :, 1], axis=0).mean(axis=1)
    return float(heights.max() / heights.min())


def density_at(knit: Knitted, height: float) -> float:
    """Stitches over area [1/m^2] in the band around a height [m]; NaN where the knit is not."""
    area, level = _cells(knit)
    there = np.abs(level - height) <= 0.5 * BAND
    return float(0.5 * there.sum() / area[there].sum()) if there.any() else float("nan")


def _middle(knit: Knitted) -> Float:
    """(rows, columns in the middle, 3)."""
    side = int(RIM * knit.x.shape[1])
    return knit.x[:, side : knit.x.shape[1] - side]


def _cells(knit: Knitted) -> tuple[Float, Float]:
    """(courses, cells) area [m^2] of each cell, half the cross product of its diagonals, and height of its middle."""
    right = np.roll(knit.x, -1, axis=1)
    if not knit.ring:
        right = right[:, :-1]
    left = knit.x[:, : right.shape[1]]
    a, b, c, d = left[:-1], right[:-1], right[1:], left[1:]
    area = 0.5 * np.linalg.norm(np.cross(c - a, d - b), axis=-1)
    return np.asarray(area), np.asarray(0.25 * (a + b + c + d)[..., 1])
