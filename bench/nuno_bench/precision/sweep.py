"""The sweep itself: the cheapest point of any solver next, within a budget."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, TypeAdapter, ValidationError

from nuno.formatting import duration, roughly
from nuno.plugin_contract import registry
from nuno_bench.options import require_known
from nuno_bench.problem import AnyProblem, Run, Series
from nuno_bench.reference import ReferenceRuns
from nuno_bench.report.page import number, reason_of
from nuno_bench.sweep.executor import SweepFile
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Float
from nuno_schemas.system import StepLimit

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


def _distances(run: Series, reference: Series) -> Float:
    """Return the root mean square distance at each of the run's frames, shape (f,)."""
    return np.asarray(np.sqrt(((run.x - reference.x[: len(run.t)]) ** 2).sum(axis=2).mean(axis=1)))


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
        near = _distances(run.series, self.reference.run.series) <= RAN_AWAY * self.scales[leading]
        if near.all():
            return DONE, ""
        lost = f"{run.series.t[near.argmin()]:.3g} s"
        return "ran away", f"at {lost} its {leading} are {RAN_AWAY:g} times their scale from the reference"


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


# Steps, tolerances and residuals that each installed solver is tried with on a scene, from coarse to fine.

SHARES = (0.9, 0.5, 0.25, 0.1, 0.05, 0.025)
"""Steps, as shares of the stability limit."""
BEYOND = 1.5
"""Multiple of the limit at which failure is shown: the limit may be up to 1.2 times below the true one."""
ROUNDING = 1e-12
"""Relative: a step that is the limit itself may come out longer by this."""
FEW = (1, 2, 4, 8, 16, 32)
"""Steps a frame where nothing limits them, and of implicit methods."""
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
TIGHTEST_RESIDUAL = 1e-11
RESIDUAL = ", residual "
"""Begins the part of a label that gives the residual."""
LEFT_OUT = {"rk4_printed": "repeats the slips of the skirt paper, which change the motion it converges to"}
"""Solvers that are tried only where they are named."""
LOOSER = 10.0
"""Times an adaptive solver's own tolerance: it chooses its steps, so that twice its step cannot be asked for."""


@dataclass(frozen=True)
class Setting:
    """One point of a solver's sweep.

    label   what is set, in words; it names the point
    steps   a frame; for an adaptive solver 1
    fields  of the solver's configuration
    finer   what an error's order is fitted over: the step [s] or the tolerance
    share   of the stability limit that the step is, None where there is no step or nothing limits it
    work    estimated, as a multiple of the solver's first point that is not beyond the limit
    beyond  above the stability limit, to show the failure
    first   run before all others: what the scene itself says
    """

    label: str
    steps: int
    fields: Mapping[str, float] = field(default_factory=dict)
    finer: float = math.nan
    work: float = 1.0
    beyond: bool = False
    first: bool = False
    share: float | None = None


@dataclass(frozen=True)
class Solver:
    """An installed solver, its limit on the scene and its settings."""

    name: str
    plugin: Any
    limit: StepLimit
    settings: tuple[Setting, ...]
    base: Mapping[str, Any]

    @property
    def kind(self) -> str:
        if getattr(self.plugin, "adaptive", False):
            return "adaptive"
        if not hasattr(self.plugin, "explicit"):
            return "fixed steps" if math.isfinite(self.limit.dt) else "any step"
        return "fixed steps" if self.plugin.explicit else "implicit"

    @property
    def order(self) -> int:
        """Nominal order; 0 where it states none."""
        return int(getattr(self.plugin, "order", 0))

    def config(self, setting: Setting) -> BaseModel:
        chosen: BaseModel = self.plugin.Config.model_validate({**self.base, **setting.fields})
        return chosen


@dataclass(frozen=True)
class Omission:
    """A setting that was not run, with the reason; `setting` is empty for a whole solver."""

    solver: str
    setting: str
    reason: str


