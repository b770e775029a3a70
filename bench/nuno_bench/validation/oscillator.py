"""Laws of a harmonic oscillator, where every method's step is a matrix, and of a net's normal modes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from nuno_bench.validation.law import (
    NONE,
    BrokenRun,
    Laws,
    Measurement,
    SolverRun,
    Unsupported,
    bisect,
    fit_order,
    make_fabric,
    relative,
)
from nuno_schemas.fabric import Float, Springs
from nuno_schemas.system import System

laws = Laws()
OMEGA, DAMPING = 3.0, 0.6
"""[1/s]"""
EPSILON = float(np.finfo(float).eps)
FITTED = 3
"""Fewest errors that an order is fitted to."""
SHARE = 0.1
"""Damping of the net over the frequency of its fastest mode."""
MODES = "normal modes of a pinned n x n net"
Matrix = Callable[[float, float, float], Float]
"""Of omega, c [1/s] and a step [s]."""
ONE = np.eye(2)

KEEPS_ANGULAR_MOMENTUM = frozenset({"symplectic_euler", "leapfrog"})
"""Kicks and drifts by central forces keep it to rounding."""


def oscillator(omega: float = OMEGA, damping: float = DAMPING) -> System:
    """Two free particles on springs of rest length 0 to a pinned one: x'' = -omega^2 x - damping x'."""
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.2, -0.3], [-0.5, 0.4, 0.9]])
    v = np.array([[0.0, 0.0, 0.0], [0.1, -1.0, 0.5], [0.7, 0.0, -0.2]])
    pairs = np.array([[0, 1], [0, 2]], np.int32)
    springs = Springs.from_pairs(pairs, np.full(2, 2.0 * omega**2), np.zeros(2), np.zeros(2))
    return System(make_fabric(x, springs, 2.0, np.array([True, False, False]), v), NONE, damping)


@laws("one step", "textbook matrices")
def measure_step(plugin: Any) -> Measurement:
    """One step on a damped oscillator is the method's matrix."""
    run, dt = SolverRun(plugin, oscillator()), 0.13
    start, matrix = run.both(), amplification(plugin)(OMEGA, DAMPING, dt)
    run.go(1, dt)
    expected = np.tensordot(matrix, start, 1)
    error = np.abs(run.both() - expected).max()
    return Measurement(run.state.x[1, 0], float(expected[0, 1, 0]), float(error), 1e-12)


@laws("oscillator energy", "Euler 1 + h^2, implicit Euler 1/(1 + h^2) a step; leapfrog within 1/(1 - h^2/4)")
def measure_energy(plugin: Any) -> Measurement:
    """After 200 undamped steps at omega dt = 0.5 the energy is what the matrix's power says.

    Euler's grows by 1 + h^2 a step, implicit Euler's falls by as much; leapfrog's stays within
    1/(1 - h^2/4), symplectic Euler's within (1 + h/2)/(1 - h/2).
    """
    count, dt = 200, 0.5 / OMEGA
    run = SolverRun(plugin, oscillator(damping=0.0))
    start, before = run.both(), run.energy()
    run.go(count, dt)
    end = np.tensordot(np.linalg.matrix_power(amplification(plugin)(OMEGA, 0.0, dt), count), start, 1)
    energies = [float((y[1] ** 2 + OMEGA**2 * y[0] ** 2).sum()) for y in (start, end)]
    return relative(run.energy() / before, energies[1] / energies[0], 1e-9)


@laws("order, oscillator", "damped oscillator")
def measure_order(plugin: Any) -> Measurement:
    """The error against the closed form after 1 s falls with the nominal order."""
    first, ratio = {1: (1600, 2.0), 2: (80, 2.0), 3: (60, 2.0)}.get(plugin.order, (40, 2.0))
    if plugin.order > 5:
        first, ratio = 10, math.sqrt(2.0)
    counts, errors, system = np.round(first * ratio ** np.arange(4)), [], oscillator()
    x, v = system.fabric.position, system.fabric.velocity
    half, rate = 0.5 * DAMPING, math.sqrt(OMEGA**2 - 0.25 * DAMPING**2)
    exact = math.exp(-half) * (x * math.cos(rate) + (v + half * x) / rate * math.sin(rate))
    for count in counts:
        run = SolverRun(plugin, system)
        run.go(int(count), 1.0 / count)
        errors.append(float(np.abs(run.state.x - exact).max()))
    return order_found(plugin, counts, 1.0, np.array(errors), float(np.abs(x).max()))


