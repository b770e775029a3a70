"""Laws of contact: cloth that lies on bodies, winds round them, and meets cloth, which never passes through."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from nuno.collision.crossings import find_crossings, mesh_of
from nuno.plugin_contract import registry
from nuno_bench import piles
from nuno_bench.piles import G
from nuno_bench.validation.law import (
    ACCURATE,
    EXACT,
    NONE,
    Laws,
    Measurement,
    SolverRun,
    Unsupported,
    chain,
    choose_step,
    make_fabric,
    relative,
)
from nuno_bench.validation.oscillator import KEEPS_ANGULAR_MOMENTUM
from nuno_schemas.bodies import CAPSULE, PLANE, Geometry, Poses
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.system import System, Term

laws = Laws()
ROUNDING = 1e-12
LONGEST = 2e-4
"""A contact lasts some ten steps of this at least [s]."""
LOOKS = 30
"""Number of checks during a collision."""


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
def measure_depth(plugin: Any) -> Measurement:
    """A particle at rest, let go at the surface, sinks m g / k."""
    k = 1000.0
    system = on_plane(0.0, 0.0, k, 0.0)
    run = SolverRun(plugin, System(system.fabric, system.gravity, 60.0, system.terms), ACCURATE)
    steps, dt = choose_step(run, 0.5, 2e-3)
    run.go(steps, dt, STILL)
    return relative(-float(run.state.x[0, 1]), 0.01 * G / k, 1e-4)


@laws({"incline, sticks": {"share": 0.9}, "incline, slides": {"share": 1.2}}, "Coulomb's law")
def measure_incline(plugin: Any, share: float) -> Measurement:
    """A particle stays where tan alpha < mu, and else slides by g (sin alpha - mu cos alpha) t^2 / 2.

    A particle that sticks gives way once by what its friction spring takes up, mu m g / k; a sliding
    one is held back by no more.
    """
    mu, k = 0.4, 1e5
    alpha = math.atan(share * mu)
    run = SolverRun(plugin, on_plane(alpha, mu, k, 0.01 * G * math.cos(alpha) / k), ACCURATE)
    steps, dt = choose_step(run, 0.5, 1e-3)
    run.go(steps, dt, STILL)
    half, speed = float(run.state.x[0, 0]), float(run.state.v[0, 0])
    run.go(steps, dt, STILL)
    path = float(run.state.x[0, 0])
    if share < 1.0:
        # Between the halves: the first holds the one time that it gives way.
        return Measurement(path - half, 0.0, abs(path - half) / (0.5 * G * math.sin(alpha)), 1e-6)
    pull = G * (math.sin(alpha) - mu * math.cos(alpha))
    gained = (float(run.state.v[0, 0]) - speed) / 0.5
    return Measurement(path, 0.5 * pull, max(abs(path / (0.5 * pull) - 1.0), abs(gained / pull - 1.0)), 1e-2)


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
def measure_belt(plugin: Any) -> Measurement:
    """T2 / T1 = e^(mu phi) on a cylinder that turns under a belt which slips everywhere.

    The angle phi is that between the belt's first and last link; the tensions are theirs, averaged
    over the last half of the frames.
    """
    mu, rate, frame, frames = 0.3, 1.0, 0.02, 60
    run = SolverRun(plugin, belt(mu, 0.75 * math.pi), ACCURATE)
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


def meshes(name: str, **given: Any) -> dict[str, Mapping[str, Any]]:
    """A case of cloth, a grid, and the same of a mesh of irregular triangles."""
    return {f"cloth {name}": {"irregular": False, **given}, f"mesh {name}": {"irregular": True, **given}}


def free(system: System) -> Any:
    """(n,) bool"""
    return ~system.fabric.pinned


@laws(meshes("sticks", share=0.99) | meshes("slides", share=1.01), "Coulomb's law")
def measure_cloth_incline(plugin: Any, share: float, irregular: bool) -> Measurement:
    """A sheet on a sheet comes to rest where tan alpha < mu, and else gains speed: 1 % of tan alpha off either way.

    It lands from a hundredth of the thickness, slides a millimetre as it bounces, and stops within 0.4 s; from then on
    hardly a hundred-millionth is left of the way that it would slide.
    """
    mu = 0.5
    slope = math.atan(share * mu)
    run = SolverRun(plugin, piles.pile(*piles.incline(irregular), gravity=piles.tilted(slope), friction=mu), ACCURATE)
    steps, dt = choose_step(run, 0.4, LONGEST, 2)
    run.go(steps, dt)
    start, before = pace(run)
    steps, dt = choose_step(run, 0.2, LONGEST, 2)
    run.go(steps, dt)
    end, after = pace(run)
    pull = G * (math.sin(slope) - mu * math.cos(slope))
    if share < 1.0:
        # What does not stick sooner or later moves by a good part of g sin alpha t^2 / 2.
        return Measurement(end - start, 0.0, abs(end - start) / (0.5 * G * math.sin(slope) * 0.2**2), 1e-6)
    gained = (after - before) / 0.2
    return relative(gained, pull, 0.1)


@laws(meshes("slide rate"), "Coulomb's law")
def measure_slide(plugin: Any, irregular: bool) -> Measurement:
    """A sheet slides on a sheet with g (sin alpha - mu cos alpha), from triangle to triangle."""
    mu, slope = 0.2, math.radians(30.0)
    run = SolverRun(plugin, piles.pile(*piles.incline(irregular), gravity=piles.tilted(slope), friction=mu), ACCURATE)
    steps, dt = choose_step(run, 0.06, LONGEST)
    run.go(steps, dt)
    before = pace(run)[1]
    steps, dt = choose_step(run, 0.14, LONGEST)
    run.go(steps, dt)
    gained = (pace(run)[1] - before) / 0.14
    return relative(gained, G * (math.sin(slope) - mu * math.cos(slope)), 5e-3)


def pace(run: SolverRun) -> tuple[float, float]:
    """Mean place [m] and velocity [m/s] along x of the free vertices."""
    state, own = run.state, free(run.system)
    return float(state.x[own, 0].mean()), float(state.v[own, 0].mean())


@laws(meshes("pile"), "Newton's third law")
def measure_pile(plugin: Any, irregular: bool) -> Measurement:
    """Four sheets at rest on a held one press on it with 4 m g."""
    system = piles.pile(*piles.stack(irregular), damping=1.0)
    run = SolverRun(plugin, system, ACCURATE)
    steps, dt = choose_step(run, 0.02, LONGEST, 8)
    for _ in range(8):
        run.go(steps, dt)
        run.state.v *= 0.5
    found = plugin.forces(system, run.state, run.memory, None).parts["cloth_contact"]
    weight = G * float(system.fabric.mass[free(system)].sum())
    return relative(-float(found[system.fabric.pinned, 1].sum()), weight, 1e-2)


@laws(meshes("momentum"), "Newton's third law")
def measure_momentum(plugin: Any, irregular: bool) -> Measurement:
    """Two sheets that collide keep their momentum to rounding, and its moment by solvers of kicks and drifts.

    As a share of the sum of their parts'.
    """
    run = SolverRun(plugin, piles.pile(*piles.collision(irregular), gravity=NONE, friction=0.0))
    mass = run.system.fabric.mass[:, None]

    def parts() -> Float:
        x, v = run.state.x, run.state.v
        return np.stack([mass * v, mass * np.cross(x, v)])

    before, kinds = parts(), 2 if plugin.name in KEEPS_ANGULAR_MOMENTUM else 1
    touched = collide(run, 20, 5e-5)
    change = np.abs((parts() - before).sum(axis=1)).max(axis=1) / np.abs(before).sum(axis=(1, 2))
    largest = float(change[:kinds].max())
    return Measurement(largest, 0.0, largest if touched else math.nan, ROUNDING)


@laws(meshes("bounce"), "no work without force")
def measure_energy(plugin: Any, irregular: bool) -> Measurement:
    """Two sheets that bounce off each other without damping have no more energy afterwards, as a share of it."""
    run = SolverRun(plugin, piles.pile(*piles.collision(irregular), gravity=NONE, friction=0.0, damping=0.0), ACCURATE)
    before = run.energy()
    touched = collide(run, *choose_step(run, 1e-3, 5e-5, LOOKS))
    after = run.energy()
    return Measurement(after, before, max(0.0, after / before - 1.0) if touched else math.nan, 1e-3)


def collide(run: SolverRun, steps: int, dt: float) -> bool:
    """Let two sheets meet and part, looking at them every so many steps; whether they have."""
    most, now = 0, 0
    for _ in range(LOOKS):
        now = int(run.go(steps, dt).counts["cloth_contacts"])
        most = max(most, now)
    return most > 0 and now == 0


@laws(meshes("apart"), "what never meets feels nothing")
def measure_apart(plugin: Any, irregular: bool) -> Measurement:
    """Two sheets that swing far from each other end in the bits that they have without cloth contact."""
    if getattr(plugin, "adaptive", False):
        raise Unsupported("an adaptive method begins each step from new slopes where anything may hold vertices")
    # Kicks as often without contact as with it, of a method that chooses how often by what forces there are.
    settings = {**EXACT, "every": 2}
    both = [SolverRun(plugin, piles.pile(*piles.swinging(irregular), contact=on), settings) for on in (True, False)]
    for run in both:
        run.go(300, 5e-5)
        run.go(300, 5e-5)
    one, other = (run.both() for run in both)
    return Measurement(
        float(np.abs(one - other).max()), 0.0, float((one.view(np.int64) != other.view(np.int64)).sum()), 0.0
    )


@laws(meshes("heap"), "no edge goes through a triangle")
def measure_heap(plugin: Any, irregular: bool) -> Measurement:
    """Of three sheets that fly at each other at up to 16 m/s none passes through another, which without contact do.

    Counted are the looks at which one does, at steps that take it farther than its thickness.
    """
    looks = [heap_looks(plugin, piles.heap(1, irregular), contact) for contact in (True, False)]
    held, let = looks
    return Measurement(float(held), 0.0, float(held) if let > 0 else math.nan, 0.0)


def heap_looks(plugin: Any, pieces: list[Fabric], contact: bool) -> int:
    """At how many of LOOKS a piece of the heap passes through another."""
    system, crossed = piles.pile(*pieces, contact=contact), 0
    run, mesh = SolverRun(plugin, system, ACCURATE), mesh_of(system.fabric.faces)
    steps, dt = choose_step(run, 2e-3, LONGEST, LOOKS)
    for _ in range(LOOKS):
        run.go(steps, dt)
        crossed += len(find_crossings(run.state.x, mesh).edges) > 0
    return crossed


STILL = _turned(0.0, 0.0), _turned(1.0, 0.0)
