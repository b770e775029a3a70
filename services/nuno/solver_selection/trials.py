"""What a step costs in accuracy, measured on a scene's first frames.

A run at some step and one at half of it differ by the error of the first times (2^p - 1) / 2^p for a method of
order p. Positions count only as long as they can be predicted (GROWTH).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from nuno.cloth import build
from nuno.formatting import many
from nuno.solver_selection.budget import Budget
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float
from nuno_schemas.system import System

DISTURBANCE, GROWTH = 1e-9, 1e3
"""A run disturbed by that share of the size is compared with as long as the disturbance has not grown more than
so many times: what is lost to chaos beyond is lost at any step that one would take."""
MOST_WORK = 1.5e8
"""Vertices times evaluations of the forces that all trials of a scene may take: some seconds of one core."""
SEED = 20


@dataclass(frozen=True)
class Method:
    """A solver that may be chosen: evaluations of the forces a step, and the fewest steps a frame that are stable."""

    name: str
    plugin: Any
    config: Any
    evaluations: float
    fewest: int


@dataclass
class Trials:
    """Runs of a scene's first frames, each made once.

    poses (frames + 1) of the bodies, None where there are none; `total` frames of the whole scene;
    size [m] of the cloth; `work` done so far, in vertices times evaluations. What is asked of them raises Spent where
    the budget is.
    """

    system: System
    poses: tuple[Poses | None, ...]
    frame: float
    total: int
    size: float
    budget: Budget = field(default_factory=Budget)
    work: float = 0.0
    pace: float = 0.0
    """Wall time of a vertex' evaluation in the last run that ended well [s]."""
    kept: dict[tuple[str, int, Any, float], Float | None] = field(default_factory=dict)
    predictable: int | None = None

    @property
    def frames(self) -> int:
        return len(self.poses) - 1

    def affords(self, method: Method, steps: int) -> bool:
        """Whether the error at so many steps a frame may still be tried."""
        return self.work + 3.0 * self._cost(method, steps) <= MOST_WORK

    def error(self, method: Method, steps: int) -> float:
        """Of a run of the whole scene [sizes], root mean square over vertices and frames; inf where it fails.

        Errors are taken to grow in proportion to time beyond what is tried, unless that is already
        more than can be predicted.
        """
        coarse, fine = self._positions(method, steps), self._positions(self._halved(method, steps), 2 * steps)
        if coarse is None or fine is None:
            return math.inf
        apart = self._apart(coarse, fine)[: self._horizon(method, steps)]
        growth = self.total / self.frames if len(apart) == self.frames else 1.0
        higher = 2.0**method.plugin.order
        found: float = float(np.sqrt((apart**2).mean())) * growth * higher / (higher - 1.0)
        return found

    def _halved(self, method: Method, steps: int) -> Method:
        """With kicks half as long, too, where a step of so many a frame is halved: by itself the solver would let each
        stand for twice as many, and what kicks are off would not be seen.
        """
        kicks = getattr(method.plugin, "steps_a_kick", None)
        if kicks is None:
            return method
        # A frame ends the last one.
        every = min(kicks(method.config, self.system, self.frame / steps, self.frame), steps)
        return replace(method, config=method.config.model_copy(update={"every": every}))

    def _horizon(self, method: Method, steps: int) -> int:
        """Frames whose positions can be predicted, at least one."""
        if self.predictable is None:
            a, b = self._positions(method, steps), self._positions(method, steps, DISTURBANCE)
            lost = (
                np.flatnonzero(~(self._apart(a, b) <= GROWTH * DISTURBANCE))
                if a is not None and b is not None
                else np.zeros(0)
            )
            self.predictable = max(1, int(lost[0])) if lost.size else self.frames
        return self.predictable

    def _apart(self, a: Float, b: Float) -> Float:
        """(frames,) root mean square distance over the vertices [sizes]."""
        distance: Float = np.sqrt(((a - b) ** 2).sum(axis=2).mean(axis=1)) / self.size
        return distance

    def _cost(self, method: Method, steps: int) -> float:
        return float(self.system.fabric.number) * self.frames * steps * method.evaluations

    def _positions(self, method: Method, steps: int, disturbance: float = 0.0) -> Float | None:
        """(frames, free, 3) [m], None where the run does not end well."""
        key = (method.name, steps, getattr(method.config, "every", None), disturbance)
        if key not in self.kept:
            self._compile(method)
            cost, began = self._cost(method, steps), time.perf_counter()
            what = f"{method.name} with {many(steps, 'step')} a frame on {self.frames} frames"
            with self.budget.trial(what, cost * self.pace), np.errstate(all="ignore"):
                self.kept[key] = self._run(method, steps, disturbance)  # what a diverging trial overflows is its result
            self.work += cost
            if self.kept[key] is not None:
                self.pace = (time.perf_counter() - began) / cost
        return self.kept[key]

    def _compile(self, method: Method) -> None:
        """Compile what a method needs, which is none of what it costs."""
        if all(name != method.name for name, *_ in self.kept):
            state = build.start_state(self.system.fabric)
            memory = method.plugin.prepare(method.config, self.system, state)
            method.plugin.advance(self.system, state, memory, self._pair(0), 0, self.frame)

    def _pair(self, i: int) -> tuple[Poses, Poses] | None:
        """The bodies at both ends of a frame."""
        start, end = self.poses[i : i + 2]
        return (start, end) if start is not None and end is not None else None

    def _run(self, method: Method, steps: int, disturbance: float) -> Float | None:
        free = ~self.system.fabric.pinned
        state = build.start_state(self.system.fabric)
        if disturbance:
            noise = np.random.default_rng(SEED).normal(size=state.x.shape) / math.sqrt(3.0)
            state.x[free] += disturbance * self.size * noise[free]
        memory = method.plugin.prepare(method.config, self.system, state)
        out = []
        for i in range(self.frames):
            state.t = i * self.frame
            report = method.plugin.advance(self.system, state, memory, self._pair(i), steps, self.frame / steps)
            if report.status != "ok":
                return None
            out.append(state.x[free].copy())
        return np.array(out)
