"""What the steps of a run have cost, by part: measured at its end, so that the run itself is not slowed down.

A force costs the same in every step: what a step of hardly any duration saves without it, times the steps. Terms that
make lists of what is near do so as far as vertices move, and look at more or fewer pairs as the cloth lies. For those,
a few moments are kept while the run goes on, and frames are stepped from there again, with the term and without it.
What is left of the time, gravity, the update, solving, energies, and what other programs took, is "other".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nuno.recording.recorded import Arrays
from nuno.scene.chosen_plugins import Chosen
from nuno.stepping.stepper import copy_into
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Memory, State
from nuno_schemas.system import StepReport, System

MOMENTS, MOST_BYTES = 8, 1 << 26
"""Moments that are kept, and bytes that they take together, at most; but one is kept whatever it takes."""
SHARE = 0.1
"""Of a run's frames: as many are stepped again at most, but at least two."""


@dataclass(frozen=True)
class Moment:
    """What a frame of a run was stepped from: the state, arrays of the solver's memory, the bodies' poses."""

    state: State
    arrays: Arrays
    poses: tuple[Poses, Poses] | None


@dataclass(frozen=True)
class Stage:
    """How frames are stepped: by which solver, of which system, in how many steps of dt [s]."""

    solver: Chosen
    system: System
    steps: int
    dt: float

    def replay(self, moment: Moment, without: tuple[str, ...] = ()) -> tuple[State, StepReport]:
        """The state after the frame that began at a moment, without the terms of some names, and what is said of it."""
        plugin, state = self.solver.plugin, moment.state.copy()
        memory = plugin.prepare(self.solver.config, self.system, state, without)
        copy_into(memory.arrays, {name: a for name, a in moment.arrays.items() if name in memory.arrays}, some=True)
        # A memory that is new makes its lists, which the run's had already.
        plugin.advance(self.system, state, memory, moment.poses, 0, self.dt)
        return state, plugin.advance(self.system, state, memory, moment.poses, self.steps, self.dt)


class Costs:
    """How much a run has stepped, and moments of it."""

    def __init__(self) -> None:
        self.frames = self.evaluations = 0
        """Frames that were stepped, and steps in them, or evaluations of the forces where the method counts those."""
        self.seconds = 0.0
        """What they took."""
        self.lists: tuple[str, ...] = ()
        """Terms that make lists."""
        self.moments: list[Moment] = []
        self.every = 1
        """Frames from one moment to the next."""

    def begin(self, lists: tuple[str, ...]) -> None:
        """Of another system, with terms that make lists: its frames are not those of the moments so far."""
        self.lists, self.moments = lists, []

    def before(self, state: State, memory: Memory, poses: tuple[Poses, Poses] | None) -> None:
        """Keep the moment before a frame, if it is due; of more than can be kept, every other one goes."""
        if not self.lists or self.frames % self.every != 0:
            return
        size = state.x.nbytes + state.v.nbytes + sum(array.nbytes for array in memory.arrays.values())
        most = min(MOMENTS, MOST_BYTES // size)
        if len(self.moments) >= max(1, most):
            self.moments = self.moments[::2] if most > 1 else []
            self.every *= 2
            if self.frames % self.every != 0:
                return
        self.moments.append(Moment(state.copy(), {name: a.copy() for name, a in memory.arrays.items()}, poses))

    def after(self, report: StepReport) -> None:
        """Count a frame."""
        self.frames += 1
        self.seconds += report.seconds["steps"]
        taken = report.steps + report.totals.get("rejected_steps", 0)
        self.evaluations += report.totals.get("evaluations", taken)

    def divide(self, each: Mapping[str, float], stage: Stage, seconds: float) -> dict[str, float]:
        """What each part has cost of `seconds`, by what it costs in `each` step [s]."""
        parts = {name: self.evaluations * cost for name, cost in each.items()}
        parts |= {name: self.seconds * share for name, share in self.compare(stage).items()}
        total = sum(parts.values())
        if total > seconds:  # other programs have slowed down the measurement more than the run
            parts = {name: seconds / total * cost for name, cost in parts.items()}
        return parts | {"other": max(0.0, seconds - total)}

    def compare(self, stage: Stage) -> dict[str, float]:
        """The share of the frames' time that each of the terms that make lists has taken, over moments of the run. A
        share, since what else the machine does slows down frames with the term as those without it.
        """
        if not self.moments or not self.lists:
            return {}
        most = max(1, int(SHARE * self.frames / (1 + len(self.lists))))
        every = -(-len(self.moments) // most)
        chosen = self.moments[every // 2 :: every]
        taken = [
            [stage.replay(moment, without)[1].seconds["steps"] for without in ((), *((name,) for name in self.lists))]
            for moment in chosen
        ]
        whole, *rest = np.sum(taken, axis=0).tolist()
        return {name: max(0.0, 1.0 - time / whole) for name, time in zip(self.lists, rest, strict=True)}
