"""The sweep itself: the cheapest point of any solver next, within a budget."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import NamedTuple

import numpy as np
from pydantic import TypeAdapter

from nuno.formatting import duration, roughly
from nuno_bench.precision.settings import Omission, Setting, Solver
from nuno_bench.problem import AnyProblem, Run, Series
from nuno_bench.reference import ReferenceRuns
from nuno_bench.report.page import number, reason_of
from nuno_bench.sweep.storage import SweepFile
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Float

# Measured settings of solvers: their errors relative to the scene's scale, and the conclusions from all of them.

DONE = "done"
RAN_AWAY = 2.0
"""Distance from the reference, in scales, at which a run has left it, even for chaotic motion."""
ABOVE = 3.0
"""Multiple of the floor from which on errors are known to a third."""
TARGETS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
ASYMPTOTIC = 0.1
"""Largest error for fits of orders, relative to the scale: larger errors have no order."""
FITTED = 4
"""Most points of a fit of an order: the finest resolved ones."""
FLOOR_HEADINGS = ("in", "floor", "errors above it", "verdict")
CHOICE_HEADINGS = ("error at most", "fastest", "setting", "time [s]", "next ones [s]")


@dataclass(frozen=True)
class Error:
    """Errors relative to the scale: at the last compared frame, root mean square and largest over the frames.

    For the leading quantity final and l2 are also root mean squares over the vertices or cells, and linf is that of
    the farthest one.
    """

    final: float
    l2: float
    linf: float


@dataclass(frozen=True)
class SolverPoint:
    """One setting of one solver, measured.

    outcome  "done", "diverged", "unconverged", "ran away", "refused" (by the solver), "failed" (the solver itself),
             "cut" (out of time)
    seconds  wall time of each repeat, in the solver's own calls [s]
    finer    the step [s], or the tolerance of an adaptive solver
    share    step over the stability limit, None without a step or a limit
    errors   by quantity, if the run reached its end
    history  by quantity, the error at every compared frame but the first, to four digits
    """

    solver: str
    setting: str
    kind: str
    order: int
    finer: float
    beyond: bool
    outcome: str
    message: str
    seconds: tuple[float, ...]
    totals: Mapping[str, int]
    errors: Mapping[str, Error]
    history: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    share: float | None = None

    @property
    def key(self) -> tuple[str, str]:
        return self.solver, self.setting

    @property
    def median(self) -> float:
        return statistics.median(self.seconds) if self.seconds else float("nan")

    @property
    def done(self) -> bool:
        return self.outcome == DONE

    def error(self, quantity: str) -> float | None:
        """Return the l2 error of a quantity, or None."""
        return self.errors[quantity].l2 if quantity in self.errors else None


POINT = TypeAdapter(SolverPoint)
"""Reads the result of dataclasses.asdict, in which a number that is not finite may be text."""


def measure_errors(run: Series, reference: Series, scales: Mapping[str, float], frames: int) -> dict[str, Error]:
    """Return errors by quantity over the reference's `scales`; of the leading one over the first `frames` frames, if
    there are any after the start.

    Empty for a run that did not reach the end: its errors would be those of a shorter time.
    """
    if len(run.t) < len(reference.t):
        return {}
    over = errors_over_frames(run, reference, scales, frames)
    errors = {name: Error(float(e[-1]), float(np.sqrt((e**2).mean())), float(e.max())) for name, e in over.items()}
    leading = reference.leading
    if leading in errors:
        farthest = np.linalg.norm(run.x[1:frames] - reference.x[1:frames], axis=2).max() / scales[leading]
        errors[leading] = replace(errors[leading], linf=float(farthest))
    return errors


def errors_over_frames(run: Series, reference: Series, scales: Mapping[str, float], frames: int) -> dict[str, Float]:
    """Return the error at every compared frame but the first, by quantity; of the leading one its root mean square."""
    errors: dict[str, Float] = {}
    if frames > 1:
        errors[reference.leading] = _distances(run, reference)[1:frames] / scales[reference.leading]
    for name, values in reference.values.items():
        errors[name] = np.linalg.norm(run.values[name][1:] - values[1:], axis=1) / scales[name]
    return errors


def ran_away(run: Series, reference: Series, size: float) -> float | None:
    """Return the time at which a run was first RAN_AWAY times `size` from the reference [s], or None."""
    frames = np.flatnonzero(~(_distances(run, reference) <= RAN_AWAY * size))
    return float(run.t[frames[0]]) if frames.size else None


def _distances(run: Series, reference: Series) -> Float:
    """Return the root mean square distance at each of the run's frames, shape (f,)."""
    distances: Float = np.sqrt(((run.x - reference.x[: len(run.t)]) ** 2).sum(axis=2).mean(axis=1))
    return distances