def choose_solvers(problem: AnyProblem, wanted: Sequence[str]) -> tuple[list[Solver], list[Omission]]:
    """The solvers named, or all that are installed, each with its sweep; and those left out.

    Raises BadInput for an unknown name, and where nothing is left to run.
    """
    known = registry.installed(problem.group)
    require_known(wanted, known, "solver", "--solvers")
    solvers, omitted = [], []
    for name in dict.fromkeys(wanted or known):
        if not wanted and name in LEFT_OUT:
            omitted.append(Omission(name, "", LEFT_OUT[name]))
            continue
        try:
            solvers.append(_choose(problem, name))
        except (BadInput, RunFailed) as error:
            omitted.append(Omission(name, "", reason_of(error)))
    if not solvers:
        reasons = "; ".join(f"{one.solver}: {one.reason}" for one in omitted)
        raise BadInput("no solver is left to run", field="--solvers", value=reasons or "none named")
    return solvers, omitted


def _choose(problem: AnyProblem, name: str) -> Solver:
    """A solver and its settings. Raises BadInput where it cannot be configured or run on this scene."""
    plugin, (preset, given) = registry.load(problem.group, name), problem.preset
    base = dict(given) if preset == name else {}
    try:
        config = plugin.Config.model_validate(base)
    except ValidationError as error:
        missing = ", ".join(str(one["loc"][0]) for one in error.errors() if one["loc"])
        raise BadInput(f"its configuration has no defaults ({missing}): name it in the scene") from None
    found = Solver(name, plugin, problem.limit(plugin, config), (), base)
    return replace(found, settings=tuple(_settings(problem.frame, found)))


def at_tolerance(plugin: Any, tolerance: float, steps: int = 1) -> Setting:
    """An adaptive solver's setting, with `steps` a frame at least.

    Work grows as tolerance^(-1 / (order + 1)): the estimate is of that order in the step.
    """
    text = f"{tolerance:.0e}"
    label = f"tolerance {text if math.isclose(float(text), tolerance) else number(tolerance)}"
    label += f", at least {steps} steps a frame" if steps > 1 else ""
    work = (TOLERANCES[0] / tolerance) ** (1.0 / (plugin.order + 1))
    return Setting(label, steps, {"tolerance": tolerance}, tolerance, work)


def at_steps(frame: float, solver: Solver, steps: int, residual: float | None = None) -> Setting:
    """A setting of so many steps a frame [s], and of an implicit solver's residual."""
    dt, limit = frame / steps, solver.limit.dt if solver.kind == "fixed steps" else math.inf
    label = f"dt {dt * 1e3:.4g} ms" if dt < 1.0 else f"dt {dt:.4g} s"
    share = dt / limit if 0.0 < limit < math.inf else None
    label += "" if share is None else f", {number(share)} of limit"
    label += "" if residual is None else f"{RESIDUAL}{residual:.1e}"
    fields = {} if residual is None else {"residual": residual}
    return Setting(label, steps, fields, dt, float(steps), dt > limit * (1.0 + ROUNDING), share=share)


def has_residual(solver: Solver) -> bool:
    """Whether it has a residual to choose: where the step alone decides what a method resolves, there is none."""
    return "residual" in solver.plugin.Config.model_fields and math.isinf(solver.limit.resolved)


def _settings(frame: float, solver: Solver) -> list[Setting]:
    """From coarse to fine: tolerances, steps within and beyond the limit, or steps with a residual."""
    plugin, limit = solver.plugin, solver.limit
    if solver.kind == "adaptive":
        if "tolerance" not in plugin.Config.model_fields:
            raise BadInput("it chooses its own steps, and has no `tolerance` to sweep")
        return [at_tolerance(plugin, value) for value in TOLERANCES]
    if solver.kind != "fixed steps":
        if not has_residual(solver):
            return [at_steps(frame, solver, steps) for steps in FEW]
        # A force that is missing by a share r moves the solution by a share of order r however small the step, while
        # the step's error falls as its power `order`: so r falls by that power too, or it would end the convergence.
        start, power = float(plugin.Config.model_fields["residual"].default), max(1, solver.order)
        return [at_steps(frame, solver, steps, max(TIGHTEST_RESIDUAL, start / steps**power)) for steps in FEW]
    shares = [math.ceil(frame / (share * limit.dt) * (1.0 - ROUNDING)) for share in SHARES if limit.dt > 0.0]
    counts = {max(1, count) for count in shares}
    if len(counts) < 3:
        counts |= set(FEW)
    # Where no step at all is stable, all of them are beyond the limit already.
    # The fastest oscillation bears about this step in most methods: where the limit is far below it, as that of
    # explicit Euler, failure is cheaper to show there.
    oscillation = 1.8 / limit.omega if limit.omega > 0.0 and limit.dt * limit.omega < 0.2 else 0.0
    beyond = max(BEYOND * limit.dt, oscillation)
    if limit.dt > 0.0 and math.isfinite(beyond) and frame >= beyond:
        counts.add(math.floor(frame / beyond))
    return [at_steps(frame, solver, count) for count in sorted(counts)]


