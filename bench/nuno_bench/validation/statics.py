"""Laws of what hangs: a chain's stretch, its curve and its frequencies, a heavy strip, a draped disc."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from nuno_bench.instruments import specimens
from nuno_bench.piles import DOWN, G, build_model
from nuno_bench.validation.law import (
    ACCURATE,
    NONE,
    Laws,
    Measurement,
    SolverRun,
    Unsupported,
    bisect,
    chain,
    choose_step,
    make_fabric,
    relative,
)
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.system import System

laws = Laws()
DROP = {1: 0.123471, 10: 0.700200, 100: 0.937524}
"""Drop / length of a heavy cantilever at w L^3 / B, from theta'' = -Gamma (1 - s) cos theta,
theta(0) = theta'(1) = 0."""
LOOKS = 12
POISSON = {"0": 0.0, "0.3": 0.3, "-1/3": -1.0 / 3.0}


def settle(run: SolverRun, duration: float, longest: float, measure: Callable[[Float], float], slack: float) -> float:
    """Run on until `measure` of the positions rests, and return it: two looks that change it by less than `slack`.

    There are LOOKS looks in `duration`. Speeds would not do: an adaptive method keeps those of its
    tolerance. Raises Unsupported where it still moves at the end: the law is of rest.
    """
    steps, dt = choose_step(run, duration / LOOKS, longest, LOOKS)
    changes, before = [math.inf], measure(run.state.x)
    for _ in range(LOOKS):
        run.go(steps, dt)
        now = measure(run.state.x)
        changes.append(abs(now - before))
        before = now
        if max(changes[-2:]) < slack:
            return now
    raise Unsupported(f"not yet at rest after {duration:.2g} s: {changes[-1]:.1g} off {duration / LOOKS:.2g} s ago")


def hung(n: int, k: float, rest: Float | float, last: float = 1.0) -> Fabric:
    """A chain of length 1 m and n masses that weigh 1 kg, the last of them only that share of its own, held above."""
    x, mass = np.zeros((n + 1, 3)), np.full(n + 1, 1.0 / n)
    x[:, 1] = -np.linspace(0.0, 1.0, n + 1)
    mass[-1] *= last
    return make_fabric(x, chain(n + 1, k, rest), mass, np.arange(n + 1) == 0)


@laws("elongation", "closed form")
def measure_elongation(plugin: Any) -> Measurement:
    """A hanging chain of lumped masses, half a mass at its end, stretches by w L^2 / (2 E A) exactly."""
    n, stiffness = 16, 100.0 * G
    # The slowest mode has omega = pi/2 sqrt(E A g / (w L)) = 49 1/s; twice that is its critical damping.
    run = SolverRun(plugin, System(hung(n, stiffness * n, 1.0 / n, 0.5), DOWN, 60.0), ACCURATE)
    expected = G / (2.0 * stiffness)
    measured = settle(run, 2.0, 5e-3, lambda x: float(-1.0 - x[-1, 1]), 1e-5 * expected)
    return relative(measured, expected, 1e-4)


@laws("catenary", "closed form")
def measure_catenary(plugin: Any) -> Measurement:
    """A chain of 40 links, 1.5 spans long, hangs as y = a cosh(x / a): it sags by a (cosh(d / 2a) - 1)."""
    n, span, length, strain = 40, 1.0, 1.5, 1e-4
    a = bisect(0.05 * span, 50.0 * span, lambda a: 2.0 * a * math.sinh(span / (2.0 * a)) <= length, 80)
    tension = G * 1.0 * a / length
    x, s = np.zeros((n + 1, 3)), np.linspace(-0.5, 0.5, n + 1)
    x[:, 0], x[:, 1] = s * span, -0.6 * (1.0 - (2.0 * s) ** 2)
    springs = chain(n + 1, tension / strain * n / length, length / n, 0.02)
    fabric = make_fabric(x, springs, np.full(n + 1, 1.0 / n), np.abs(s) == 0.5)
    run = SolverRun(plugin, System(fabric, DOWN, 8.0), ACCURATE)
    expected = a * (math.cosh(span / (2.0 * a)) - 1.0)
    measured = settle(run, 6.0, 5e-3, lambda x: float(-x[:, 1].min()), 1e-4 * expected)
    return relative(measured, expected, 2e-3)