def order_found(plugin: Any, counts: Float, duration: float, errors: Float, size: float) -> Measurement:
    """The fitted order against the nominal one, of the errors that are not the rounding of quantities of `size`.

    A step rounds by half an epsilon at most, and n steps by about sqrt(n) of that: ten times as much is left out. A
    method of order 8 gets there within twenty-odd steps, where no method falls any further. Raises Unsupported where
    fewer than FITTED errors are left.
    """
    above = ~(errors <= 10.0 * np.sqrt(counts) * EPSILON * size)  # NaN stays, and fails
    if above.sum() < FITTED:
        raise Unsupported(f"only {above.sum()} of {len(errors)} errors are above rounding")
    return fit_order(duration / counts, errors, plugin.order, kept=above)


def pinned_net(n: int, damping: float) -> tuple[System, float, Float]:
    """n x n free vertices inside a pinned frame, springs of rest length 0 to the four neighbours.

    Linear, with modes sin(p pi i/(n + 1)) sin(q pi j/(n + 1)) and squared frequencies
    4 k/m (sin^2(p pi/(2 n + 2)) + sin^2(q pi/(2 n + 2))). Returns the system displaced along its
    fastest mode, that frequency [1/s] and the mode (vertices,); damping is a share of the frequency.
    """
    k, mass, side = 3.0, 0.01, n + 2
    row, column = np.divmod(np.arange(side * side), side)
    pinned = (row == 0) | (row == side - 1) | (column == 0) | (column == side - 1)
    mode = np.sin(n * np.pi * row / (n + 1)) * np.sin(n * np.pi * column / (n + 1)) * ~pinned
    at = np.arange(side * side, dtype=np.int32).reshape(side, side)
    pairs = np.concatenate(
        [np.stack([at[:, :-1], at[:, 1:]], -1).reshape(-1, 2), np.stack([at[:-1], at[1:]], -1).reshape(-1, 2)]
    )
    springs = Springs.from_pairs(pairs, np.full(len(pairs), k), np.zeros(len(pairs)), np.zeros(len(pairs)))
    omega = float(np.sqrt(8.0 * k / mass) * np.sin(n * np.pi / (2 * n + 2)))
    fabric = make_fabric(np.stack([column, row, 1e-3 * mode], axis=1), springs, mass, pinned)
    return System(fabric, NONE, damping * omega), omega, mode


@laws("critical step", MODES)
def measure_critical(plugin: Any) -> Measurement:
    """The fastest mode of a lightly damped net is bounded at 0.999 of the critical step and grows at 1.001."""
    if not plugin.explicit:
        raise Unsupported("implicit: every step is stable")
    if plugin.adaptive:
        raise Unsupported("chooses its own steps")
    system, omega, mode = pinned_net(5, SHARE)
    matrix = amplification(plugin)
    expected = critical_step(matrix, omega, SHARE * omega)
    # As many steps as let the mode grow by e^2 at 1.001 of the critical step, and more than the damping needs.
    count = max(1000, math.ceil(2.0 / math.log(radius(matrix(omega, SHARE * omega, 1.001 * expected)))))

    def grows(dt: float) -> bool:
        run = SolverRun(plugin, system)
        try:
            run.go(count, dt)
        except BrokenRun:
            return True
        end = np.hypot(run.state.x[:, 2] @ mode, run.state.v[:, 2] @ mode / omega)
        return bool(end > system.fabric.position[:, 2] @ mode)

    if not grows(0.999 * expected) and grows(1.001 * expected):
        return Measurement(expected * omega, expected * omega, 1e-3, 1e-3)
    return relative(bisect(0.0, 4.0 * expected, grows, 12) * omega, expected * omega, 1e-3)


@laws("stated limit", MODES)
def measure_limit(plugin: Any) -> Measurement:
    """The stated limit of a lightly damped net is at most the true one, and at least 0.8 of it."""
    if not plugin.explicit or plugin.adaptive:
        raise Unsupported("states no limit: " + ("implicit" if not plugin.explicit else "chooses its own steps"))
    system, omega, _ = pinned_net(5, SHARE)
    run = SolverRun(plugin, system)
    stated = float(plugin.limit(run.config, system, run.state).dt)
    over = stated / critical_step(amplification(plugin), omega, SHARE * omega)
    return Measurement(over, 1.0, 1.0 - over if over <= 1.0 + 1e-9 else math.inf, 0.2)


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
    """The textbook's matrix of a method known by name, else the one that follows from the plugin's tableau or loop.
    Raises Unsupported for one with neither.
    """
    if plugin.name not in TEXTBOOK and not hasattr(plugin, "amplification"):
        raise Unsupported("no textbook's matrix, and neither a tableau nor a loop to have it from")
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
