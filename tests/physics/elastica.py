"""The heavy elastica: how a strip that is clamped level bends by its own weight."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from nuno_bench.validation.law import bisect

PARTS = 1000
"""Intervals of the strip."""


@cache
def chord(gamma: float) -> tuple[float, float]:
    """Height and width of a strip of length 1 that hangs, Gamma = w L^3 / B.

    theta'' = -Gamma (1 - s) cos theta, theta(0) = theta'(1) = 0, theta the angle below level: found by shooting from
    the free end, whose angle is looked for, with Runge and Kutta's method.
    """
    h = 1.0 / PARTS

    def slope(t: float, angle: float) -> float:
        """theta'' by the distance t from the free end."""
        return -gamma * t * math.cos(angle)

    def shoot(end: float) -> tuple[float, float, float]:
        """Angle at the clamp, height and width, for an angle at the free end."""
        angle, rate, height, width = end, 0.0, 0.0, 0.0
        for i in range(PARTS):
            t = i * h
            k1, l1 = rate, slope(t, angle)
            k2, l2 = rate + 0.5 * h * l1, slope(t + 0.5 * h, angle + 0.5 * h * k1)
            k3, l3 = rate + 0.5 * h * l2, slope(t + 0.5 * h, angle + 0.5 * h * k2)
            k4, l4 = rate + h * l3, slope(t + h, angle + h * k3)
            after = angle + h * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
            middle = angle + 0.25 * h * (k1 + k2)
            height += h * (math.sin(angle) + 4.0 * math.sin(middle) + math.sin(after)) / 6.0
            width += h * (math.cos(angle) + 4.0 * math.cos(middle) + math.cos(after)) / 6.0
            angle, rate = after, rate + h * (l1 + 2.0 * l2 + 2.0 * l3 + l4) / 6.0
            if angle < 0.0:
                break
        return angle, height, width

    end = bisect(0.0, 0.5 * math.pi, lambda a: shoot(a)[0] > 0.0)
    return shoot(end)[1:]


def steepness(gamma: float) -> float:
    """Height over width."""
    height, width = chord(gamma)
    return height / width


def gamma_at(angle: float) -> float:
    """Gamma of a strip whose chord is so steep [rad]."""
    return float(np.exp(bisect(math.log(0.1), math.log(1e3), lambda g: steepness(math.exp(g)) > math.tan(angle), 30)))
