"""Centripetal Catmull-Rom curves through points.

Between P1 and P2, with P0 before and P3 after, knots are t_(i+1) = t_i + |P_(i+1) - P_i|^(1/2), and the curve is Barry
and Goldman's pyramid of linear interpolations. It passes through all points with a continuous direction, and with these
knots, unlike uniform or chordal ones, makes neither cusps nor loops between two points (C. Yuksel, S. Schaefer, J.
Keyser: Parameterization and applications of Catmull-Rom curves. Computer-Aided Design 43, 2011).

Rejected: B-splines, which do not pass through their points, so that two yarns that cross would come too near.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Bool, Float

CHUNK = 1 << 15
"""Pieces sampled at once."""


def sample_curves(points: Float, ptr: NDArray[np.int64], rings: Bool, number: int) -> tuple[Float, NDArray[np.int64]]:
    """Sample curves through points (n, 3), curve y through points[ptr[y]:ptr[y + 1]] (at least two), as polylines.

    Every piece between two points is divided into `number`, at equal knot intervals. A ring ends at its start; others
    have mirrored points beyond their ends. Returns points (m, 3) and ptr (y + 1,).
    """
    first, last = ptr[:-1], ptr[1:] - 1
    closed = rings[:, None]
    previous, following = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
    previous[first] = np.where(closed, points[last - 1], 2.0 * points[first] - points[first + 1])
    following[last] = np.where(closed, points[first + 1], 2.0 * points[last] - points[last - 1])
    is_last = np.zeros(len(points), bool)
    is_last[last] = True
    pieces = np.flatnonzero(~is_last)
    yarn = np.repeat(np.arange(len(first)), np.diff(ptr))
    # Samples before each point: `number` a piece and one an end.
    place = number * np.arange(len(points)) - (number - 1) * yarn
    sampled = np.empty((number * len(pieces) + len(last), 3))
    share = np.arange(number) / number
    for at in range(0, len(pieces), CHUNK):
        k = pieces[at : at + CHUNK]
        inner = sample_piece(previous[k], points[k], points[k + 1], following[k + 1], share)
        sampled[place[k][:, None] + np.arange(number)] = inner
    sampled[place] = points
    return sampled, np.concatenate([place[first], [len(sampled)]])


def sample_piece(p0: Float, p1: Float, p2: Float, p3: Float, share: Float) -> Float:
    """Return places (m, k, 3) of m pieces from p1 to p2 (m, 3) at shares (k,) of their knots, 0 at p1 and 1 at p2."""
    a, b, c = _step(p0, p1), _step(p1, p2), _step(p2, p3)
    t = share[None, :, None] * b
    # Knots of the four points: -a, 0, b and b + c.
    first = (-t * p0[:, None] + (t + a) * p1[:, None]) / a
    second = ((b - t) * p1[:, None] + t * p2[:, None]) / b
    third = ((b + c - t) * p2[:, None] + (t - b) * p3[:, None]) / c
    left = ((b - t) * first + (t + a) * second) / (a + b)
    right = ((b + c - t) * second + t * third) / (b + c)
    return np.asarray(((b - t) * left + t * right) / b)


def _step(p: Float, q: Float) -> Float:
    """Return knot intervals (m, 1, 1) between points; 1 for points in the same place."""
    step = np.sqrt(np.linalg.norm(q - p, axis=1))[:, None, None]
    return np.where(step > 0.0, step, 1.0)