class Judgement(NamedTuple):
    """Whether the reference is exact enough for the errors of a quantity, in words under FLOOR_HEADINGS.

    resolved counts points above ABOVE times the floor, of all. The verdict is "judged" if all errors are resolved, "in
    part" if some are too near the floor, "failed" if all are.
    """

    quantity: str
    floor: str
    resolved: str
    verdict: str


def judge(points: Sequence[SolverPoint], floors: Mapping[str, Error]) -> list[Judgement]:
    """Return one judgement per quantity."""
    judged = []
    for name, floor in floors.items():
        errors = [error for point in points if (error := point.error(name)) is not None]
        resolved, total = sum(error > ABOVE * floor.l2 for error in errors), len(errors)
        verdict = "no point" if not total else "judged" if resolved == total else "in part" if resolved else "failed"
        judged.append(Judgement(name, f"{floor.l2:.1e}", f"{resolved} of {total}", verdict))
    return judged


def fit_order(points: Sequence[SolverPoint], quantity: str, floor: float) -> float | None:
    """Return the slope of the logarithm of the error over that of the step or tolerance, of the finest resolved points.

    None with fewer than three of them.
    """
    finest = sorted(
        (point.finer, error)
        for point in points
        if (error := point.error(quantity)) is not None and ABOVE * floor < error < ASYMPTOTIC and not point.beyond
    )[:FITTED]
    if len(finest) < 3:
        return None
    steps, errors = np.log(np.array(finest)).T
    return float(np.polyfit(steps, errors, 1)[0])


def by_solver(points: Sequence[SolverPoint]) -> dict[str, list[SolverPoint]]:
    """Return the points of each solver from coarse to fine, with solvers in the order of their first point."""
    groups: dict[str, list[SolverPoint]] = {}
    for point in points:
        groups.setdefault(point.solver, []).append(point)
    return {name: sorted(group, key=lambda point: -point.finer) for name, group in groups.items()}


def choice_rows(points: Sequence[SolverPoint], quantity: str, floor: float) -> list[list[str]]:
    """Return the fastest solver for each target that is resolved above the floor, under CHOICE_HEADINGS.

    A point that is fastest for several targets is listed at the tightest of them. Points beyond the stability limit
    are left out.
    """
    rows: list[list[str]] = []
    candidates = [(p, e) for p in points if (e := p.error(quantity)) is not None and p.seconds and not p.beyond]
    tighter: tuple[str, str] | None = None
    for target in sorted(target for target in TARGETS if target >= ABOVE * floor):
        best: dict[str, SolverPoint] = {}
        for point in sorted((p for p, error in candidates if error <= target), key=lambda p: p.median):
            best.setdefault(point.solver, point)
        ranked = list(best.values())
        if ranked and (first := ranked[0]).key != tighter:
            rest = ", ".join(f"{point.solver} {number(point.median)}" for point in ranked[1:3])
            rows.append([f"{target:g}", first.solver, first.setting, number(first.median), rest])
            tighter = first.key
    return rows[::-1]


FIRST_STEPS = 20
"""Steps by which the cost of a solver with fixed steps is estimated before its first point."""

SHORT, MORE = 0.05, 5
"""Runs shorter than SHORT [s] are repeated up to MORE times as often, as far as they fit into it."""
REPEATED = 4
"""A point is repeated only while that takes less than a solver's even share of the budget over this."""
MISJUDGED = 3.0
"""A run is cut where it takes this multiple of its estimate and more than its solver's even share of the budget."""


@dataclass
class Sweep:
    """What a sweep has so far; by solver, `first_calls` are seconds to compile or load, `costs` estimates of a
    run of work 1 [s].
    """

    points: list[SolverPoint] = field(default_factory=list)
    omitted: list[Omission] = field(default_factory=list)
    first_calls: dict[str, float] = field(default_factory=dict)
    costs: dict[str, float] = field(default_factory=dict)


