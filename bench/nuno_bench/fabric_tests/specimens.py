"""Specimens of a fabric in the scenes of instruments: KES, a strip that tips over, Cusick's drapemeter."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from nuno.scene import scene_file, shipped
from nuno.simulation import cloth
from nuno_bench.piles import G
from nuno_bench.problem import Problem, make_problem
from nuno_cloth.fabrics import shadow as shadows
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Fabric, Float, Int, Memory, State
from nuno_schemas.system import System
from nuno_schemas.vectors import face_areas

FRAMES = 400
"""Frames until then."""
ELASTIC = ("springs", "hinges", "membrane", "bending", "bending_friction")
"""Kinds of force that are the fabric's own."""


@dataclass
class Rig:
    """A specimen, its solver, its state and what the solver remembers."""

    problem: Problem
    system: System
    state: State
    memory: Memory

    @property
    def fabric(self) -> Fabric:
        return self.system.fabric

    @property
    def plugin(self) -> Any:
        return self.problem.loaded.integrator.plugin

    @cached_property
    def steps(self) -> int:
        """Steps a frame, as the scene says."""
        config = self.problem.loaded.integrator.config
        return self.problem.own_steps(self.plugin.limit(config, self.system, self.state))

    def load(self, gravity: float) -> None:
        """Weigh it under so much gravity [m/s^2], from its start."""
        self.system = replace(self.system, gravity=np.array([0.0, -gravity, 0.0]))
        self.state = cloth.start_state(self.fabric)
        self.memory = self.plugin.prepare(self.problem.loaded.integrator.config, self.system, self.state)

    def rest(self, still: float, frames: int = FRAMES) -> Float:
        """(n, 3) where it comes to rest [m]: no vertex goes further in a frame than this share of the way that one has
        gone by then, twice. Raises RunFailed where it does not within so many frames, or the solver fails.
        """
        start, quiet = self.state.x.copy(), 0
        for _ in range(frames):
            before = self.state.x.copy()
            self._go()
            gone = np.abs(self.state.x - start).max()
            quiet = quiet + 1 if np.abs(self.state.x - before).max() < still * gone else 0
            if quiet == 2:
                return self.state.x
        raise RunFailed(f"{self.problem.loaded.scene.name}: not at rest after {frames * self.problem.frame:g} s")

    def run(self, frames: int) -> Float:
        """(n, 3) where it is after so many frames [m]. Raises RunFailed where the solver fails."""
        for _ in range(frames):
            self._go()
        return self.state.x

    def _go(self) -> None:
        """Advance by one frame."""
        report = self._advance(self.steps, self.problem.frame / self.steps)
        if report.status != "ok":
            raise RunFailed(f"{self.problem.loaded.scene.name}: {report.status}: {report.message}")

    def energy(self) -> float:
        """Energy [J] of the present state at rest: gravitational, 0 at height 0, and all that is elastic."""
        energy = self._advance(0, 1.0).energy
        return float(sum(energy.values()) - energy["kinetic"])

    def put(self, x: Float) -> Float:
        """(n, 3) the fabric's own forces [N] where all vertices are put, after what slips has followed."""
        self.state.x[...], self.state.v[...] = x, 0.0
        found = self.forces()
        self._advance(1, 1e-12)
        return found

    def forces(self) -> Float:
        """(n, 3) the fabric's own forces [N] in the present state."""
        parts = self.plugin.forces(self.system, self.state, self.memory, None).parts
        return np.asarray(sum((parts[kind] for kind in ELASTIC if kind in parts), np.zeros_like(self.state.x)))

    def _advance(self, steps: int, dt: float) -> Any:
        with np.errstate(all="ignore"):
            return self.plugin.advance(self.system, self.state, self.memory, None, steps, dt)


