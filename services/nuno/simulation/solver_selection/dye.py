"""`dye.solver: auto`: choice of solver and step, by trials of the first frames of the scene's dye.

The error is measured like that of cloth, against runs of shorter steps. A run at some steps a frame and one at m times
as many differ by at least (m - 1) / m of the error of the first, since every solver is of first order or better: `rkl2`
is of second where amounts are smooth, and of first where a limit begins to bind, a finite bath exchanges, or fibre
fixes dye that spreads from a jump. For the last, the shorter steps also start more finely. Costs are
counted in explicit steps, never timed, so that the choice is the same every time.
"""

from __future__ import annotations

import math
import os
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import combinations
from typing import Any

import numpy as np

from nuno.dye.run import DyeRun
from nuno.dye.supply import ROUNDING, first_step
from nuno.formatting import many
from nuno.scene.scene_file import FIRST_DYE, Loaded
from nuno.simulation.solver_selection.trials import PROMISE, Budget, Selection, Spent, written
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.parts import AUTO

LONG = "rkl2"
FINER = {FIRST_DYE: (2, 4), LONG: (2,)}
"""Factors on the steps of a run to measure its error. Two cells alone spread by (1 - z)^n in n explicit steps,
and by (1 - z / 2)^2n in twice as many: for z = 1.17 and an even n they are equal by chance, and both far off. So
explicit steps are compared with four times as many, too, and those with each other."""
ORDER = {FIRST_DYE: 1, LONG: 2}
START, MOST_START = 4, 512
"""First and largest number of steps in each doubling of the time since amounts jumped; runs for the error have twice as
many."""
STAGE = 3.0
"""Cost of a stage in explicit steps: 2 with Freundlich or where limits may bind, 4 with the other isotherms."""
FEWEST_FRAMES, SPREADING, MOST_WORK = 4, 8.0, 5e8
"""Fewest frames of a trial, and longest explicit steps, after the last supply has begun or ended; most cells times
stages of all trials of a scene: some seconds of one core."""
EXPLICIT_TRIAL = 1 + sum(FINER[FIRST_DYE])
"""Explicit steps that measure the error of one."""
FEW_CELLS = 30_000
"""Number of cells whose stage takes as long as its overhead: fewer cells count as this many."""
FEW_STEPS = 64
"""Steps a frame that are allowed for a supply to be on time, even if fewer explicit ones suffice."""


