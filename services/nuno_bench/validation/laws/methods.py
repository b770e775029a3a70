"""Textbook matrices of known methods on x'' = -omega^2 x - c x', independent of what the plugins state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from nuno_schemas.fabric import Float

Matrix = Callable[[float, float, float], Float]
ONE = np.eye(2)

KEEPS_ANGULAR_MOMENTUM = frozenset({"symplectic_euler", "leapfrog"})
"""Kicks and drifts by central forces keep it to rounding."""


def _rate(omega: float, damping: float) -> Float:
    return np.array([[0.0, 1.0], [-omega * omega, -damping]])


def _polynomial(coefficients: tuple[float, ...]) -> Matrix:
    """Explicit Runge-Kutta methods: their stability polynomial, of h times the rate matrix."""

    def matrix(omega: float, damping: float, dt: float) -> Float:
        z, total, power = dt * _rate(omega, damping), np.zeros((2, 2)), ONE
        for coefficient in coefficients:
            total = total + coefficient * power
            power = power @ z
        return total

    return matrix


def _symplectic_euler(omega: float, damping: float, dt: float) -> Float:
    kick = np.array([[1.0, 0.0], [-omega * omega * dt, 1.0 - damping * dt]])
    result: Float = np.array([[1.0, dt], [0.0, 1.0]]) @ kick
    return result


def _leapfrog(omega: float, damping: float, dt: float) -> Float:
    """The new acceleration is taken at v + a dt."""
    a = np.array([-omega * omega, -damping])
    x = np.array([1.0, dt]) + 0.5 * dt * dt * a
    ahead = -omega * omega * x - damping * (np.array([0.0, 1.0]) + dt * a)
    return np.stack([x, np.array([0.0, 1.0]) + 0.5 * dt * (a + ahead)])


def _implicit_euler(omega: float, damping: float, dt: float) -> Float:
    result: Float = np.asarray(np.linalg.inv(ONE - dt * _rate(omega, damping)), np.float64)
    return result


def _tr_bdf2(omega: float, damping: float, dt: float) -> Float:
    """R(z) = (1 + (1 - 2 d) z) / (1 - d z)^2 with d = 1 - 1/sqrt(2) (Hosea & Shampine 1996)."""
    d, z = 1.0 - 1.0 / math.sqrt(2.0), dt * _rate(omega, damping)
    inverse = np.linalg.inv(ONE - d * z)
    result: Float = (ONE + (1.0 - 2.0 * d) * z) @ inverse @ inverse
    return result


TEXTBOOK: dict[str, Matrix] = {
    "euler": _polynomial((1.0, 1.0)),
    "symplectic_euler": _symplectic_euler,
    "leapfrog": _leapfrog,
    "rk4": _polynomial((1.0, 1.0, 1 / 2, 1 / 6, 1 / 24)),
    "dopri5": _polynomial((1.0, 1.0, 1 / 2, 1 / 6, 1 / 24, 1 / 120, 1 / 600)),
    "implicit_euler": _implicit_euler,
    "tr_bdf2": _tr_bdf2,
    "xpbd": _implicit_euler,
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
    if math.isinf(high):
        return high
    low = high - 0.02 / omega
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows(middle) else (middle, high)
    return low