@laws({f"chain frequency {mode + 1}": {"mode": mode} for mode in range(3)}, "zeros of the Laguerre polynomial L_24")
def measure_frequency(plugin: Any, mode: int) -> Measurement:
    """A hanging chain of n = 24 masses swings with its own omega sqrt(L / g).

    The squares of the frequencies are (n g / L) times the zeros of the Laguerre polynomial L_n, which tend to
    the continuous chain's 1.20241, 2.76004, 4.32686 (zeros of J0, halved). Rest lengths are shortened by
    what each link carries, so that all links are alike.
    """
    n, k = 24, 3e4
    roots = np.polynomial.laguerre.lagroots([0.0] * n + [1.0])
    omega = math.sqrt(float(roots[mode]) * G * n)
    # The mode's shape from the free end: L_0, L_1, ... of the root.
    shape = np.array([np.polynomial.laguerre.lagval(roots[mode], [0.0] * i + [1.0]) for i in range(n, -1, -1)])
    fabric = hung(n, k, (1.0 - G * np.arange(n, 0, -1) / k) / n)
    fabric.position[:, 0] = 1e-5 * shape
    run = SolverRun(plugin, System(fabric, DOWN), ACCURATE)
    steps, dt = choose_step(run, 0.25 * math.pi / omega, 5e-3 / omega)
    angles = [0.0]
    for _ in range(8):
        run.go(steps, dt)
        angles.append(math.atan2(-(run.state.v[:, 0] @ shape) / omega, run.state.x[:, 0] @ shape))
    turned = abs(float(np.unwrap(angles)[-1]))
    scale = math.sqrt(G)  # over sqrt(g / L), L = 1 m
    return relative(turned / (8 * steps * dt) / scale, omega / scale, 2e-3)


def strip(gamma: float, elements: int) -> tuple[System, float]:
    """A clamped strip of square cells and plate rigidity w L^3 / gamma, straight; and its free length [m].

    The first two rows hold the direction of the first step, which is the slope at its middle: the
    free length starts there, so that 64 elements are 65.5 rows from there on. It is damped near-critically for
    its slowest mode: bending, 3.516 sqrt(B / (density L^4)), or swinging.
    """
    density, length, rows = 0.2, 0.2, elements + 2
    step, rigidity = length / (rows - 1.5), density * G * length**3 / gamma
    size, fabric = (step, step * (rows - 1)), stiff(density, rigidity)
    piece = build_model("sheet", {"size": size, "resolution": (2, rows), "plane": "xz", "fabric": fabric})
    cloth = make_fabric(piece.position, piece.springs, piece.mass, np.arange(piece.number) < 4, hinges=piece.hinges)
    bending, swinging = 3.516 * math.sqrt(G / (gamma * length)), 1.2 * math.sqrt(G / length)
    return System(cloth, DOWN, 1.4 * math.hypot(bending, swinging)), length


def stiff(density: float, rigidity: float, **more: float) -> dict[str, float]:
    """Cloth of a mass per area [kg/m^2] and a plate rigidity [N m], hardly stretchable, without damping."""
    alike = {"bend_warp": rigidity, "bend_weft": rigidity, "damping_ratio": 0.0}
    return {"density": density, "warp": 400.0, "weft": 400.0, "shear": 100.0, **alike, **more}


def swatch(**fields: Any) -> Fabric:
    """A specimen of irregular triangles; its fabric is given in SI."""
    return build_model("swatch", fields, seed=1)


@laws("mesh cantilever", "theta'' = -Gamma (1 - s) cos theta")
def measure_mesh_cantilever(plugin: Any) -> Measurement:
    """A heavy strip of irregular triangles, 24 edges long, drops as the elastica does at w L^3 / B = 10, settled."""
    gamma, length, density, edges = 10.0, 0.2, 0.2, 24
    edge, rigidity = length / edges, density * G * length**3 / gamma
    size = length + 3.0 * edge, 2.0 * edge
    cloth = swatch(size=size, hold=3.0 * edge, edge=edge, fabric=stiff(density, rigidity))
    end = cloth.position[:, 0] > length - 1e-9
    damping = 1.4 * math.hypot(3.516 * math.sqrt(G / (gamma * length)), 1.2 * math.sqrt(G / length))
    run, expected = SolverRun(plugin, System(cloth, DOWN, damping), ACCURATE), DROP[10]
    measured = settle(run, 48.0 / damping, 0.02, lambda x: float(-x[end, 1].mean()) / length, 1e-3 * expected)
    return relative(measured, expected, 2e-2)


