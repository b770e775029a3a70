"""`dye.solver: auto`: which solver and which step, found by spreading the scene's dye over its first frames.

A run at some steps a frame and one at twice as many differ by 3/4 of the error of the first, rkl2 being of second
order. The second also begins in steps half as long: fibre keeps what it fixes while dye spreads from a jump, and two
runs that begin alike do not tell what that is off by. Costs are counted in explicit steps, never timed, so that the
choice is the same every time.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from nuno.dye.run import DyeRun
from nuno.dye.supply import first_step
from nuno.scene import scene_file
from nuno.scene.override import as_override
from nuno.scene.scene_file import FIRST_DYE, Loaded
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.scene import AUTO, Accuracy

PROMISE: dict[Accuracy, float] = {"preview": 1e-2, "normal": 1e-3, "reference": 1e-4}
"""Distance of any cell's amount to the exact one, as a share of the largest amount there is."""
LONG = "rkl2"
START, MOST_START = 4, 64
"""Steps in each doubling of the time since amounts jumped, at first and at most."""
STAGE = 3.0
"""Explicit steps that a stage takes the time of: 2 by Freundlich or where limits may bind, 4 by the other isotherms."""
MOST_FRAMES, MOST_WORK = 4, 5e8
"""Frames of a trial, and cells times stages of all trials of a scene: some seconds of one core."""


@dataclass
class Trials:
    """Runs of a scene's first frames at so many steps each, with the stages that a frame takes.

    `first` are the fewest steps a frame that are tried.
    """

    loaded: Loaded
    frames: int
    first: int
    work: float = 0.0
    kept: dict[int, tuple[Float, float]] = field(default_factory=dict)

    def run(self, steps: int) -> tuple[Float, float]:
        """Amounts at the end of every frame (frames, 2, dyes, 2, ny, nx), nan where it fails; stages a frame."""
        if steps not in self.kept:
            begun = _written(self.loaded, LONG, None, "", self.start(steps))
            dyeing, out, stages = DyeRun(begun, os.cpu_count() or 1, steps), [], []
            for _ in range(self.frames):
                report = dyeing.advance().report
                stages.append(report.totals["stages"])
                failed = math.nan if report.status != "ok" else 0.0
                out.append(np.stack([dyeing.state.phi, dyeing.state.fixed]) + failed)
            self.work += sum(stages) * dyeing.cells.fibre.size
            # The first frames take more than those to come, which are as the last of them.
            frames = self.loaded.scene.frames
            whole = sum(stages) + (frames - self.frames) * stages[-1]
            self.kept[steps] = np.stack(out), whole / frames / len(dyeing.names)
        return self.kept[steps]

    def start(self, steps: int) -> int:
        """How finely a run at so many steps a frame begins."""
        return min(START * -(-steps // self.first), MOST_START)

    def error(self, steps: int) -> float:
        """Largest error at so many steps a frame, as a share of the largest amount; inf where it fails."""
        coarse, fine = self.run(steps)[0], self.run(2 * steps)[0]
        largest = float(np.abs(fine).max())
        apart = float(np.abs(coarse - fine).max()) * 4.0 / 3.0
        return apart / (largest or 1.0) if math.isfinite(apart) else math.inf


def decide_dye(loaded: Loaded) -> Loaded:
    """The scene with the solver of its dye and its step as if written by hand; itself where they are named."""
    scene, dye = loaded.scene, loaded.scene.dye
    if dye is None or dye.solver.plugin != AUTO:
        return loaded
    accuracy = scene.accuracy or "normal"
    explicit = _written(loaded, FIRST_DYE, None, "")
    run = DyeRun(explicit, 1)
    steps, dt = run.steps, run.dt
    if steps == 1:
        return _written(loaded, FIRST_DYE, dt, "a frame is no longer than an explicit step")
    found = _try_longer(_written(loaded, LONG, None, ""), steps, _first_on_time(run), PROMISE[accuracy])
    if isinstance(found, str):
        return _written(loaded, FIRST_DYE, dt, f"{accuracy}: {steps} explicit steps a frame; {found}")
    number, start, error, cost = found
    why = (
        f"{accuracy}: with {number} step{'s' if number > 1 else ''} a frame amounts are off by about {error:.2g} of "
        f"the largest, {PROMISE[accuracy]:g} was asked for; {cost:.3g} explicit steps' work, where {steps} would do"
    )
    return _written(loaded, LONG, dye.speed / scene.frame_rate / number, why, start)


def _first_on_time(explicit: DyeRun) -> int:
    """Steps a frame, a power of two, with which supplies begin and end no later than an explicit step after their time.

    Supplies wait for the next step: one that came in the middle of a long step would be late by half of it, in a
    frame that no trial may have seen. Any multiple of these steps is on time, too.
    """
    end = explicit.loaded.scene.frames * explicit.steps * explicit.dt
    given = [entry.supply for entry in explicit.supplies.entries]
    times = [time for one in given for time in (one.start, one.stop) if time is not None and time < end]
    steps = 1
    while steps < explicit.steps:
        dt = explicit.steps * explicit.dt / steps
        if all(first_step(time, dt) * dt - time <= explicit.dt for time in times):
            break
        steps *= 2
    return steps


def _try_longer(loaded: Loaded, most: int, first: int, promise: float) -> tuple[int, int, float, float] | str:
    """Steps a frame of the long steps that keep the promise, and in the first doublings of time, their error and cost
    [explicit steps]; or why none do.

    `most` are the explicit steps, `first` the fewest long ones.
    """
    try:
        trials = Trials(loaded, min(loaded.scene.frames, MOST_FRAMES), first)
        trials.run(first)
        if trials.work > 0.1 * MOST_WORK and trials.frames > 1:
            trials = Trials(loaded, 1, first)
        steps = first
        while True:
            cost = STAGE * trials.run(steps)[1]
            if cost >= most:
                return f"{LONG} would take as long as {cost:.3g} for the same"
            error = trials.error(steps)
            if error <= promise:
                return steps, trials.start(steps), error, cost
            if trials.work > MOST_WORK and math.isfinite(error):
                return _extrapolated(trials, steps, error, promise, most)
            steps *= 2
    except BadInput as refused:
        return str(refused.problem)


def _extrapolated(
    trials: Trials, steps: int, error: float, promise: float, most: int
) -> tuple[int, int, float, float] | str:
    """What the second order makes of the last trial."""
    factor = math.sqrt(error / promise)
    wanted = steps * math.ceil(factor)
    # Stages of a step fall with the root of its length: those of a frame grow with the root of their number.
    cost = STAGE * trials.run(steps)[1] * math.sqrt(wanted / steps)
    if cost >= most:
        return f"{LONG} would take as long as {cost:.3g} for the same"
    return wanted, trials.start(wanted), promise, cost


def _written(loaded: Loaded, name: str, dt: float | None, why: str, start: int = START) -> Loaded:
    """The scene as if its author had named the dye's solver, its step and how finely it begins."""
    chosen: dict[str, Any] = {"plugin": name} | ({} if dt is None else {"dt": dt})
    if start != START:
        chosen["start"] = start
    data = {**loaded.data, "dye": {**loaded.data["dye"], "solver": chosen}}
    overrides = [as_override("dye.solver", chosen)]
    if not loaded.scene.moves:
        data.pop("accuracy", None)
        overrides.append("accuracy=null")
    decided = scene_file.load(data, loaded.lines, loaded.file, loaded.files)
    return replace(decided, overrides=(*loaded.overrides, *overrides), path=loaded.path, why=why)