@dataclass(frozen=True)
class OwnSettings:
    """The points of a sweep that are the scene as it is, and the scene with a step twice as large.

    setting  label of the scene's own point; empty where `why` says that there is none
    larger   how the other differs, in words: "a step twice as large"
    coarser  label of that point; empty where `larger` says why it is not run
    """

    solver: str
    setting: str = ""
    why: str = ""
    larger: str = ""
    coarser: str = ""

    @property
    def loose(self) -> frozenset[tuple[str, str]]:
        """Keys of points whose error is not that of their step alone: the scene's residual stays as it is."""
        return frozenset((self.solver, label) for label in (self.setting, self.coarser) if RESIDUAL in label)


def add_own(problem: AnyProblem, solvers: Sequence[Solver]) -> tuple[list[Solver], OwnSettings]:
    """The solvers, the scene's own with its two settings among the others; they are run before all others."""
    name = problem.preset[0]
    found = next((solver for solver in solvers if solver.name == name), None)
    if found is None:
        return list(solvers), OwnSettings(name, why="it is not among the solvers that are swept")
    try:
        steps = problem.own_steps(found.limit)
    except BadInput as error:
        return list(solvers), OwnSettings(name, why=error.problem)
    own, coarser, larger = _tolerances(found, steps) if found.kind == "adaptive" else _steps(problem, found, steps)
    chosen = [replace(one, first=True) for one in (own, coarser) if one is not None]
    labels = {one.label for one in chosen}
    others = [one for one in found.settings if one.label not in labels]
    settings = tuple(sorted([*chosen, *others], key=lambda one: -one.finer))
    swept = [replace(one, settings=settings) if one is found else one for one in solvers]
    return swept, OwnSettings(name, own.label, "", larger, coarser.label if coarser else "")


def _tolerances(solver: Solver, steps: int) -> tuple[Setting, Setting | None, str]:
    """Return settings with a solver's tolerance and a looser one, and the longest step that the scene allows."""
    tolerance = float(solver.config(Setting("", 1)).model_dump()["tolerance"])
    own, said = at_tolerance(solver.plugin, tolerance, steps), f"{LOOSER:g} times the tolerance"
    if LOOSER * tolerance > 1.0:
        return own, None, f"{said} is above 1, which no tolerance may be"
    return own, at_tolerance(solver.plugin, LOOSER * tolerance, steps), said


def _steps(problem: AnyProblem, solver: Solver, steps: int) -> tuple[Setting, Setting | None, str]:
    """Return settings with a solver's steps a frame and half as many, rounded up, and the scene's own residual."""
    residual = float(solver.config(Setting("", steps)).model_dump()["residual"]) if has_residual(solver) else None
    own, said = at_steps(problem.frame, solver, steps, residual), "a step twice as large"
    if steps == 1:
        return own, None, f"{said} is longer than a frame, which it must divide"
    fewer = math.ceil(steps / 2)
    if steps % 2:
        said = f"a step {number(steps / fewer)} times as large (whole steps make a frame)"
    coarser = at_steps(problem.frame, solver, fewer, residual)
    if coarser.beyond:
        limits = f"{1e3 * coarser.finer:.4g} ms; at most {1e3 * solver.limit.dt:.4g} ms are stable"
        return own, None, f"{said} is above the stability limit ({limits})"
    return own, coarser, said