def mount(scene: str, fabric: object, solver: str | None = None, **model: object) -> Rig:
    """A specimen of a fabric, as a scene names or describes it, in the scene of an instrument, with a solver of this
    name or its own; `model` are fields of its model that are otherwise than there. Raises BadInput.
    """
    fields = {"fabric": fabric, **model}
    overrides = [f"objects.0.model.{name}={json.dumps(value)}" for name, value in fields.items()]
    overrides += ["until=duration"] if solver is None else ["until=duration", f"solver={{plugin: {solver}}}"]
    loaded = scene_file.read(shipped.find(f"instruments/{scene}"), overrides)
    problem = make_problem(loaded, threads=1)
    rig = Rig(problem, problem.system, cloth.start_state(problem.fabric), Memory())
    rig.load(G)
    return rig


# KES: tension, shear and bending of a specimen that is strained and bent the same everywhere, there and back.

STRAIN = 1e-4
"""Strain, and angle of shear [rad]: small, for presets are what cloth has at first."""
MOST, STEPS = 250.0, 200
"""KES bends to so much [1/m], here in so many steps from level."""
LOW, HIGH, AT = 50.0, 150.0, 100.0
"""B is the slope between these curvatures [1/m], 2HB the width of the loop here, as KES reads them."""
SIDE, EDGE = 5e-3, 2.5e-4
"""Side of the bent specimen, and length of its edges [m]."""


@dataclass(frozen=True)
class Loop:
    """curvature (c,) [1/m] and moment (c,) per width [N] on the way; B [N m], 2HB [N], the curvature [1/m] that is left
    without moment after the greatest, and the work [J/m^2] that a cycle takes.
    """

    curvature: Float
    moment: Float
    rigidity: float
    hysteresis: float
    left: float
    work: float

    @property
    def recovery(self) -> float:
        """Angle [deg] by which a fold of 180 degrees, bent to MOST all round, opens when it is let go of (ISO 2313)."""
        return 180.0 * (1.0 - self.left / MOST)


def stretch(fabric: object, angle: float, **model: Any) -> float:
    """Stiffness [N/m] along a strip whose warp makes an angle [rad] with it, its width held."""
    return _stiffness(np.array([[1.0, 0.0], [0.0, 0.0]]), fabric, angle, **model)


def shear(fabric: object, angle: float, **model: Any) -> float:
    """Stiffness against shear [N/m]."""
    return _stiffness(np.array([[0.0, 1.0], [0.0, 0.0]]), fabric, angle, **model)


def _stiffness(gradient: Float, fabric: object, angle: float, **model: Any) -> float:
    """Work per area and squared strain, twice, of a displacement with this gradient in the strip's plane."""
    rig = mount("cantilever", fabric, size=[0.05, 0.05], hold=None, edge=5e-3, angle=angle, **model)
    x, area = rig.fabric.position, float(rig.fabric.mass.sum()) / density(rig)
    way = np.zeros_like(x)
    way[:, [0, 2]] = x[:, [0, 2]] @ gradient.T
    pulls = [-(rig.put(x + sign * STRAIN * way) * way).sum() for sign in (1.0, -1.0)]
    return float((pulls[0] - pulls[1]) / (2.0 * STRAIN * area))


def density(rig: Rig) -> float:
    """Mass per area [kg/m^2]."""
    return float(rig.fabric.mass.sum() / face_areas(rig.fabric.position[rig.fabric.faces]).sum())


def bend(fabric: object, angle: float, **model: Any) -> Loop:
    """A strip rolled up to MOST, to -MOST and back again: what its forces do on the way is the moment's work."""
    rig = mount("cantilever", fabric, size=[SIDE, SIDE], hold=None, edge=EDGE, angle=angle, **model)
    area = float(rig.fabric.mass.sum()) / density(rig)
    there = np.linspace(0.0, MOST, STEPS + 1)
    path = np.concatenate([there, there[-2::-1], -there[1:], -there[-2::-1], there[1:]])
    moments = []
    for before, after in itertools.pairwise(path):
        way = roll(rig.fabric.position, after) - roll(rig.fabric.position, before)
        force = rig.put(roll(rig.fabric.position, 0.5 * (before + after)))
        moments.append(-(force * way).sum() / (after - before) / area)
    curvature, moment = 0.5 * (path[1:] + path[:-1]), np.array(moments)
    # Of the closed loop, from the first return to level on: down to -MOST, and up to MOST.
    down, up = np.arange(STEPS, 3 * STEPS), np.arange(3 * STEPS, 5 * STEPS)
    slopes = []
    for part, sign in itertools.product((down, up), (1.0, -1.0)):
        some = part[(sign * curvature[part] > LOW) & (sign * curvature[part] < HIGH)]
        slopes.append(np.polyfit(curvature[some], moment[some], 1)[0])
    width = _at(curvature[up], moment[up], AT) - _at(curvature[down], moment[down], AT)
    left = float(np.interp(0.0, moment[down][::-1], curvature[down][::-1]))
    work = float((moment[down].sum() * -1.0 + moment[up].sum()) * MOST / STEPS)
    return Loop(curvature, moment, float(np.mean(slopes)), width, left, work)


