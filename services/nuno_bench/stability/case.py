"""One point of a stability map: a scene at one stiffness or mesh, one solver, one step, and its class."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from nuno import registry
from nuno.cloth import build
from nuno.collision.bodies import build_bodies
from nuno_bench.sweep.packed import Packed, unpacked
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.system import System

CLASSES = ("exact", "accurate", "damped away", "drifting", "diverged", "refused", "left out")
EXACT, ACCURATE = 1e-3, 5e-2
"""Largest distance from the reference, as a share of how far the reference moves."""
HIDDEN = 1.0
"""Energy, as a multiple of the motion's, that may be off while positions are right: symplectic methods' wavers by
omega dt of what their stiffest modes hold."""
LOST = 5e-2
"""Share of the motion's energy that must be missing for it to count as damped away."""
RUNAWAY = 100.0
"""Energy gained, or distance, as a multiple of the motion's, from which on a run counts as diverged."""
ROUGHNESS = 1e-6
"""Vertices start this part of the shortest spring off their places, so that every mode takes part;
little enough for stiff ones to carry no energy that counts."""
TIGHT = 1e-8
"""Tolerance of the reference."""
LONGEST = 0.1
"""Most simulated time of a point [s]: a few frames, in which an unstable mode grows beyond all bounds."""


@dataclass(frozen=True)
class Setting:
    """What a row of points shares: a scene at a stiffness factor or a mesh of some size."""

    scene: Packed
    overrides: tuple[str, ...]
    axis: str
    value: float


@dataclass
class Posed:
    """A setting, built: poses are those of all frames, or None where nothing is met."""

    system: System
    start: State
    poses: list[Poses | None]
    frame: float
    edge: float
    group: ClassVar[str] = "nuno.integrators"

    def limit(self, plugin: Any, config: Any) -> float:
        """The solver's own limit [s], once it is compiled. Raises BadInput where it refuses the scene."""
        with np.errstate(all="ignore"):
            limit = float(plugin.limit(config, self.system, self.start).dt)
            state = self.start.copy()
            memory = plugin.prepare(config, self.system, state)
            plugin.advance(self.system, state, memory, self.pair(0), 0, self.frame)
        return limit

    def run(self, plugin: Any, config: Any, steps: int, most: float = math.inf) -> tuple[Motion | None, str, str]:
        """The path with so many steps a frame; or None with how it ended (diverged, refused, left out) and why."""
        system, state = self.system, self.start.copy()
        with np.errstate(all="ignore"):
            memory = plugin.prepare(config, system, state)
            # An interval without steps compiles what the others need, and measures the start.
            first = plugin.advance(system, state, memory, self.pair(0), 0, self.frame)
            x, energy, begin = [state.x.copy()], [first.energy], time.perf_counter()
            for frame in range(len(self.poses) - 1):
                state.t = frame * self.frame
                report = plugin.advance(system, state, memory, self.pair(frame), steps, self.frame / steps)
                if report.status != "ok":
                    return None, "diverged" if report.status == "diverged" else "refused", report.message
                x.append(state.x.copy())
                energy.append(report.energy)
                if time.perf_counter() - begin > most:
                    return None, "left out", f"takes more than {most:.2g} s"
        kinetic = np.array([e.get("kinetic", 0.0) for e in energy])
        return Motion(np.array(x), kinetic, np.array([sum(e.values()) for e in energy])), "", ""

    def pair(self, frame: int) -> tuple[Poses, Poses] | None:
        before, after = self.poses[frame], self.poses[frame + 1]
        return (before, after) if before is not None and after is not None else None


@dataclass(frozen=True)
class Motion:
    """What a run did: x (frames + 1, n, 3), energies of the motion and in all (frames + 1,) [J].

    Of dye x are amounts (frames + 1, dyes * cells, 2), and both energies are all dye.
    """

    x: Float
    kinetic: Float
    total: Float


@dataclass(frozen=True)
class Point:
    """A point's class, and the figures behind it."""

    axis: str
    value: float
    solver: str
    dt: float
    outcome: str
    error: float = math.nan
    gained: float = math.nan
    seconds: float = 0.0
    why: str = ""


