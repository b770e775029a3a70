"""A scene at one stiffness or mesh, run at any step by any solver, and the class of what comes out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nuno_bench.problem.observe import Problem, Run, Series, make_problem, simulate
from nuno_bench.problem.reference import PRIMARY, tight
from nuno_bench.sweep.packed import Packed, unpacked
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

CLASSES = ("exact", "accurate", "damped away", "drifting", "diverged", "refused", "left out")
EXACT, ACCURATE = 1e-3, 5e-2
"""Largest distance from the reference, as a share of how far the reference moves."""
HIDDEN = 1.0
"""Energy, as a multiple of the motion's, that may be off while positions are right: symplectic methods' wavers by
omega dt of what their stiffest modes hold. The motion's is the reference's largest change of any kind of energy."""
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


@dataclass(frozen=True)
class Point:
    """A step of a solver at a setting: its class, and the figures behind it.

    edge           of the shortest spring [m]
    limit          the longest stable step, by the solver itself [s]; nan where it refuses the scene
    error, gained  farthest from the reference, and energy more than it has, as shares of the reference's motion
    seconds        of the run [s]
    """

    axis: str
    value: float
    edge: float
    solver: str
    limit: float
    dt: float
    outcome: str
    error: float = math.nan
    gained: float = math.nan
    seconds: float = 0.0
    why: str = ""

    @property
    def limited(self) -> bool:
        """Whether there are both steps that the solver calls stable, and others."""
        return 0.0 < self.limit < math.inf


def pose(setting: Setting) -> Problem:
    """The beginning of the scene at its stiffness or mesh. Raises BadInput."""
    with unpacked(setting.scene, [*setting.overrides, "allow_unstable=true"]) as loaded:
        problem = make_problem(loaded, threads=1)
    frames = max(1, min(problem.frames, round(LONGEST / problem.frame)))
    problem = replace(problem, poses=problem.poses[: frames + 1])
    if setting.axis != "stiffness":
        return problem
    return replace(problem, system=replace(problem.system, fabric=stiffen(problem.fabric, setting.value)))


def stiffen(fabric: Fabric, factor: float) -> Fabric:
    """All springs, triangles and hinges stiffer by a factor; damping by its root, which keeps its share of the
    critical.
    """
    springs, hinges, membrane = fabric.springs, fabric.hinges, fabric.membrane
    if springs is not None:
        k_lock = None if springs.k_lock is None else springs.k_lock * factor
        springs = replace(springs, k=springs.k * factor, c=springs.c * math.sqrt(factor), k_lock=k_lock)
    if membrane is not None:
        membrane = replace(membrane, moduli=membrane.moduli * factor, damping=membrane.damping * math.sqrt(factor))
    hinges = hinges and replace(hinges, k=hinges.k * factor)
    bending = fabric.bending and replace(fabric.bending, weight=fabric.bending.weight * factor)
    return replace(fabric, springs=springs, hinges=hinges, membrane=membrane, bending=bending)


def shortest(fabric: Fabric) -> float:
    """Length of the shortest spring or side of a membrane's triangle at rest [m]; 0 where there is none."""
    rest = np.concatenate([
        np.zeros(0) if fabric.springs is None else fabric.springs.rest,
        np.zeros(0) if fabric.membrane is None else fabric.membrane.sides().reshape(-1),
    ])  # fmt: skip
    return float(rest[rest > 0.0].min(initial=math.inf)) if (rest > 0.0).any() else 0.0


def run(problem: Problem, plugin: Any, config: Any, steps: int, most: float = math.inf) -> Run:
    """The path with so many steps a frame, of at most so many seconds, from a start that is a little rough."""
    return simulate(problem, plugin, config, steps, roughness(problem), most)


def roughness(problem: Problem) -> Float:
    """(n, 3) how far the start is from the scene's own [m]."""
    rough = np.zeros((problem.fabric.number, 3))
    random = np.random.default_rng(1).uniform(-1.0, 1.0, (int(problem.free.sum()), 3))
    rough[problem.free] = ROUGHNESS * shortest(problem.fabric) * random
    return rough


def make_reference(problem: Problem) -> Series:
    """The same, by an adaptive solver at a tight tolerance. Raises BadInput where it cannot be made."""
    found = tight(problem, PRIMARY, TIGHT, math.inf, roughness(problem))
    if found.status != "ok":
        why = f"the reference run by {PRIMARY} {found.status}: {found.message}"
        raise BadInput(why, remedy="look at the scene with nuno plan")
    return found.series


def classify(path: Series, reference: Series) -> tuple[str, float, float]:
    """Class, error and energy gained, both as shares of the reference's motion."""
    moved = float(np.abs(reference.x - reference.x[0]).max()) or 1.0
    motion = float(np.abs(reference.parts - reference.parts[0]).max()) or 1.0
    error = float(np.abs(path.x - reference.x).max()) / moved
    # Where the reference rests in between, only its own scale makes sense.
    apart = (path.parts - reference.parts).sum(axis=1)
    gained = float(apart[np.argmax(np.abs(apart))]) / motion
    if not (np.isfinite(error) and np.isfinite(gained)) or gained > RUNAWAY or error > RUNAWAY:
        return "diverged", error, gained
    if error <= ACCURATE and abs(gained) <= HIDDEN:
        return "exact" if error <= EXACT else "accurate", error, gained
    return "damped away" if gained < -LOST else "drifting", error, gained
