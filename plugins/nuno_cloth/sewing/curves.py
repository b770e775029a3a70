"""Edges of a panel: straight lines, Bezier curves and arcs of circles, with their exact lengths and areas.

A polygon of n equal arcs inscribed in a curve is too short, in a circle by (s / R)^2 / 24 for arcs of length s: a tenth
of an armhole's seam is lost on coarse triangles. So the points between the ends move outwards, by s^2 / (24 R) times
one factor for the whole edge, until the polygon is as long as the curve. The points of a circle then lie on a larger
one, and the area between polygon and curve is halved, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from nuno_schemas.fabric import Float
from nuno_schemas.vectors import dot, norm

PIECES = 64
"""Pieces over which Gauss's rule of three points sums a curve's length: exact to 1e-9 of it, or better."""
NODES = 0.5 + 0.5 * np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
STRAIGHT = 1e-7
"""A polygon shorter than its curve by less than this share of it needs no correction."""
SHARPEST = 2.0
"""Upper bound of the turn within an arc for which points are corrected [rad]."""


class Curve(Protocol):
    """A curve in the plane, from t = 0 to 1: points [m] and derivatives by t (k, 2) at values t (k,)."""

    def at(self, t: Float) -> Float: ...
    def slope(self, t: Float) -> Float: ...
    def bend(self, t: Float) -> Float: ...


@dataclass(frozen=True)
class Bezier:
    """A straight line, or a quadratic or cubic curve, with 2, 3 or 4 control points (k, 2)."""

    points: Float

    def at(self, t: Float) -> Float:
        return _casteljau(self.points, t)

    def slope(self, t: Float) -> Float:
        return np.asarray((len(self.points) - 1) * _casteljau(np.diff(self.points, axis=0), t))

    def bend(self, t: Float) -> Float:
        order = len(self.points) - 1
        if order == 1:
            return np.zeros((len(t), 2))
        return np.asarray(order * (order - 1) * _casteljau(np.diff(self.points, n=2, axis=0), t))


def _casteljau(points: Float, t: Float) -> Float:
    """Return points (k, 2) of a curve with control points (m, 2)."""
    rows, share = np.repeat(points[:, None], len(t), axis=1), t[:, None]
    while len(rows) > 1:
        rows = (1.0 - share) * rows[:-1] + share * rows[1:]
    return np.asarray(rows[0])


@dataclass(frozen=True)
class Arc:
    """An arc of a circle: centre (2,), radius [m], its start angle and its turn to the left [rad]."""

    centre: Float
    radius: float
    start: float
    turn: float

    @staticmethod
    def between(start: Float, end: Float, radius: float, large: bool, right: bool) -> Arc:
        """Return the arc that bulges to the right or left of the line from start to end, the larger or smaller one of
        its circle. Raises ValueError if the circle is too small to reach both.
        """
        chord = end - start
        length = float(norm(chord))
        high = radius * radius - 0.25 * length * length
        # The smallest arc that reaches is a half circle, and files are rounded.
        if high < -1e-6 * radius * radius:
            raise ValueError(f"at least {0.5 * length:.9g}")
        high = np.sqrt(max(high, 0.0)) / length
        left = np.array([-chord[1], chord[0]])
        centre = 0.5 * (start + end) + (high if right != large else -high) * left
        spoke = start - centre
        half = float(np.arcsin(min(0.5 * length / radius, 1.0)))
        angle = 2.0 * (np.pi - half if large else half)
        return Arc(centre, radius, float(np.arctan2(spoke[1], spoke[0])), angle if right else -angle)

    def at(self, t: Float) -> Float:
        return np.asarray(self.centre + self.radius * self._spoke(t))

    def slope(self, t: Float) -> Float:
        spoke = self._spoke(t)
        return np.asarray(self.radius * self.turn * np.stack([-spoke[:, 1], spoke[:, 0]], axis=1))

    def bend(self, t: Float) -> Float:
        return np.asarray(-self.radius * self.turn**2 * self._spoke(t))

    def _spoke(self, t: Float) -> Float:
        angle = self.start + self.turn * t
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def lengths_along(curve: Curve) -> Float:
    """Return the lengths (PIECES + 1,) from the start to equal steps of t [m]."""
    t = (np.arange(PIECES)[:, None] + NODES).reshape(-1) / PIECES
    speed = norm(curve.slope(t)).reshape(-1, 3)
    return np.concatenate([[0.0], np.cumsum((speed * WEIGHTS).sum(axis=1) / PIECES)])


def length_of(curve: Curve) -> float:
    """Return the length of a curve [m]."""
    return float(lengths_along(curve)[-1])


def area_under(curve: Curve) -> float:
    """Return half the integral of x dy - y dx along the curve, which round an outline is its area [m^2]."""
    t = (np.arange(PIECES)[:, None] + NODES).reshape(-1) / PIECES
    (x, y), (dx, dy) = curve.at(t).T, curve.slope(t).T
    return float(0.5 * ((x * dy - y * dx).reshape(-1, 3) * WEIGHTS).sum() / PIECES)


def turning_of(curve: Curve) -> float:
    """Return the total absolute turn of a curve [rad]."""
    tangents = curve.slope(np.linspace(0.0, 1.0, PIECES + 1))
    tangents = tangents[norm(tangents) > 0.0]
    cross = tangents[:-1, 0] * tangents[1:, 1] - tangents[:-1, 1] * tangents[1:, 0]
    return float(np.abs(np.arctan2(cross, dot(tangents[:-1], tangents[1:]))).sum())


def spread(curve: Curve, n: int) -> Float:
    """Return the n + 1 values of t that divide the curve into n arcs of equal length."""
    along = lengths_along(curve)
    goal = along[-1] * np.arange(n + 1) / n
    t: Float = np.interp(goal, along, np.arange(PIECES + 1) / PIECES)
    for _ in range(3):
        piece = np.minimum((t * PIECES).astype(np.int64), PIECES - 1)
        low = piece / PIECES
        nodes = low[:, None] + (t - low)[:, None] * NODES
        speed = norm(curve.slope(nodes.reshape(-1))).reshape(-1, 3)
        reached = along[piece] + (t - low) * (speed * WEIGHTS).sum(axis=1)
        rate = norm(curve.slope(t))
        t = np.clip(t - np.divide(reached - goal, rate, out=np.zeros_like(t), where=rate > 0.0), 0.0, 1.0)
    t[0], t[-1] = 0.0, 1.0
    return t


def draw(curve: Curve, n: int) -> Float:
    """Return corners (n + 1, 2) of a polygon of n sides, from end to end, as long as the curve; for n = 1 its chord."""
    t = spread(curve, n)
    points, length = curve.at(t), length_of(curve)
    if n == 1 or length - _length(points) <= STRAIGHT * length:
        return points
    out = _outwards(curve, t[1:-1], length / n)

    def moved(by: float) -> Float:
        return np.concatenate([points[:1], points[1:-1] + by * out, points[-1:]])

    low, high = 0.0, 1.0
    while _length(moved(high)) < length and high < 64.0:
        low, high = high, 2.0 * high
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _length(moved(middle)) < length else (low, middle)
    return np.asarray(moved(high))


def _outwards(curve: Curve, t: Float, step: float) -> Float:
    """Return vectors (k, 2) away from the centres of curvature, step^2 / (24 R) long [m]."""
    slope, bend = curve.slope(t), curve.bend(t)
    speed = np.maximum(dot(slope, slope), np.finfo(float).tiny)
    inwards = (bend - (dot(bend, slope) / speed)[:, None] * slope) / speed[:, None]
    inwards *= np.minimum(1.0, SHARPEST / np.maximum(step * norm(inwards), SHARPEST))[:, None]
    return np.asarray(-step * step / 24.0 * inwards)


def _length(points: Float) -> float:
    return float(norm(np.diff(points, axis=0)).sum())
