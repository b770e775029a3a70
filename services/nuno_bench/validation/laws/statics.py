"""Laws of what hangs: a chain's stretch, its curve and its frequencies, and a heavy cantilever strip."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from nuno import registry
from nuno.scene.files import SceneFiles
from nuno_bench.validation.laws.base import (
    ACCURATE,
    DOWN,
    Case,
    Found,
    G,
    Run,
    Unsupported,
    chain,
    choose_step,
    make_fabric,
)
from nuno_schemas.fabric import Float
from nuno_schemas.system import System

DROP = {1: 0.123471, 10: 0.700200, 100: 0.937524}
"""Drop / length of a heavy cantilever at w L^3 / B, from theta'' = -Gamma (1 - s) cos theta,
theta(0) = theta'(1) = 0."""


def settle(run: Run, duration: float, longest: float, measure: Callable[[Float], float], slack: float) -> float:
    """Run on until `measure` of the positions rests, and return it: two looks that change it by less than `slack`.

    There are twelve looks in `duration`. Speeds would not do: an adaptive method keeps those of its
    tolerance. Raises Unsupported where it still moves at the end: the law is of rest.
    """
    steps, dt = choose_step(run, duration / 12.0, longest, 12)
    changes, before = [math.inf], measure(run.state.x)
    for _ in range(12):
        run.go(steps, dt)
        now = measure(run.state.x)
        changes.append(abs(now - before))
        before = now
        if max(changes[-2:]) < slack:
            return now
    raise Unsupported(f"not yet at rest after {duration:.2g} s: {changes[-1]:.1g} off {duration / 12:.2g} s ago")


def measure_elongation(plugin: Any) -> Found:
    """A hanging chain of lumped masses, half a mass at its end, stretches by w L^2 / (2 E A) exactly."""
    n, length, weight, stiffness = 16, 1.0, 1.0, 100.0
    x = np.zeros((n + 1, 3))
    x[:, 1] = -np.linspace(0.0, length, n + 1)
    mass = np.full(n + 1, weight / G / n)
    mass[-1] *= 0.5
    springs = chain(n + 1, stiffness * n / length, length / n)
    # The slowest mode has omega = pi/2 sqrt(E A g / (w L)) = 49 1/s; twice that is its critical damping.
    run = Run(plugin, System(make_fabric(x, springs, mass, np.arange(n + 1) == 0), DOWN, 60.0), ACCURATE)
    expected = weight * length / (2.0 * stiffness)
    measured = settle(run, 2.0, 5e-3, lambda x: float(-length - x[-1, 1]), 1e-5 * expected)
    return Found(measured, expected, abs(measured / expected - 1.0), 1e-4)


def measure_catenary(plugin: Any) -> Found:
    """The sag of a chain of 40 links, 1.5 spans long, against a (cosh(d / 2a) - 1)."""
    n, span, length, strain = 40, 1.0, 1.5, 1e-4
    a = _catenary(span, length)
    tension = G * 1.0 * a / length
    x = np.zeros((n + 1, 3))
    s = np.linspace(-0.5, 0.5, n + 1)
    x[:, 0], x[:, 1] = s * span, -0.6 * (1.0 - (2.0 * s) ** 2)
    mass = np.full(n + 1, 1.0 / n)
    springs = chain(n + 1, tension / strain * n / length, length / n, 0.02)
    run = Run(plugin, System(make_fabric(x, springs, mass, np.abs(s) == 0.5), DOWN, 8.0), ACCURATE)
    expected = a * (math.cosh(span / (2.0 * a)) - 1.0)
    measured = settle(run, 6.0, 5e-3, lambda x: float(-x[:, 1].min()), 1e-4 * expected)
    return Found(measured, expected, abs(measured / expected - 1.0), 2e-3)


def _catenary(span: float, length: float) -> float:
    """a of y = a cosh(x / a) for a chain of `length` between supports `span` apart: length = 2 a sinh(span / 2a)."""
    low, high = 0.05 * span, 50.0 * span
    for _ in range(80):
        a = 0.5 * (low + high)
        low, high = (a, high) if 2.0 * a * math.sinh(span / (2.0 * a)) > length else (low, a)
    return 0.5 * (low + high)


