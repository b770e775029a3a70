"""Laws of contact: depth at rest, Coulomb friction on an incline and of a belt on a turning cylinder."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nuno import registry
from nuno_bench.validation.laws.base import (
    ACCURATE,
    NONE,
    Found,
    G,
    Laws,
    Run,
    chain,
    choose_step,
    make_fabric,
    relative,
)
from nuno_schemas.bodies import CAPSULE, PLANE, Geometry, Poses
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.system import System, Term

laws = Laws()


def body(kind: int, a: Float, b: Float, radius: float, stiffness: float, friction: float) -> Geometry:
    """One primitive of contact stiffness [N/m], a third of critical damping."""
    return Geometry(
        ("body",), ("body/frame",), np.array([kind], np.int8), np.zeros(1, np.int32), np.zeros(1, np.int32),
        np.array([a], float), np.array([b], float), np.array([radius]),
        np.array([stiffness]), np.array([0.3]), np.array([friction]),
    )  # fmt: skip


def contact(fabric: Fabric, geometry: Geometry, gravity: Float) -> Term:
    """The penalty contact."""
    plugin = registry.load("nuno.contacts", "penalty")
    term: Term = plugin.prepare(plugin.Config(), fabric, geometry, gravity)
    return term


def on_plane(alpha: float, mu: float, k: float, depth: float) -> System:
    """A particle of 10 g on a plane through the origin, gravity tilted by alpha towards +x."""
    gravity = G * np.array([math.sin(alpha), -math.cos(alpha), 0.0])
    fabric = make_fabric(np.array([[0.0, -depth, 0.0]]), mass=0.01)
    plane = body(PLANE, np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.0, k, mu)
    return System(fabric, gravity, 0.0, (contact(fabric, plane, gravity),))


@laws("penalty depth", "penalty contact")
def measure_depth(plugin: Any) -> Found:
    """A particle at rest, let go at the surface, sinks m g / k."""
    k = 1000.0
    system = on_plane(0.0, 0.0, k, 0.0)
    run = Run(plugin, System(system.fabric, system.gravity, 60.0, system.terms), ACCURATE)
    steps, dt = choose_step(run, 0.5, 2e-3)
    run.go(steps, dt, STILL)
    return relative(-float(run.state.x[0, 1]), 0.01 * G / k, 1e-4)


@laws({"incline, sticks": {"share": 0.9}, "incline, slides": {"share": 1.2}}, "Coulomb's law")
def measure_incline(plugin: Any, share: float) -> Found:
    """A particle stays where tan alpha < mu, and else slides by g (sin alpha - mu cos alpha) t^2 / 2.

    A particle that sticks gives way once by what its friction spring takes up, mu m g / k; a sliding
    one is held back by no more.
    """
    mu, k = 0.4, 1e5
    alpha = math.atan(share * mu)
    run = Run(plugin, on_plane(alpha, mu, k, 0.01 * G * math.cos(alpha) / k), ACCURATE)
    steps, dt = choose_step(run, 0.5, 1e-3)
    run.go(steps, dt, STILL)
    half, speed = float(run.state.x[0, 0]), float(run.state.v[0, 0])
    run.go(steps, dt, STILL)
    path = float(run.state.x[0, 0])
    if share < 1.0:
        # Between the halves: the first holds the one time that it gives way.
        return Found(path - half, 0.0, abs(path - half) / (0.5 * G * math.sin(alpha)), 1e-6)
    pull = G * (math.sin(alpha) - mu * math.cos(alpha))
    gained = (float(run.state.v[0, 0]) - speed) / 0.5
    return Found(path, 0.5 * pull, max(abs(path / (0.5 * pull) - 1.0), abs(gained / pull - 1.0)), 1e-2)


def belt(mu: float, wrap: float) -> System:
    """A belt stretched by 2 % over a cylinder, straight beyond it, both ends held."""
    radius, spacing, k, straight = 0.1, 0.005, 4000.0, 8
    around = int(wrap * radius / spacing)
    arc = np.arange(-straight, around + straight + 1) * spacing - 0.5 * (around * spacing - wrap * radius)
    angle = np.clip(arc / radius, 0.0, wrap)
    x = radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    before, after = np.where(arc < 0.0, arc, 0.0), np.where(arc > wrap * radius, arc - wrap * radius, 0.0)
    x += before[:, None] * [0.0, 1.0, 0.0] + after[:, None] * [-math.sin(wrap), math.cos(wrap), 0.0]
    n = len(x)
    ends = (np.arange(n) == 0) | (np.arange(n) == n - 1)
    fabric = make_fabric(x, chain(n, k, spacing / 1.02, 0.3), 2e-4, ends)
    cylinder = body(CAPSULE, np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0]), radius, 4000.0, mu)
    return System(fabric, NONE, 40.0, (contact(fabric, cylinder, NONE),))


@laws("belt", "Euler and Eytelwein")
def measure_belt(plugin: Any) -> Found:
    """T2 / T1 = e^(mu phi) on a cylinder that turns under a belt which slips everywhere.

    The angle phi is that between the belt's first and last link; the tensions are theirs, averaged
    over the last half of the frames.
    """
    mu, rate, frame, frames = 0.3, 1.0, 0.02, 60
    run = Run(plugin, belt(mu, 0.75 * math.pi), ACCURATE)
    steps, dt = choose_step(run, frame, 1e-3, frames)
    ratios, turned = [], 0.0
    for number in range(frames):
        run.go(steps, dt, (_turned(frame * number, rate), _turned(frame * (number + 1), rate)))
        first, last = run.state.x[1] - run.state.x[0], run.state.x[-1] - run.state.x[-2]
        lengths = np.linalg.norm(first), np.linalg.norm(last)
        turned = math.acos(float(first @ last / lengths[0] / lengths[1]))
        rest = 0.005 / 1.02
        ratios.append(float((lengths[0] - rest) / (lengths[1] - rest)))
    return relative(float(np.mean(ratios[frames // 2 :])), math.exp(mu * turned), 1e-2)


def _turned(t: float, rate: float) -> Poses:
    """The cylinder's pose at time t [s], turning about z at `rate` [rad/s]."""
    angle = rate * t
    return Poses(t, np.array([[math.cos(0.5 * angle), 0.0, 0.0, math.sin(0.5 * angle)]]), np.zeros((1, 3)))


STILL = _turned(0.0, 0.0), _turned(1.0, 0.0)