def roll(flat: Float, curvature: float) -> Float:
    """(n, 3) a flat piece on a cylinder, its length round it."""
    x = flat.copy()
    if curvature != 0.0:
        x[:, 0] = np.sin(curvature * flat[:, 0]) / curvature
        x[:, 1] = flat[:, 1] + (1.0 - np.cos(curvature * flat[:, 0])) / curvature
    return x


def _at(curvature: Float, moment: Float, where: float) -> float:
    order = np.argsort(curvature)
    return float(np.interp(where, curvature[order], moment[order]))


# A strip clamped at one end, on its side: the weight under which it tips over.

FIRST_ZERO = 12.8538
"""Six times the first zero of Bessel's function J of order -1/6."""
LOAD = 0.03
"""Share of the critical weight under which the strip is looked at."""
HELD = 4
TIMES, BALANCED = 60, 1e-4
"""Newton's method finds the strip at rest in its plane, to this share of the load."""


def critical(poisson: float) -> float:
    """w L^3 / B at which a narrow strip tips over."""
    return FIRST_ZERO * math.sqrt(2.0 / (1.0 + poisson))


def tips_over(fabric: object, rigidity: float, density: float, length: float, edges: int, wide: int,
              solver: str | None = None, **model: Any) -> float:  # fmt: skip
    """w L^3 / B at which a strip of `length` [m] and `wide` of its edges across, of rigidity B [N m] and density
    [kg/m^2], has no stiffness left against tipping over.

    Sideways stiffness is linear in the stress, and so in the weight: it is found without, and where the strip rests in
    its own plane under a small part of it, which bends it there by next to nothing.
    """
    edge = length / edges
    size, hold = [length + HELD * edge, wide * edge], HELD * edge
    rig = mount("buckling", fabric, size=size, hold=hold, edge=edge, solver=solver, **model)
    weight = density * length**3 / rigidity
    gravity = LOAD * critical(0.0) / weight
    start, free = rig.fabric.position.copy(), np.flatnonzero(~rig.fabric.pinned)
    start[:, 2] = 0.0
    rig.state.x[...] = start
    bare, inside = stiffness(rig, free, (2,)), stiffness(rig, free, (0, 1))
    load = np.zeros((len(free), 2))
    load[:, 1] = -gravity * rig.fabric.mass[free]
    for _ in range(TIMES):
        left = load + rig.forces()[free, :2]
        if np.abs(left).max() < BALANCED * np.abs(load).max():
            break
        rig.state.x[free, :2] += np.linalg.solve(inside, left.reshape(-1)).reshape(-1, 2)
    else:
        raise RunFailed("buckling: the strip finds no rest in its plane")
    stressed = (stiffness(rig, free, (2,)) - bare) / gravity
    most = scipy.linalg.eigh(-stressed, bare, eigvals_only=True)[-1]
    return float(weight / most)


def stiffness(rig: Rig, free: Any, axes: tuple[int, ...]) -> Float:
    """(f a, f a) stiffness [N/m] of the free vertices (f,) along some axes, in the present state.

    By central differences of two widths: what is moved across stiff cloth stretches it with the square of the way.
    """
    step, x, size = 1e-6 * rig.problem.size, rig.state.x, len(axes)
    found = np.empty((size * len(free), size * len(free)))
    for column, (vertex, axis) in enumerate((v, a) for v in free for a in axes):
        kept, pushed = x[vertex, axis], []
        for way in (-2.0, -1.0, 1.0, 2.0):
            x[vertex, axis] = kept + way * step
            pushed.append(rig.forces()[free][:, axes].reshape(-1))
        x[vertex, axis] = kept
        found[:, column] = (pushed[3] - pushed[0] - 8.0 * (pushed[2] - pushed[1])) / (12.0 * step)
    return np.asarray(0.5 * (found + found.T))