@laws("crease", "B kappa = HB")
def measure_crease(plugin: Any) -> Measurement:
    """A piece of irregular triangles that was rolled up, and is let go of, keeps the curvature 2HB / 2B."""
    side, edge, most, rigidity, width = 0.01, 1e-3, 100.0, 1e-5, 6e-4
    fabric = stiff(0.2, rigidity, hysteresis_warp=width, hysteresis_weft=width)
    cloth = swatch(size=(side, side), edge=edge, fabric=fabric)
    flat = cloth.position.copy()
    middle = np.argsort(np.abs(flat[:, 0] - 0.5 * side))[: len(flat) // 2]
    cloth.position[:, 0] = np.sin(most * (flat[:, 0] - 0.5 * side)) / most
    cloth.position[:, 1] = (1.0 - np.cos(most * (flat[:, 0] - 0.5 * side))) / most
    # Its slowest mode of bending, critically damped: it opens without swinging.
    slowest = 22.4 * math.sqrt(rigidity / (0.2 * side**4))
    run = SolverRun(plugin, System(cloth, NONE, 2.0 * slowest), ACCURATE)

    def curvature(x: Float) -> float:
        """Return the curvature of the circle that fits the middle half best [1/m]."""
        plane = x[middle][:, :2] - x[middle][:, :2].mean(axis=0)
        sums = np.column_stack([2.0 * plane, np.ones(len(plane))])
        centre = np.linalg.lstsq(sums, np.square(plane).sum(axis=1), rcond=None)[0]
        return float(1.0 / math.sqrt(centre[2] + centre[0] ** 2 + centre[1] ** 2))

    expected = width / (2.0 * rigidity)
    measured = settle(run, 40.0 / slowest, 2e-4, curvature, 2e-3 * expected)
    return relative(measured, expected, 3e-2)


@laws({f"cantilever {gamma}": {"gamma": gamma} for gamma in DROP}, "theta'' = -Gamma (1 - s) cos theta")
def measure_cantilever(plugin: Any, gamma: int) -> Measurement:
    """A heavy strip of 64 elements drops as the elastica does at w L^3 / B = Gamma, over its length, settled."""
    (system, length), expected = strip(gamma, 64), DROP[gamma]
    run = SolverRun(plugin, system, ACCURATE)
    measured = settle(run, 48.0 / system.damping, 0.02, lambda x: float(-x[-2:, 1].mean()) / length, 1e-3 * expected)
    return relative(measured, expected, 1e-2)


@laws({f"lateral buckling {name}": {"poisson": value} for name, value in POISSON.items()}, "zero of Bessel's J -1/6")
def measure_buckling(plugin: Any, poisson: float, layout: str = "irregular") -> Measurement:
    """A narrow strip on its side loses all stiffness against tipping over at w L^3 / B = 12.85 sqrt(2 / (1 + nu)).

    By the forces that the solver reports. The strip is 120 edges long and 2 wide.
    """
    density, rigidity = 0.2, 1e-5
    fabric = {"density": density, "warp": 4e3, "weft": 4e3, "shear": 4e2, "bend_poisson": poisson}
    fabric |= {"bend_warp": rigidity, "bend_weft": rigidity}
    narrow = rigidity * (1.0 - poisson**2)
    found = specimens.tips_over(fabric, narrow, density, 0.2, 120, 2, solver=plugin.name, layout=layout)
    return relative(found, specimens.critical(poisson), 3e-2)


def sunk(plugin: Any, size: float, weight: float) -> float:
    """Mean depth of a draped disc's ring over its radius a, with w a^3 / B = 300 and C = 1500 w a.

    It starts in four folds; a and the mass per area are so many times 15 cm and 0.2 kg/m^2.
    """
    radius, density = 0.15 * size, 0.2 * weight
    fabric = dict.fromkeys(("warp", "weft"), 1500.0 * density * G * radius)
    fabric |= dict.fromkeys(("bend_warp", "bend_weft"), density * G * radius**3 / 300.0)
    fabric |= {"density": density, "shear": 0.1 * fabric["warp"], "damping_ratio": 0.0}
    cloth = swatch(radius=radius, hold=0.6 * radius, edge=0.2 * radius, fabric=fabric)
    free, x = ~cloth.pinned, cloth.position
    out = (np.hypot(x[:, 0], x[:, 2]) / radius - 0.6) / 0.4
    x[free, 1] = (0.06 * radius * out * np.cos(4.0 * np.arctan2(x[:, 2], x[:, 0])))[free]
    swing = math.sqrt(G / radius)
    run = SolverRun(plugin, System(cloth, DOWN, 2.0 * swing), ACCURATE)
    return settle(run, 60.0 / swing, 0.1 / swing, lambda x: float(-x[free, 1].mean()) / radius, 1e-5)


@laws("drape", "dimensions")
def measure_drape(plugin: Any) -> Measurement:
    """A disc of twice the size and three times the weight with the same w a^3 / B drapes alike, from a start alike."""
    return relative(sunk(plugin, 2.0, 3.0), sunk(plugin, 1.0, 1.0), 1e-3)