@dataclass
class Runner:
    """Everything that one point needs: errors are shares of `scales`, leading ones over the first `frames`."""

    problem: AnyProblem
    reference: ReferenceRuns
    scales: Mapping[str, float]
    frames: int
    repeats: int

    def measure(self, solver: Solver, setting: Setting, share: float, most_seconds: float) -> SolverPoint:
        """Run one setting, at most so long; repeats end early where another would exceed its `share` of time [s].

        A run of milliseconds is repeated more often, since whatever else the machine does disturbs it more.
        """
        point = SolverPoint(solver.name, setting.label, solver.kind, solver.order, setting.finer, setting.beyond,
                            "refused", "", (), {}, {}, share=setting.share)  # fmt: skip
        try:
            config = solver.config(setting)
            run = self.problem.run(solver.plugin, config, setting.steps, most_seconds)
        except RunFailed as error:
            return replace(point, outcome="failed", message=reason_of(error))
        except (BadInput, ValueError) as error:
            return replace(point, message=error.problem if isinstance(error, BadInput) else str(error))
        outcome, message = self._judge(run)
        seconds = [run.seconds]
        wanted = self.repeats * max(1, min(MORE, int(SHORT / max(run.seconds, 1e-9))))
        while outcome == DONE and len(seconds) < wanted and sum(seconds) + seconds[-1] <= share:
            seconds.append(self.problem.run(solver.plugin, config, setting.steps).seconds)
        point = replace(point, outcome=outcome, message=message, seconds=tuple(seconds), totals=dict(run.totals))
        if outcome != DONE:
            return point
        compared = (run.series, self.reference.run.series, self.scales, self.frames)
        over = errors_over_frames(*compared)
        history = {name: tuple(float(f"{value:.4g}") for value in values) for name, values in over.items()}
        return replace(point, errors=measure_errors(*compared), history=history)

    def _judge(self, run: Run) -> tuple[str, str]:
        """Outcome and message of a run."""
        if run.status != "ok":
            return run.status, run.message
        leading = self.reference.run.series.leading
        lost = ran_away(run.series, self.reference.run.series, self.scales[leading])
        if lost is None:
            return DONE, ""
        return "ran away", f"at {lost:.3g} s its {leading} are {RAN_AWAY:g} times their scale from the reference"


def start_sweep(problem: AnyProblem, solvers: list[Solver], say: Callable[[str], None]) -> Sweep:
    """Call every solver once, which compiles it or loads it; one that refuses the scene, or fails, is left out.

    To be done before anything else runs, the reference too, or its solvers would seem to need no compiling.
    """
    sweep = Sweep()
    for solver in solvers:
        say(f"{solver.name}: first call")
        setting = min(solver.settings, key=lambda one: (one.beyond, one.work))
        taken = min(setting.steps, FIRST_STEPS)
        try:
            config = solver.config(setting)
            first, seconds = problem.first_call(solver.plugin, config, setting.steps, taken)
        except (BadInput, RunFailed) as error:
            say(f"{solver.name} is left out: {error}")
            sweep.omitted.append(Omission(solver.name, "", reason_of(error)))
            continue
        sweep.first_calls[solver.name] = first
        sweep.costs[solver.name] = seconds * setting.steps / taken * problem.frames / setting.work
    return sweep


def run_sweep(
    sweep: Sweep, runner: Runner, solvers: list[Solver], kept: SweepFile, budget: float, say: Callable[[str], None]
) -> None:
    """Run the settings of all solvers that could be started: always the one that is estimated cheapest next.

    Those of the scene itself are run before all others. Slow solvers then take what is left when the fast ones are
    done, and never their place. A solver ends where the estimate for its next point exceeds what is left of
    `budget` [s].
    """
    started, costs = time.perf_counter(), sweep.costs
    known = {point.key: point for point in map(POINT.validate_python, kept.lines)}
    waiting = {
        solver.name: [(solver, one) for one in sorted(solver.settings, key=lambda one: not one.first)]
        for solver in solvers
        if solver.name in costs
    }
    share = budget / (REPEATED * max(1, len(costs)))
    once = sum(setting.work * costs[name] for name, ones in waiting.items() for _, setting in ones)
    say(f"points: {roughly(min(once, budget))} by the solvers' first calls, at most {duration(budget)} with repeats")

    def estimate(name: str) -> tuple[bool, float]:
        setting = waiting[name][0][1]
        return not setting.first, setting.work * costs[name]

    while any(waiting.values()):
        name = min((name for name in waiting if waiting[name]), key=estimate)
        solver, setting = waiting[name].pop(0)
        point = known.get((name, setting.label))
        if point is None:
            left = max(0.0, budget - (time.perf_counter() - started))
            once = setting.work * costs[name]
            if once > left:
                reason = f"estimated at {once:.2g} s, and {left:.2g} s of the budget were left"
                sweep.omitted.append(Omission(name, setting.label, reason))
                continue
            say(f"{name}, {setting.label} ({left:.0f} s left)")
            most = max(1.0, min(1.5 * left, max(MISJUDGED * once, budget / len(costs))))
            point = runner.measure(solver, setting, min(share, left), most)
            kept.add(asdict(point))
        if point.done or point.outcome == "cut":
            costs[name] = point.median / setting.work
        sweep.points.append(point)
    place = {
        (solver.name, one.label): (i, k) for i, solver in enumerate(solvers) for k, one in enumerate(solver.settings)
    }
    sweep.points.sort(key=lambda point: place[point.key])
