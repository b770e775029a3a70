"""Trials of solvers on a scene's first frames, within a budget of time: the error of a step.

A run at some step and one at half of it differ by the error of the first times (2^p - 1) / 2^p for a method of
order p. Positions count only as long as they can be predicted (GROWTH).
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.formatting import many, roughly
from nuno.runtime.stepper import limited
from nuno.scene import scene_file
from nuno.scene.override import as_override
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float
from nuno_schemas.parts import Accuracy
from nuno_schemas.system import System

# Time budget of the trials for a solver, and their progress messages.

BUDGET = 60.0
"""Default wall time of the trials [s]."""
SILENT = 2.0
"""Total time of trials from which messages are shown [s]."""


class Spent(Exception):
    """The budget is used up."""


@dataclass
class Budget:
    """Wall time for the trials of one scene [s]. The choice depends on it only if it is used up.

    leave  (1,) nonzero once it is used up, or the choice is no longer needed: solvers then abandon their frame
    tell   is called with messages about the trials
    """

    seconds: float = BUDGET
    tell: Callable[[str], None] = lambda text: None
    leave: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64))
    used: float = 0.0
    """Wall time of trials so far [s], without compilation."""

    @property
    def over(self) -> str:
        """Message for a budget that is used up."""
        return f"trials were ended after {self.seconds:g} s: --budget gives them longer"

    def stop(self) -> None:
        """Abandon the present trial."""
        self.leave[0] = 1

    @contextmanager
    def trial(self, what: str, expected: float = 0.0) -> Iterator[None]:
        """Time one trial, which is expected to take `expected` [s]. Raises Spent without the time for it, or if the
        budget is used up before its end.
        """
        left, began = self.seconds - self.used, time.monotonic()
        if self.leave[0] or expected > left:
            raise Spent
        if self.used > SILENT or expected > SILENT:
            takes = f", {roughly(expected)}" if expected else ""
            self.tell(f"trying {what}{takes}: {self.used:.0f} of {self.seconds:g} s are used (--budget)")
        timer = threading.Timer(left, self.stop)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            self.used += time.monotonic() - began
        if self.leave[0]:
            raise Spent


DISTURBANCE, GROWTH = 1e-9, 1e3
"""A run is compared while a disturbance of this share of the size has grown less than this factor: after that, chaos
dominates at any practical step."""
MOST_WORK = 1.5e8
"""Most vertices times evaluations of the forces in all trials of a scene: some seconds of one core."""
SEED = 20


@dataclass(frozen=True)
class Method:
    """A candidate solver: evaluations of the forces a step, and the fewest stable steps a frame."""

    name: str
    plugin: Any
    config: Any
    evaluations: float
    fewest: int


@dataclass
class Trials:
    """Cached runs of a scene's first frames.

    poses (frames + 1) of the bodies, None without bodies; `total` frames of the whole scene;
    size [m] of the cloth; `limit` of a frame's wall time [s]; `work` so far, in vertices times evaluations. Methods
    raise Spent where the budget is used up.
    """

    system: System
    poses: tuple[Poses | None, ...]
    frame: float
    total: int
    size: float
    budget: Budget = field(default_factory=Budget)
    limit: float | None = None
    too_slow: bool = False
    """Whether a run has failed since one of its frames took longer."""
    work: float = 0.0
    pace: float = 0.0
    """Wall time of a vertex's evaluation in the last successful run [s]."""
    runs: dict[tuple[str, int, Any, float], Float | None] = field(default_factory=dict)
    predictable: int | None = None

    @property
    def frames(self) -> int:
        return len(self.poses) - 1

    def affords(self, method: Method, steps: int) -> bool:
        """Return whether a trial at this number of steps a frame is within the work limit."""
        return self.work + 3.0 * self._cost(method, steps) <= MOST_WORK

    def error(self, method: Method, steps: int) -> float:
        """Return the error of the whole scene's run [sizes], root mean square over vertices and frames; inf on failure.

        Errors are assumed to grow in proportion to time after the tried frames, unless these already
        exceed the predictable time.
        """
        kickless = method
        if hasattr(method.plugin, "steps_a_kick"):
            kickless = replace(method, config=method.config.model_copy(update={"every": 1}))
        x, coarse, fine = (self._positions(*one) for one in ((method, steps), (kickless, steps), (kickless, 2 * steps)))
        if x is None or coarse is None or fine is None:
            return math.inf
        # Kicks that are far apart do not show by halving them: they have no order yet.
        frames, higher = self._predictable_frames(method, steps), 2.0**method.plugin.order
        by_kicks, by_steps = (self._distances(one, other)[:frames] for one, other in ((x, coarse), (coarse, fine)))
        growth = self.total / self.frames if frames == self.frames else 1.0
        errors = by_kicks, by_steps * higher / (higher - 1.0)
        return growth * sum(float(np.sqrt(np.square(error).mean())) for error in errors)

    def _predictable_frames(self, method: Method, steps: int) -> int:
        """Return the number of predictable frames, at least one."""
        if self.predictable is None:
            a, b = self._positions(method, steps), self._positions(method, steps, DISTURBANCE)
            lost = (
                np.flatnonzero(~(self._distances(a, b) <= GROWTH * DISTURBANCE))
                if a is not None and b is not None
                else np.zeros(0)
            )
            self.predictable = max(1, int(lost[0])) if lost.size else self.frames
        return self.predictable

    def _distances(self, a: Float, b: Float) -> Float:
        """Return the root mean square distance (frames,) over the vertices [sizes]."""
        return np.asarray(np.sqrt(((a - b) ** 2).sum(axis=2).mean(axis=1)) / self.size)

    def _cost(self, method: Method, steps: int) -> float:
        return float(self.system.fabric.number) * self.frames * steps * method.evaluations

    def _positions(self, method: Method, steps: int, disturbance: float = 0.0) -> Float | None:
        """Return positions (frames, free, 3) [m], None where the run fails."""
        key = (method.name, steps, getattr(method.config, "every", None), disturbance)
        if key not in self.runs:
            self._compile(method)
            cost, began = self._cost(method, steps), time.perf_counter()
            what = f"{method.name} with {many(steps, 'step')} a frame on {self.frames} frames"
            with self.budget.trial(what, cost * self.pace), np.errstate(all="ignore"):
                self.runs[key] = self._run(method, steps, disturbance)  # a diverging trial may overflow
            self.work += cost
            if self.runs[key] is not None:
                self.pace = (time.perf_counter() - began) / cost
        return self.runs[key]

    def _compile(self, method: Method) -> None:
        """Compile a method's kernels, which does not count as its cost."""
        if all(name != method.name for name, *_ in self.runs):
            state = cloth.start_state(self.system.fabric)
            memory = method.plugin.prepare(method.config, self.system, state)
            method.plugin.advance(self.system, state, memory, self._pair(0), 0, self.frame)

    def _pair(self, i: int) -> tuple[Poses, Poses] | None:
        """Return the poses of the bodies at both ends of a frame."""
        start, end = self.poses[i : i + 2]
        return (start, end) if start is not None and end is not None else None

    def _run(self, method: Method, steps: int, disturbance: float) -> Float | None:
        free = ~self.system.fabric.pinned
        state = cloth.start_state(self.system.fabric)
        if disturbance:
            noise = np.random.default_rng(SEED).normal(size=state.x.shape) / math.sqrt(3.0)
            state.x[free] += disturbance * self.size * noise[free]
        memory = method.plugin.prepare(method.config, self.system, state)
        out = []
        for i in range(self.frames):
            state.t = i * self.frame
            with limited(self.budget.leave, self.limit):
                report = method.plugin.advance(self.system, state, memory, self._pair(i), steps, self.frame / steps)
            self.too_slow |= report.status == "left"
            if report.status != "ok":
                return None
            out.append(state.x[free].copy())
        return np.array(out)


