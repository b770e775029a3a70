"""A specimen of a fabric in the scene of an instrument, and the scene's own solver that brings it to rest."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from nuno.cloth import build
from nuno.scene import scene_file, shipped
from nuno_bench.piles import G
from nuno_bench.problem import Problem, make_problem
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Fabric, Float, Memory, State
from nuno_schemas.system import System

MOST = 400
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
        self.state = build.start_state(self.fabric)
        self.memory = self.plugin.prepare(self.problem.loaded.integrator.config, self.system, self.state)

    def rest(self, still: float, frames: int = MOST) -> Float:
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
        """One frame."""
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
    rig = Rig(problem, problem.system, build.start_state(problem.fabric), Memory())
    rig.load(G)
    return rig
