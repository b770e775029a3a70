"""Textbook matrices of known methods on x'' = -omega^2 x - c x', independent of what the plugins state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from nuno_bench.validation.laws.base import bisect
from nuno_schemas.fabric import Float

Matrix = Callable[[float, float, float], Float]
"""Of omega, c [1/s] and a step [s]."""
ONE = np.eye(2)

KEEPS_ANGULAR_MOMENTUM = frozenset({"symplectic_euler", "leapfrog"})
"""Kicks and drifts by central forces keep it to rounding."""


def _function(of: Callable[[Float], Float]) -> Matrix:
    """A Runge-Kutta method's stability function R(z), of the step times the matrix of rates."""
    return lambda omega, c, dt: of(dt * np.array([[0.0, 1.0], [-omega * omega, -c]]))


def _polynomial(*coefficients: float) -> Matrix:
    """Explicit Runge-Kutta methods: sum of coefficients times powers of z."""
    powers = np.linalg.matrix_power
    return _function(lambda z: np.asarray(sum(a * powers(z, i) for i, a in enumerate(coefficients))))


def _symplectic_euler(omega: float, damping: float, dt: float) -> Float:
    kick = np.array([[1.0, 0.0], [-omega * omega * dt, 1.0 - damping * dt]])
    return np.asarray(np.array([[1.0, dt], [0.0, 1.0]]) @ kick)


def _leapfrog(omega: float, damping: float, dt: float) -> Float:
    """The new acceleration is taken at v + a dt."""
    a = np.array([-omega * omega, -damping])
    x = np.array([1.0, dt]) + 0.5 * dt * dt * a
    ahead = -omega * omega * x - damping * (np.array([0.0, 1.0]) + dt * a)
    return np.stack([x, np.array([0.0, 1.0]) + 0.5 * dt * (a + ahead)])


def _tr_bdf2(z: Float) -> Float:
    """R(z) = (1 + (1 - 2 d) z) / (1 - d z)^2 with d = 1 - 1/sqrt(2) (Hosea & Shampine 1996)."""
    d = 1.0 - 1.0 / math.sqrt(2.0)
    inverse = np.linalg.inv(ONE - d * z)
    return np.asarray((ONE + (1.0 - 2.0 * d) * z) @ inverse @ inverse)


IMPLICIT_EULER = _function(lambda z: np.asarray(np.linalg.inv(ONE - z)))
TEXTBOOK: dict[str, Matrix] = {
    "euler": _polynomial(1.0, 1.0),
    "symplectic_euler": _symplectic_euler,
    "respa": _symplectic_euler,
    "leapfrog": _leapfrog,
    "rk4": _polynomial(1.0, 1.0, 1 / 2, 1 / 6, 1 / 24),
    "dopri5": _polynomial(1.0, 1.0, 1 / 2, 1 / 6, 1 / 24, 1 / 120, 1 / 600),
    "implicit_euler": IMPLICIT_EULER,
    "tr_bdf2": _function(_tr_bdf2),
    "xpbd": IMPLICIT_EULER,
}
"""Dormand & Prince's polynomial: Hairer & Wanner 1996, section IV.2."""


def amplification(plugin: Any) -> Matrix:
    """The textbook's matrix of a method known by name, else the one that the plugin states."""
    return TEXTBOOK.get(plugin.name) or plugin.amplification


def radius(matrix: Float) -> float:
    """Spectral radius."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def critical_step(matrix: Matrix, omega: float, damping: float) -> float:
    """Smallest step [s] from which on the oscillator grows; inf where none does."""

    def grows(dt: float) -> bool:
        return radius(matrix(omega, damping, dt)) > 1.0 + 1e-12

    high = next((h / omega for h in np.arange(0.02, 8.0, 0.02) if grows(h / omega)), math.inf)
    return high if math.isinf(high) else bisect(high - 0.02 / omega, high, grows)
