"""Where the outline of a panel crosses itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nuno_cloth.sewing.curves import Bezier, Curve
from nuno_schemas.fabric import Float
from nuno_schemas.vectors import sides

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
    ends = np.roll(corners, -1, axis=0)
    low, high = np.minimum(corners, ends), np.maximum(corners, ends)
    for at in range(0, n, ROWS):
        # Each with all from the one after the next on; the first and the last are neighbours, too.
        i, j = (part.reshape(-1) for part in np.meshgrid(np.arange(at, min(at + ROWS, n)), np.arange(n), indexing="ij"))
        apart = (j > i + 1) & ~((i == 0) & (j == n - 1))
        apart &= ((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1)
        i, j = i[apart], j[apart]
        # Two chords meet if the ends of each are not on one side of the other, and, on one line, their boxes meet.
        parted = [sides(corners[a], ends[a], corners[b]) * sides(corners[a], ends[a], ends[b]) <= 0
                  for a, b in ((i, j), (j, i))]  # fmt: skip
        met = np.flatnonzero(parted[0] & parted[1])
        if len(met):
            one, other = int(i[met[0]]), int(j[met[0]])
            return int(owner[one]), int(owner[other]), _meeting(corners[[one, other]], ends[[one, other]])
    return None


def _meeting(start: Float, end: Float) -> Float:
    """(2,) where two chords meet that do, each (2,) from start to end: on one line, the middle of what they share."""
    (ux, uy), (vx, vy), (px, py) = *(end - start), start[1] - start[0]
    turn = ux * vy - uy * vx
    if turn != 0.0:
        return np.asarray(start[0] + min(max((px * vy - py * vx) / turn, 0.0), 1.0) * (end[0] - start[0]))
    return np.asarray(0.5 * (np.minimum(start, end).max(axis=0) + np.maximum(start, end).min(axis=0)))
