"""Time of the steps of a run by part, measured at its end, so that the run itself is not slowed down.

A force costs the same in every step: the time that a very short step saves without it, times the steps. Terms with
neighbour lists rebuild them as vertices move, and check more or fewer pairs as the cloth lies. For those, a few frames'
initial states are kept during the run, and the frames are stepped again, with the term and without it.
The rest of the time, gravity, the update, solving, energies, and other programs, is "other".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nuno.recording.recorded import Checkpoint
from nuno.runtime.stepper import copy_into
from nuno.scene.chosen_plugins import Chosen
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import State
from nuno_schemas.system import StepReport, System

MOST_STARTS, MOST_BYTES = 8, 1 << 26
"""Most start states that are kept, and their most bytes together; one is kept whatever its size."""
SHARE = 0.1
"""Largest share of a run's frames that is stepped again, but at least two frames."""


@dataclass(frozen=True)
class FrameStart:
    """The start of a frame, with the poses of the bodies at its start and end."""

    point: Checkpoint
    poses: tuple[Poses, Poses] | None


@dataclass(frozen=True)
class Stage:
    """Parameters of a frame's steps: solver, system, number of steps and dt [s]."""

    solver: Chosen
    system: System
    steps: int
    dt: float

    def replay(self, start: FrameStart, without: tuple[str, ...] = ()) -> tuple[State, StepReport]:
        """Return state and report after a frame from `start`, without the terms named in `without`."""
        plugin, arrays = self.solver.plugin, start.point.arrays
        state = State(arrays["x"], arrays["v"], start.point.t).copy()
        memory = plugin.prepare(self.solver.config, self.system, state, without)
        kept = {name: values for name, values in start.point.memory.items() if name in memory.arrays}
        copy_into(memory.arrays, kept, some=True)
        # New memory builds its neighbour lists here; the run's memory had them already.
        plugin.advance(self.system, state, memory, start.poses, 0, self.dt)
        return state, plugin.advance(self.system, state, memory, start.poses, self.steps, self.dt)


class Costs:
    """Counts of a run's steps, and start states of some of its frames."""

    def __init__(self) -> None:
        self.frames = self.evaluations = 0
        """Stepped frames, and their steps, or force evaluations where the method counts those."""
        self.seconds = 0.0
        """Wall time of the steps [s]."""
        self.lists: tuple[str, ...] = ()
        """Terms with neighbour lists."""
        self.starts: list[FrameStart] = []
        self.every = 1
        """Frames from one kept start state to the next."""

    def begin(self, lists: tuple[str, ...]) -> None:
        """Start with another system and its terms with neighbour lists; earlier start states are dropped."""
        self.lists, self.starts = lists, []

    def after(self, report: StepReport, start: FrameStart | None) -> None:
        """Count a frame, and keep its start if that is due; beyond the limit every other one is dropped."""
        if start is not None and self.lists and self.frames % self.every == 0:
            most = min(MOST_STARTS, MOST_BYTES // sum(array.nbytes for array in start.point.arrays.values()))
            if len(self.starts) >= max(1, most):
                self.starts = self.starts[::2] if most > 1 else []
                self.every *= 2
            if self.frames % self.every == 0:
                self.starts.append(start)
        self.frames += 1
        self.seconds += report.seconds["steps"]
        taken = report.steps + report.totals.get("rejected_steps", 0)
        self.evaluations += report.totals.get("evaluations", taken)

    def divide(self, step_seconds: Mapping[str, float], stage: Stage, seconds: float) -> dict[str, float]:
        """Return the share of each part in `seconds` [s]; `each` is the cost of a part in one step [s]."""
        parts = {name: self.evaluations * cost for name, cost in step_seconds.items()}
        parts |= {name: self.seconds * share for name, share in self.compare(stage).items()}
        total = sum(parts.values())
        if total > seconds:  # other programs have slowed down the measurement more than the run
            parts = {name: seconds / total * cost for name, cost in parts.items()}
        return parts | {"other": max(0.0, seconds - total)}

    def compare(self, stage: Stage) -> dict[str, float]:
        """Return the share of each term with neighbour lists in the frames' time, over the kept start states. It is a
        share, since load of the machine slows down frames with and without the term alike.
        """
        if not self.starts or not self.lists:
            return {}
        most = max(1, int(SHARE * self.frames / (1 + len(self.lists))))
        stride = -(-len(self.starts) // most)
        replayed = self.starts[stride // 2 :: stride]
        variants = ((), *((name,) for name in self.lists))
        reports = [[stage.replay(start, without)[1] for without in variants] for start in replayed]
        if any(report.status == "left" for row in reports for report in row):  # the run is to end
            return {}
        whole, *rest = np.sum([[report.seconds["steps"] for report in row] for row in reports], axis=0).tolist()
        return {name: max(0.0, 1.0 - time / whole) for name, time in zip(self.lists, rest, strict=True)}
