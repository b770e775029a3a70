"""How many steps of tension one kick of all other forces may stand for: see nuno_integrators.explicit.respa."""

from __future__ import annotations

import math

import numpy as np

from nuno_integrators.explicit.symplectic_euler import SymplecticEuler
from nuno_integrators.stability import stable_step

SAFE, SMOOTH = 0.7, 0.75
"""Shares of what is stable, and of a radian."""
MOST, MODES = 64, 200
"""Steps for each kick, and modes of tension that are looked at."""


def steps_a_kick(fast: tuple[float, float], slow: tuple[float, float], dt: float) -> int:
    """For how many steps of dt [s] one kick may stand, of forces with the rates (omega, damping) [1/s]."""
    longest = SAFE * stable_step(SymplecticEuler().amplification, *slow, 0.0)
    if slow[0] > 0.0 and fast[0] > 0.0:
        resonant = math.pi * max(1.0 / fast[0], (fast[1] / slow[0] / slow[0] / fast[0] / fast[0]) ** (1.0 / 3.0))
        longest = min(longest, SMOOTH / slow[0], resonant)
    most = max(1, int(min(MOST, longest / dt)))
    for steps in range(2, most + 1):
        if feeds(fast, slow, steps * dt):
            return steps - 1
    return most


def feeds(fast: tuple[float, float], slow: tuple[float, float], span: float) -> bool:
    """Whether kicks that are `span` [s] apart let any mode of tension grow, with all of their damping or with none."""
    share = np.arange(1, MODES + 1) / MODES
    if fast[0] == 0.0:
        return False
    w, d = share * fast[0], share**2 * fast[1]
    # Between kicks: x'' = -w^2 x - d x', overdamped modes taken as just not swinging.
    swing = np.sqrt(np.maximum(w * w - 0.25 * d * d, 1e-12 * w * w))
    fade, c, s = np.exp(-0.5 * d * span), np.cos(swing * span), np.sin(swing * span) / swing
    xx, xv = fade * (c + 0.5 * d * s), fade * s
    vx, vv = -fade * w * w * s, fade * (c - 0.5 * d * s)
    k, most = slow[0] ** 2 * span, 0.0
    for kept in (1.0, 1.0 - slow[1] * span):
        # A kick, and the way to the next one.
        matrix = np.moveaxis(np.array([[xx - xv * k, xv * kept], [vx - vv * k, vv * kept]]), 2, 0)
        most = max(most, float(np.abs(np.linalg.eigvals(matrix)).max()))
    return most > 1.0 + 1e-9