def measure_frequency(plugin: Any, mode: int) -> Found:
    """Frequency of a small swing of a hanging chain of n masses, over sqrt(g / L).

    Its squares are (n g / L) times the zeros of the Laguerre polynomial L_n, which tend to the
    continuous chain's 1.20241, 2.76004, 4.32686 (zeros of J0, halved). Rest lengths are shortened by
    what each link carries, so that all links are alike.
    """
    n, k = 24, 3e4
    link = 1.0 / n
    roots = np.polynomial.laguerre.lagroots([0.0] * n + [1.0])
    omega = math.sqrt(float(roots[mode]) * G / link)
    x = np.zeros((n + 1, 3))
    x[:, 1] = -np.linspace(0.0, 1.0, n + 1)
    # The mode's shape from the free end: L_0, L_1, ... of the root.
    shape = np.array([np.polynomial.laguerre.lagval(roots[mode], [0.0] * i + [1.0]) for i in range(n, -1, -1)])
    x[:, 0] = 1e-5 * shape
    mass = np.full(n + 1, 1.0 / n)
    rest = link - mass[1:] * G * np.arange(n, 0, -1) / k
    run = Run(plugin, System(make_fabric(x, chain(n + 1, k, rest), mass, np.arange(n + 1) == 0), DOWN), ACCURATE)
    steps, dt = choose_step(run, 0.25 * math.pi / omega, 5e-3 / omega)
    angles = [0.0]
    for _ in range(8):
        run.go(steps, dt)
        angles.append(math.atan2(-(run.state.v[:, 0] @ shape) / omega, run.state.x[:, 0] @ shape))
    turned = abs(float(np.unwrap(angles)[-1]))
    measured = turned / (8 * steps * dt)
    scale = math.sqrt(G)  # over sqrt(g / L), L = 1 m
    return Found(measured / scale, omega / scale, abs(measured / omega - 1.0), 2e-3)


def strip(gamma: float, elements: int) -> tuple[System, float]:
    """A clamped strip of square cells and plate rigidity w L^3 / gamma, straight; and its free length [m].

    The first two rows hold the direction of the first step, which is the slope at its middle: the
    free length starts there, so that 64 elements are 65.5 rows from there on.
    """
    density, length = 0.2, 0.2
    rows = elements + 2
    step = length / (rows - 1.5)
    rigidity = density * G * length**3 / gamma
    plugin = registry.load("nuno.models", "sheet")
    fabric = {"density": density, "warp": 400.0, "weft": 400.0, "shear": 100.0, "damping_ratio": 0.0}
    config = plugin.Config(
        size=(step, step * (rows - 1)),
        resolution=(2, rows),
        plane="xz",
        fabric=fabric | {"bend_warp": rigidity, "bend_weft": rigidity},
    )
    piece = plugin.build(config, SceneFiles(Path(), ()), 0)
    cloth = make_fabric(piece.position, piece.springs, piece.mass, np.arange(piece.number) < 4, hinges=piece.hinges)
    return System(cloth, DOWN, _damping(gamma, length)), length


def _damping(gamma: float, length: float) -> float:
    """Near-critical damping of the slowest mode [1/s]: bending, 3.516 sqrt(B / (density L^4)), or swinging."""
    bending = 3.516 * math.sqrt(G / (gamma * length))
    return 1.4 * math.hypot(bending, 1.2 * math.sqrt(G / length))


def measure_cantilever(plugin: Any, gamma: int) -> Found:
    """Drop of the strip's end over its length, settled."""
    system, length = strip(gamma, 64)
    run = Run(plugin, system, ACCURATE)
    measured = settle(run, 48.0 / system.damping, 0.02, lambda x: float(-x[-2:, 1].mean()) / length, 1e-3 * DROP[gamma])
    return Found(measured, DROP[gamma], abs(measured / DROP[gamma] - 1.0), 1e-2)


CASES = (
    Case("elongation", "a hanging chain stretches by w L^2 / (2 E A)", "closed form", measure_elongation),
    Case("catenary", "a chain hangs as y = a cosh(x / a)", "closed form", measure_catenary),
    *(
        Case(f"chain frequency {mode + 1}", "omega sqrt(L / g) of a hanging chain of 24 masses",
             "zeros of the Laguerre polynomial L_24", partial(measure_frequency, mode=mode))
        for mode in range(3)
    ),
    *(
        Case(f"cantilever {gamma}", f"drop of a heavy strip of 64 elements at w L^3 / B = {gamma}",
             "theta'' = -Gamma (1 - s) cos theta", partial(measure_cantilever, gamma=gamma))
        for gamma in DROP
    ),
)  # fmt: skip