# The result of trials of cloth and dye, and the scene with it.

PROMISE: dict[Accuracy, float] = {"preview": 1e-2, "normal": 1e-3, "reference": 1e-4}
"""Largest error of each accuracy. For cloth, the distance to the exact motion, root mean square over vertices and
frames, as a share of the cloth's size (the diagonal of its bounding box), as long as the motion can be predicted: until
a disturbance has grown a thousandfold. For dye, the difference of any cell's amount to the exact evolution of the
cells, at the end of any frame, as a share of the largest amount at the end of any frame."""


@dataclass(frozen=True)
class Selection:
    """A solver with its steps a frame, its error [sizes, or largest amounts], and its cost a frame [evaluations of the
    forces, or explicit steps]; `tried` is False where the error is extrapolated from fewer steps by the order of the
    method.
    """

    name: str
    steps: int
    error: float
    cost: float
    tried: bool = True

    @property
    def said(self) -> tuple[str, str]:
        """Steps and error in words."""
        return f"{many(self.steps, 'step')} a frame", f"{self.error:.2g}" if self.tried else f"about {self.error:.2g}"


def written(loaded: Loaded, solver: Mapping[str, Any], reason: str, dyed: bool = False) -> Loaded:
    """Return the scene with this solver of its cloth or its dye, as if it were written in it."""
    chosen, data = dict(solver), dict(loaded.data)
    overrides = [as_override("dye.solver" if dyed else "solver", chosen)]
    if dyed:
        data["dye"] = {**data["dye"], "solver": chosen}
    else:
        data["solver"] = chosen
    if not (dyed and loaded.scene.moves):  # otherwise the cloth's step is not chosen yet
        data.pop("accuracy", None)
        overrides.append("accuracy=null")
        if slid := loaded.scene.slid_skins:
            names = [loaded.scene.bodies[i].name for i in loaded.scene.met_bodies]
            data["cloth_contact"] = {**data["cloth_contact"], "bodies": names}
            data["bodies"] = list(data["bodies"])
            for i in slid:
                data["bodies"][i] = {**data["bodies"][i], "contact": {"plugin": "sliding"}}
            overrides += [f"cloth_contact.bodies=[{', '.join(names)}]"]
            overrides += [f"bodies.{i}.contact={{plugin: sliding}}" for i in slid]
    decided = scene_file.load(data, loaded.lines, loaded.file, loaded.files)
    reasons = f"{reason}; dye: {loaded.why}" if loaded.why else reason
    return replace(decided, overrides=(*loaded.overrides, *overrides), path=loaded.path, why=reasons)
