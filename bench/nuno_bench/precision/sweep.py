"""The sweep itself: the cheapest point of any solver next, within a budget."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace

from nuno.formatting import duration, roughly
from nuno_bench.precision.point import DONE, POINT, RAN_AWAY, Point, errors_over_frames, measure_errors, ran_away
from nuno_bench.precision.settings import Omission, Setting, Solver
from nuno_bench.problem.dye import AnyProblem
from nuno_bench.problem.observe import Run
from nuno_bench.problem.reference import Compared
from nuno_bench.report.result import reason_of
from nuno_bench.sweep.storage import Kept
from nuno_schemas.errors import BadInput, RunFailed

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

    points: list[Point] = field(default_factory=list)
    omitted: list[Omission] = field(default_factory=list)
    first_calls: dict[str, float] = field(default_factory=dict)
    costs: dict[str, float] = field(default_factory=dict)


@dataclass
class Runner:
    """Everything that one point needs: errors are shares of `scales`, leading ones over the first `frames`."""

    problem: AnyProblem
    reference: Compared
    scales: Mapping[str, float]
    frames: int
    repeats: int

    def measure(self, solver: Solver, setting: Setting, share: float, most_seconds: float) -> Point:
        """Run one setting, at most so long; repeats end early where another would exceed its `share` of time [s].

        A run of milliseconds is repeated more often, since whatever else the machine does disturbs it more.
        """
        point = Point(solver.name, setting.label, solver.kind, solver.order, setting.finer, setting.beyond,
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
    sweep: Sweep, runner: Runner, solvers: list[Solver], kept: Kept, budget: float, say: Callable[[str], None]
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
