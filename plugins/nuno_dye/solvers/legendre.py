"""Stages and coefficients of the second-order Runge-Kutta-Legendre method (Meyer, Balsara and Aslam 2014)."""

from __future__ import annotations

import math

import numpy as np

from nuno_schemas.fabric import Float


def find_stages(reach: float) -> int:
    """Least odd number of stages that covers `reach` explicit limits."""
    s = max(3, math.ceil(0.5 * (math.sqrt(9.0 + 16.0 * reach) - 1.0)))
    return s + (s + 1) % 2


def find_coefficients(s: int) -> Float:
    """(s, 4) mu, nu, mu', gamma' of the stages (Meyer, Balsara and Aslam 2014, equations 16 and 17)."""
    j = np.arange(s + 1.0)
    b = np.full(s + 1, 1.0 / 3.0)
    b[2:] = (j[2:] ** 2 + j[2:] - 2.0) / (2.0 * j[2:] * (j[2:] + 1.0))
    w = 4.0 / (s * s + s - 2.0)
    found = np.zeros((s, 4))
    found[0, 2] = b[1] * w
    found[1:, 0] = (2.0 * j[2:] - 1.0) / j[2:] * b[2:] / b[1:-1]
    found[1:, 1] = -(j[2:] - 1.0) / j[2:] * b[2:] / b[:-2]
    found[1:, 2] = found[1:, 0] * w
    found[1:, 3] = -(1.0 - b[1:-1]) * found[1:, 2]
    return found
