"""Where the outline of a panel crosses itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nuno_cloth.sewing.curves import Bezier, Curve
from nuno_schemas.fabric import Float

FINE = 48
"""Chords that stand for a curve here."""
ROWS = 256
"""Chords that are held against all others at a time."""


def find_crossing(curves: Sequence[Curve]) -> tuple[int, int, Float] | None:
    """The numbers of the first two edges that cross or touch, and where (2,) [m]; curves go round, end to end."""
    chords = [1 if isinstance(curve, Bezier) and len(curve.points) == 2 else FINE for curve in curves]
    corners = np.concatenate([curve.at(np.arange(n) / n) for curve, n in zip(curves, chords, strict=True)])
    owner = np.repeat(np.arange(len(curves)), chords)
    n = len(corners)
    way = np.roll(corners, -1, axis=0) - corners
    for at in range(0, n, ROWS):
        # Each with all from the one after the next on; the first and the last are neighbours, too.
        i, j = (part.reshape(-1) for part in np.meshgrid(np.arange(at, min(at + ROWS, n)), np.arange(n), indexing="ij"))
        apart = (j > i + 1) & ~((i == 0) & (j == n - 1))
        i, j = i[apart], j[apart]
        # corner_i + s way_i = corner_j + t way_j
        between = corners[j] - corners[i]
        cross = _cross(way[i], way[j])
        with np.errstate(divide="ignore", invalid="ignore"):
            s, t = _cross(between, way[j]) / cross, _cross(between, way[i]) / cross
        met = np.flatnonzero((s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0))
        if len(met):
            first = met[0]
            where = corners[i[first]] + s[first] * way[i[first]]
            return int(owner[i[first]]), int(owner[j[first]]), where
    return None


def _cross(a: Float, b: Float) -> Float:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