@dataclass
class DyeTrials:
    """Cached runs of a scene's first frames.

    `frame` is the time of dyeing in a frame [s]; `frames` and `first` are the frames of a trial, and its fewest steps a
    frame; `work` is the work so far, in cells times stages.
    """

    loaded: Loaded
    frame: float
    frames: int
    first: int
    budget: Budget = field(default_factory=Budget)
    work: float = 0.0
    runs_by_key: dict[tuple[str, int, int], tuple[Float, float]] = field(default_factory=dict)

    def run(self, name: str, steps: int, finer: int = 1) -> tuple[Float, float]:
        """Run `finer` times `steps` a frame, with a start that is as much finer; return the amounts at the end of every
        frame (frames, 2, dyes, 2, ny, nx), nan where it fails, and the cost in explicit steps a frame.

        Raises BadInput where the solver refuses the scene, and Spent where the budget is used up.
        """
        key = name, finer * steps, finer * self.start(name, steps)
        if key not in self.runs_by_key:
            begun, out, costs = _with_solver(self.loaded, name, start=key[2]), [], []
            dyeing = DyeRun(begun, os.cpu_count() or 1, key[1], self.budget.leave)
            shown = many(self.frames, "frame")
            with self.budget.trial(f"{name} with {many(key[1], 'step')} a frame on {shown} of dye"):
                for _ in range(self.frames):
                    report = dyeing.advance().report
                    if report.status == "left":
                        break
                    stages = report.totals.get("stages")
                    costs.append(float(key[1]) if stages is None else STAGE * stages / len(dyeing.names))
                    failed = math.nan if report.status != "ok" else 0.0
                    out.append(np.stack([dyeing.state.phi, dyeing.state.fixed]) + failed)
            self.work += _stages(dyeing, sum(costs))
            # The first frames cost more than later ones, which cost as much as the last of them.
            frames = self.loaded.scene.frames
            whole = sum(costs) + (frames - self.frames) * costs[-1]
            self.runs_by_key[key] = np.stack(out), whole / frames
        return self.runs_by_key[key]

    def start(self, name: str, steps: int) -> int:
        """Return the field `start` of a run at this number of steps a frame; 0 for a solver without it."""
        return 0 if name == FIRST_DYE else min(START * -(-steps // self.first), MOST_START)

    def error(self, name: str, steps: int) -> float:
        """Return the largest error at this number of steps a frame, as a share of the largest amount; inf on failure.

        Errors after a jump keep falling with time. An error that is largest at the end of the trial is assumed to grow
        in proportion to time.
        """
        runs = [self.run(name, steps, finer)[0] for finer in (1, *FINER[name])]
        largest, apart = float(np.abs(runs[-1]).max()) or 1.0, np.zeros(self.frames)
        for (n, coarse), (m, fine) in combinations(zip((1, *FINER[name]), runs, strict=True), 2):
            difference = np.abs(coarse - fine).reshape(self.frames, -1).max(axis=1)
            apart = np.maximum(apart, difference / (1.0 / n - 1.0 / m))
        worst = float(apart.max()) / largest
        if not math.isfinite(worst):
            return math.inf
        return worst * (self.loaded.scene.frames / self.frames if apart[-1] == apart.max() else 1.0)


def decide_dye(loaded: Loaded, budget: Budget) -> Loaded:
    """Return the scene with solver and step of its dye as if written in it; unchanged where they are named."""
    scene, dye = loaded.scene, loaded.scene.dye
    if dye is None or dye.solver.plugin != AUTO:
        return loaded
    accuracy = scene.accuracy or "normal"
    explicit = DyeRun(_with_solver(loaded, FIRST_DYE), 1)
    first = _first_on_time(explicit)
    stable = first * -(-explicit.steps // first)
    long: Selection | str = budget.over
    plain, trials = long, DyeTrials(loaded, explicit.steps * explicit.dt, 1, first, budget)
    with suppress(Spent):
        trials = _begin_trials(loaded, explicit, first, stable, budget)
        long = _settle(trials, LONG, first, PROMISE[accuracy])
        plain = _settle_explicit(trials, explicit, stable, PROMISE[accuracy], long)
    best, other = (plain, long) if isinstance(plain, Selection) else (long, plain)
    if isinstance(best, str):
        reason = f"{accuracy}: {stable} explicit steps a frame, and how far they are off is not known: {best}; {other}"
        return _with_solver(loaded, FIRST_DYE, trials.frame / stable, reason)
    tried = f" (tried on {trials.frames} of {scene.frames} frames)" if trials.frames < scene.frames else ""
    if isinstance(other, Selection):
        other = f"{other.name} would take {other.cost:.3g}"
    steps, error = best.said
    reason = (
        f"{accuracy}: with {steps} amounts are off by {error} of the largest, {PROMISE[accuracy]:g} was asked for"
        f"{tried}; {best.cost:.3g} explicit steps' work; {other}"
    )
    return _with_solver(loaded, best.name, trials.frame / best.steps, reason, trials.start(best.name, best.steps))


def _stages(dyeing: DyeRun, costs: float) -> float:
    """Return cells times stages of a cost in explicit steps of each dye."""
    return costs / STAGE * len(dyeing.names) * max(dyeing.cells.fibre.size, FEW_CELLS)


def _times(explicit: DyeRun) -> list[float]:
    """Return the times when supplies begin and end before the scene's end [s]."""
    end = explicit.loaded.scene.frames * explicit.steps * explicit.dt
    supplies = [entry.supply for entry in explicit.supplies.entries]
    return [time for supply in supplies for time in (supply.start, supply.stop) if time is not None and time < end]


def _first_on_time(explicit: DyeRun) -> int:
    """Return the steps a frame with which supplies begin and end at their times, as with any multiple of them.

    Supplies wait for the next step: one in the middle of a long step would be late by half of it, in a frame that no
    trial may include, or equally late at twice the steps, which no trial would show. Where no number of steps up to
    that of the explicit ones meets all times, it is a power of two, late by at most an explicit step.
    """
    frame, times = explicit.steps * explicit.dt, _times(explicit)

    def late(steps: int) -> float:
        return max((first_step(time, frame / steps) * frame / steps - time for time in times), default=0.0)

    most = max(explicit.steps, FEW_STEPS)
    exact = math.lcm(*(Fraction(time / frame).limit_denominator(most).denominator for time in times))
    if exact <= most and late(exact) <= ROUNDING * frame:
        return exact
    steps = 1
    while steps < explicit.steps and late(steps) > explicit.dt:
        steps *= 2
    return steps


def _begin_trials(loaded: Loaded, explicit: DyeRun, first: int, stable: int, budget: Budget) -> DyeTrials:
    """Return trials of the frames in which supplies begin and end and some more, or of as many as are affordable."""
    frame = explicit.steps * explicit.dt
    spread = max(_times(explicit), default=0.0) + SPREADING * explicit.limit
    wanted = min(float(loaded.scene.frames), FEWEST_FRAMES + spread / frame)
    pilot = DyeTrials(loaded, frame, 1, first, budget)
    try:
        pilot.run(LONG, first)
    except BadInput:  # _settle reports it
        pilot.work = _stages(explicit, EXPLICIT_TRIAL * stable)
    frames = max(1, int(min(wanted, 0.2 * MOST_WORK / pilot.work)))
    return pilot if frames == 1 else DyeTrials(loaded, frame, frames, first, budget)


def _settle(trials: DyeTrials, name: str, first: int, promise: float, cheapest: float = math.inf) -> Selection | str:
    """Return the fewest steps a frame, doubled from `first` on, that keep the promise; or the reason why none do at a
    cost below `cheapest` explicit steps a frame.
    """
    steps, previous = first, math.inf
    try:
        while True:
            error, cost = trials.error(name, steps), trials.run(name, steps)[1]
            if cost >= cheapest:
                return f"{name} would take {cost:.3g} or more"
            if error <= promise:
                return Selection(name, steps, error, cost)
            if trials.work > MOST_WORK:
                break
            steps, previous = 2 * steps, error
    except BadInput as refused:
        return str(refused.problem)
    if not math.isfinite(error):
        return f"{name} fails with {steps} steps a frame"
    # The observed order, at least 1, which is the default.
    order = min(max(math.log2(previous / error), 1.0), ORDER[name]) if math.isfinite(previous) else 1
    times = math.ceil((error / promise) ** (1.0 / order))
    # Stages of a step fall with the root of its length: those of a frame grow with the root of their number.
    cost *= times ** (1.0 / ORDER[name])
    if cost >= cheapest:
        return f"{name} would take {cost:.3g} or more"
    return Selection(name, times * steps, promise, cost, tried=False)


def _settle_explicit(
    trials: DyeTrials, explicit: DyeRun, stable: int, promise: float, long: Selection | str
) -> Selection | str:
    """Return the result of explicit steps, or why they cost more than `long`, or are not tried."""
    cheapest = long.cost if isinstance(long, Selection) else math.inf
    if stable >= cheapest:
        return f"{FIRST_DYE} would take {stable} or more"
    work = _stages(explicit, float(EXPLICIT_TRIAL * stable * trials.frames))
    if trials.work + work > 2.0 * MOST_WORK:
        return f"{FIRST_DYE} takes too long to try"
    return _settle(trials, FIRST_DYE, stable, promise, cheapest)


def _with_solver(loaded: Loaded, name: str, dt: float | None = None, reason: str = "", start: int = 0) -> Loaded:
    """Return the scene with the dye's solver, step and start as if they were written in it."""
    chosen: dict[str, Any] = {"plugin": name} | ({} if dt is None else {"dt": dt})
    return written(loaded, chosen | ({"start": start} if start not in (0, START) else {}), reason, dyed=True)