# Cusick's drapemeter: a disc over a smaller one, its shadow, its folds and the drape coefficient.

RADIUS, SUPPORT = 0.15, 0.09
"""Of specimen and support, unless others were measured [m]."""
DOT = 2.5e-4
"""Side of the shadow's dots [m]."""
ROUGH, WAVE = 2e-4, 1e-2
"""Standard deviation of the heights at the start, and height of the folds at the rim where it begins in folds [m]."""


@dataclass(frozen=True)
class Drape:
    """coefficient: the share of the overhanging ring that the shadow covers; nodes: its folds; energy [J] where it
    rests, gravitational and elastic, about 0 of a flat disc; shadow: (side, side) dots that are dark, the middle of the
    disc in their middle; x (n, 3) where it rests [m].
    """

    coefficient: float
    nodes: int
    energy: float
    shadow: NDArray[np.bool_]
    x: Float


def drape(
    fabric: object,
    edge: float,
    seed: int,
    folds: int = 0,
    radius: float = RADIUS,
    support: float = SUPPORT,
    **model: Any,
) -> Drape:
    """A disc of triangles with edges of this length [m], hung from a start that is rough by a seed of its own; radii of
    the disc and of what it lies on [m].

    With `folds` the free ring starts in so many waves round it, too, whose crests are where the seed says: the disc
    then finds the drape with as many folds, if there is one, of the several that cloth has. Raises BadInput for what is
    no fabric, RunFailed where the solver fails.
    """
    rig = mount("drapemeter", fabric, edge=edge, radius=radius, hold=support, **model)
    free, random = ~rig.fabric.pinned, np.random.default_rng(seed)
    rig.state.x[free, 1] += ROUGH * random.standard_normal(int(free.sum()))
    if folds:
        east, _, north = rig.fabric.position[free].T
        out = (np.hypot(east, north) - support) / (radius - support)
        waves = np.cos(folds * np.arctan2(north, east) + random.uniform(0.0, 2.0 * np.pi))
        rig.state.x[free, 1] += WAVE * out * waves
    x = rig.run(rig.problem.frames).copy()
    coefficient, shadow = measure(rig.fabric.position, x, rig.fabric.faces, radius, support)
    return Drape(coefficient, count_nodes(shadow), rig.energy(), shadow, x)


def measure(
    flat: Float, x: Float, faces: Int, radius: float = RADIUS, support: float = SUPPORT
) -> tuple[float, NDArray[np.bool_]]:
    """The drape coefficient and the shadow of a disc that lay at `flat` (n, 3) and hangs at x (n, 3) [m]."""
    whole, shadow = (cast_shadow(each, faces, radius) for each in (flat, x))
    held = np.pi * support**2
    dark, most = (float(each.sum()) * DOT**2 for each in (shadow, whole))
    return (dark - held) / (most - held), shadow


def cast_shadow(x: Float, faces: Int, radius: float = RADIUS) -> NDArray[np.bool_]:
    """(side, side) what triangles at x (n, 3) [m] within a radius cover as seen from above."""
    from PIL import Image, ImageDraw

    side = round(2.2 * radius / DOT)
    image = Image.new("1", (side, side))
    drawn, places = ImageDraw.Draw(image), x[:, [0, 2]] / DOT + 0.5 * side
    for face in faces:
        drawn.polygon([(float(a), float(b)) for a, b in places[face]], fill=1)
    return np.asarray(image)


def count_nodes(shadow: NDArray[np.bool_]) -> int:
    """Return the number of folds in a shadow's outline."""
    return shadows.count_nodes(shadow, DOT, (0.5 * len(shadow), 0.5 * len(shadow)))