def pose(setting: Setting) -> Posed:
    """Build the scene at its stiffness or mesh. Raises BadInput."""
    with unpacked(setting.scene, [*setting.overrides, "allow_unstable=true"]) as loaded:
        fabric, pieces = build.build_fabric(loaded)
        if fabric.number == 0 or fabric.pinned.all():
            problem, remedy = "nothing in the scene can move", "add cloth that is free"
            raise BadInput(problem, loaded.file, field="objects", remedy=remedy)
        if setting.axis == "stiffness":
            fabric = stiffen(fabric, setting.value)
        bodies = build_bodies(loaded) if loaded.scene.bodies else None
        rate = float(loaded.scene.frame_rate)
        frames = max(1, min(loaded.scene.frames, round(LONGEST * rate)))
        poses = [bodies.poses(i / rate) if bodies else None for i in range(frames + 1)]
        system = build.build_system(loaded, fabric, pieces, bodies.geometry if bodies else None, poses[0], 1)
    start, edge = build.start_state(fabric), shortest(fabric)
    free = ~fabric.pinned
    start.x[free] += ROUGHNESS * edge * np.random.default_rng(1).uniform(-1.0, 1.0, (int(free.sum()), 3))
    return Posed(system, start, poses, 1.0 / rate, edge)


def stiffen(fabric: Fabric, factor: float) -> Fabric:
    """All springs and hinges stiffer by a factor; damping by its root, which keeps its share of the critical."""
    springs, hinges = fabric.springs, fabric.hinges
    if springs is not None:
        k_lock = None if springs.k_lock is None else springs.k_lock * factor
        springs = replace(springs, k=springs.k * factor, c=springs.c * math.sqrt(factor), k_lock=k_lock)
    return replace(fabric, springs=springs, hinges=hinges and replace(hinges, k=hinges.k * factor))


def shortest(fabric: Fabric) -> float:
    """Length of the shortest spring at rest [m]; 0 where there is none."""
    rest = fabric.springs.rest[fabric.springs.rest > 0.0] if fabric.springs is not None else np.zeros(0)
    return float(rest.min()) if rest.size else 0.0


def reference_plugin() -> Any:
    """The adaptive solver of highest order that is installed. Raises BadInput where there is none."""
    plugins = [registry.load("nuno.integrators", name) for name in registry.installed("nuno.integrators")]
    adaptive = [p for p in plugins if p.adaptive and "tolerance" in p.Config.model_fields]
    if not adaptive:
        raise BadInput("no adaptive solver is installed to compare with", remedy="install one with a tolerance")
    return max(adaptive, key=lambda p: p.order)


def make_reference(posed: Posed) -> Motion:
    """The same, by an adaptive solver at a tight tolerance. Raises BadInput where it cannot be made."""
    plugin = reference_plugin()
    path, ended, why = posed.run(plugin, plugin.Config(tolerance=TIGHT), 1)
    if path is None:
        raise BadInput(f"the reference run by {plugin.name} {ended}: {why}", remedy="look at the scene with nuno plan")
    return path


def classify(path: Motion, reference: Motion) -> tuple[str, float, float]:
    """Class, error and energy gained, both as shares of the reference's motion."""
    moved = float(np.abs(reference.x - reference.x[0]).max()) or 1.0
    motion = float(reference.kinetic.max()) or 1.0
    error = float(np.abs(path.x - reference.x).max()) / moved
    # Where the reference rests in between, only its own scale makes sense.
    gained = float((path.total - reference.total)[np.argmax(np.abs(path.total - reference.total))]) / motion
    if not (np.isfinite(error) and np.isfinite(gained)) or gained > RUNAWAY or error > RUNAWAY:
        return "diverged", error, gained
    if error <= ACCURATE and abs(gained) <= HIDDEN:
        return "exact" if error <= EXACT else "accurate", error, gained
    return "damped away" if gained < -LOST else "drifting", error, gained
