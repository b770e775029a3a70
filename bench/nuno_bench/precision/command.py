"""`nuno bench precision SCENE...`: the error of every applicable solver over the wall time it takes."""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from nuno.formatting import duration
from nuno.plugin_contract import registry
from nuno.runtime.consistency import Premises, premises_of
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno.simulation.solver_selection.cloth import decide
from nuno_bench import machine, options
from nuno_bench.precision.sweep import (
    ABOVE,
    CHOICE_HEADINGS,
    FLOOR_HEADINGS,
    Error,
    OwnSettings,
    Runner,
    SolverPoint,
    Sweep,
    add_own,
    by_solver,
    choice_rows,
    choose_solvers,
    fit_order,
    judge,
    measure_errors,
    run_sweep,
    start_sweep,
)
from nuno_bench.problem import AnyProblem, DyeProblem, Problem, pose
from nuno_bench.reference import DISTURBANCE, LOST, Horizon, refer
from nuno_bench.report import page, plots
from nuno_bench.report.page import Figure, Part, Report, Sections, Table, number, spread_of
from nuno_bench.report.plots import INK, Curve, Panel, draw, marker_of
from nuno_bench.sweep.executor import SweepFile, require_kept, versions
from nuno_schemas.errors import BadInput

# What `nuno bench precision` shows: one set of tables and panels for page, screen, documentation and rerun file.

LEAD = "Every solver at a sweep of steps or tolerances: its error against a reference, over the wall time it took. "
FLOOR = (
    "Dashed, the floor: how far the reference and the independent run that checks it are apart; an error near it may "
    "be the reference's own."
)
VERDICTS = (
    "Verdict: judged, where all errors are known; in part, where some are too near the floor to be; failed, where all "
    "are."
)
MARKED = (
    "Bars: all repeats. Hollow: beyond the stability limit, and finished all the same. Crosses above: not finished. "
    "Plus: the scene as it is."
)
ERRORS = (
    "Final: at the last frame of the predictable time; l2: root mean square over its frames; beside it the farthest "
    "vertex or cell of any of them. Observables: root mean square over all frames. Time is the median over repeats, "
    "in the solver's own calls, without compiling; counts are sums over the run."
)
JUMPS = (
    " In this scene there is contact: forces jump where cloth lands, slips or lets go, and over a jump no method has "
    "its order, so that a slope says little of the method."
)
COUNTED = ("steps", "stages", "rejected_steps", "newton_steps", "linear_iterations", "evaluations")


@dataclass(frozen=True)
class Findings:
    """A scene's sweep, and the reference, floors and horizon that judge it.

    floors   disagreement of the references by quantity
    own      which points are the scene as it is
    premises the scene's values by field, in SI units and with all defaults, and the digests of its files
    shown    observables that are plotted; all where none is named
    """

    problem: AnyProblem
    sweep: Sweep
    floors: Mapping[str, Error]
    horizon: Horizon
    how: str
    about: Mapping[str, str]
    own: OwnSettings
    premises: Premises
    shown: Sequence[str] = ()

    @property
    def scene(self) -> str:
        return str(self.problem.loaded.scene.name)

    @property
    def points(self) -> list[SolverPoint]:
        return self.sweep.points

    @property
    def quantities(self) -> list[str]:
        """That of every vertex or cell where it can be compared, then the observables shown.

        Orders are fitted in the first.
        """
        named = (self.problem.leading, *(self.shown or self.problem.observables))
        return [name for name in named if name in self.floors] or list(self.floors)

    @property
    def own_sentence(self) -> str:
        """Error and run time of the scene as it is, and with a step twice as large, in one sentence."""
        name = self.quantities[0]
        return describe_own(self.own, self.sweep, name, self.floors[name].l2)


def describe_own(own: OwnSettings, sweep: Sweep, quantity: str, floor: float) -> str:
    """Return error in a quantity and run time, by the scene's own step and one twice as large, in one sentence."""
    if not own.setting:
        return f"This scene as it is ({own.solver}) has no point: {own.why}."
    found = {point.key: point for point in sweep.points}
    first, second = (found.get((own.solver, label)) for label in (own.setting, own.coarser))
    said = f"This scene as it is ({own.solver}, {own.setting}): {_result(first, own.setting, own, sweep, quantity)}"
    if not own.coarser:
        return f"{said}; {own.larger}."
    said += f"; with {own.larger} ({own.coarser}): {_result(second, own.coarser, own, sweep, quantity, first)}."
    errors = [error for point in (first, second) if point and (error := point.error(quantity)) is not None]
    if any(error <= ABOVE * floor for error in errors):
        said += f" Errors below {ABOVE * floor:.1e} are not known: the references themselves are {floor:.1e} apart."
    return said


def _result(
    point: SolverPoint | None,
    setting: str,
    own: OwnSettings,
    sweep: Sweep,
    quantity: str,
    base: SolverPoint | None = None,
) -> str:
    """Error and run time of a point, with what multiples of the base point's they are; or why it has none."""
    if point is None:
        reasons = (one.reason for one in sweep.omitted if one.solver == own.solver and one.setting in ("", setting))
        return f"not run, {next(reasons, 'no reason is known')}"
    if not point.done:
        return f"{point.outcome} ({point.message})" if point.message else point.outcome
    error, before = point.error(quantity), base.error(quantity) if base else None
    parts = [f"error in {quantity} {error:.2e}{_times(error, before)}"] if error is not None else []
    if point.seconds:
        parts.append(f"run time {number(point.median)} s{_times(point.median, base.median if base else None)}")
    return ", ".join(parts)


def _times(value: float, base: float | None) -> str:
    return f" ({number(value / base)} times)" if base and math.isfinite(base) else ""


def choices(found: Findings) -> Table:
    """The fastest solver by quantity and accuracy."""
    rows = [[name, *row] for name in found.quantities for row in choice_rows(found.points, name, found.floors[name].l2)]
    said = "The fastest solver whose error is within each accuracy, and the next ones. Of the times: "
    return Table(("in", *CHOICE_HEADINGS), rows, f"{said}{found.about['load']}.")


def verdicts(found: Findings) -> Table:
    """Whether the reference can judge each quantity."""
    said = f"Reference: {found.how}. Floor: how far the two are apart; errors above {ABOVE:g} times that are known. "
    return Table(FLOOR_HEADINGS, judge(found.points, found.floors), said + VERDICTS)


def orders(found: Findings) -> Table:
    """The order that each solver shows; none is fitted to points whose error is not that of their step alone."""
    name, rows = found.quantities[0], []
    for solver, own in by_solver(found.points).items():
        fitted = [point for point in own if point.key not in found.own.loose]
        slope = fit_order(fitted, name, found.floors[name].l2)
        seen = "" if slope is None else f"{slope:.2f}" + " of the tolerance" * (own[0].kind == "adaptive")
        failed, first = sum(not point.done for point in own), found.sweep.first_calls.get(solver)
        rows.append([solver, own[0].kind, str(own[0].order or "not stated"), seen,
                     "" if first is None else number(first), str(len(own)), str(failed or "")])  # fmt: skip
    headings = ("solver", "kind", "nominal order", "seen", "first call [s]", "points", "not done")
    loaded = found.problem.loaded
    jumps = JUMPS if loaded.colliders or loaded.cloth_contact else ""
    return Table(headings, rows, f"Order seen: slope of the error in {name}.{jumps}")


def failures(found: Findings) -> Table:
    """A line for each point that did not reach its end."""
    rows = [[p.solver, p.setting, p.outcome, p.message, _time(p)] for p in found.points if not p.done]
    said = "Crosses above the figures stand for these, at the time they took."
    return Table(("solver", "setting", "outcome", "why", "time [s]"), rows, said, prose=True)


def left_out(found: Findings) -> Table:
    """A line per solver: the coarsest setting that was not run, how many finer ones were not either, and why."""
    rows: dict[str, list[str]] = {}
    finer: dict[str, int] = {}
    for one in found.sweep.omitted:
        if one.solver in rows:
            finer[one.solver] = finer.get(one.solver, 0) + 1
        rows.setdefault(one.solver, [one.solver, one.setting or "all", one.reason])
    for solver, count in finer.items():
        rows[solver][1] += f" and {count} finer"
    return Table(("left out", "settings", "why"), list(rows.values()), "Not run.", prose=True)


def every_point(found: Findings) -> Table:
    """A line per point with its errors, its times and what it counted, solver by solver from coarse to fine."""
    leading = found.problem.leading if found.problem.leading in found.floors else ""
    observed = [name for name in found.floors if name != leading]
    counted = [name for name in COUNTED if any(name in point.totals for point in found.points)]
    rows = []
    for point in (point for own in by_solver(found.points).values() for point in own):
        errors = [point.error(name) for name in observed]
        if leading:
            error = point.errors.get(leading)
            errors[:0] = [error.final, error.l2, error.linf] if error else [None] * 3
        counts = [f"{point.totals[name]:,}" if name in point.totals else "" for name in counted]
        shown = [f"{error:.2e}" if error is not None else "" for error in errors]
        spread = spread_of(point.seconds) if point.seconds else ""
        rows.append([point.solver, point.setting, point.outcome, _time(point), spread, *shown, *counts])
    names = ["final", "l2", "farthest"] if leading else []
    names += [*observed, *(name.replace("_", " ") for name in counted)]
    return Table(["solver", "setting", "outcome", "time [s]", "min - max", *names], rows, ERRORS)


def _time(point: SolverPoint) -> str:
    return number(point.median) if point.seconds else ""


def figure(found: Findings, names: Sequence[str], caption: str, name: str = "") -> Figure:
    """Errors in some quantities over wall time."""
    panels = [over_wall_time(found, name) for name in names]
    return Figure(draw(panels, height=3.9 if len(names) == 1 else 3.0), caption, name)


def over_wall_time(found: Findings, name: str) -> Panel:
    """A curve per solver; a point that did not reach its end has no error, and stands above the panel."""
    timed = [point for point in found.points if point.seconds]
    curves = []
    for i, (solver, own) in enumerate(by_solver(timed).items()):
        errors = [math.inf if not point.done else _or_nan(point.error(name)) for point in own]
        curves.append(
            Curve(solver, np.array([point.median for point in own]), np.array(errors), i,
                  marker=marker_of(i), hollow=[point.beyond for point in own],
                  spread=[(min(point.seconds), max(point.seconds)) for point in own],
                  labels=[point.setting for point in own])
        )  # fmt: skip
    for point in timed:
        if point.key == (found.own.solver, found.own.setting) and point.done:
            at = np.array([point.median]), np.array([_or_nan(point.error(name))])
            curves.append(Curve("this scene as it is", *at, INK, marker="+", size=13.0, loose=True))
    if timed:
        ends = np.array([min(point.median for point in timed), max(point.median for point in timed)])
        curves.append(Curve("floor", ends, np.full(2, found.floors[name].l2), INK, dashed=True))
    what = found.problem.observables.get(name)
    title = f"{name}: {what}" if what else f"{name}: error / scale"
    return Panel(title, curves, "wall time [s]", log="xy")


def _or_nan(error: float | None) -> float:
    return math.nan if error is None else error


def over_frames(found: Findings, name: str) -> Panel:
    """The error of every run at each compared frame but the first."""
    curves = []
    for i, own in enumerate(by_solver(found.points).values()):
        for point in (point for point in own if point.history.get(name)):
            t = found.problem.frame * np.arange(1.0, len(point.history[name]) + 1.0)
            curves.append(Curve(f"{point.solver}, {point.setting}", t, np.array(point.history[name]), i))
    return Panel(f"{name} over simulated time", curves, "simulated time [s]", "error", log="y")


def tabs(found: Findings) -> dict[str, list[Panel]]:
    """All panels by scene and quantity."""
    panels = {name: [over_wall_time(found, name), over_frames(found, name)] for name in found.quantities}
    return {f"{found.scene}, {name}": both for name, both in panels.items()}


def _rows(point: SolverPoint) -> list[dict[str, Any]]:
    """A line per quantity, with the step [s] and its share of the stability limit, or the tolerance; one where there is
    none.
    """
    start: dict[str, Any] = {name: getattr(point, name) for name in ("solver", "setting")}
    of_step = {"dt": point.finer, "share_of_limit": point.share, "tolerance": ""}
    start |= {"dt": "", "share_of_limit": "", "tolerance": point.finer} if point.kind == "adaptive" else of_step
    start |= {"outcome": point.outcome, "seconds": point.median if point.seconds else ""}
    return [start | {"quantity": name} | vars(error) for name, error in point.errors.items()] or [start]


def report(found: Findings) -> Report:
    """The page; all that was found, which nuno_bench.precision.compare reads; and the documentation's section, which
    has the leading quantity, and what is named once a solver.
    """
    name, problem, horizon = found.problem.leading, found.problem, found.horizon
    observed = [one for one in found.quantities if one != name]
    shown: list[Part] = [f"Positions cannot be compared: a disturbance passes {LOST:g} of the size in the first frame."]
    if name in found.floors:
        caption = f"{name.capitalize()} are compared over {horizon.describe()}. {MARKED} {FLOOR}"
        shown = [figure(found, [name], caption, f"precision-{found.scene}-{name}")]
    beyond = "Beyond the predictable time too. Marks as above."
    watched = [figure(found, observed, beyond, f"precision-{found.scene}-observed")] if observed else []
    sections: Sections = [
        ("", [found.own_sentence]),
        ("Which solver for which accuracy", [choices(found), verdicts(found)]),
        (f"{name.capitalize()}, inside the predictable time", [*shown, orders(found)]),
        ("What is observed, over the whole run", watched),
        ("Failures and divergences", [failures(found)]),
        ("Left out", [left_out(found)]),
        ("All points", [every_point(found)]),
    ]
    first, chosen, failed = found.quantities[0], choices(found), failures(found)
    brief: list[Part] = [
        f"Reference: {found.how}, {found.floors[first].l2:.1e} apart in {first}. Predictable: {horizon.describe()}.",
        figure(found, [first], f"Error in {first} over wall time"),
        replace(chosen, rows=[row for row in chosen.rows if row[0] == first]),
        orders(found),
        replace(failed, rows=list({row[0]: row for row in reversed(failed.rows)}.values())[::-1]),
        left_out(found),
    ]
    data = {
        "scene": found.scene,
        "premises": found.premises,
        "reference": {"how": found.how, "floors": found.floors},
        "horizon": {key: value for key, value in vars(horizon).items() if key != "fades"},
        "points": found.points,
        "own": vars(found.own) | {"said": found.own_sentence},
        "omitted": found.sweep.omitted,
        "first_calls": found.sweep.first_calls,
    }
    lead, rows = LEAD + problem.scaled, [row for point in found.points for row in _rows(point)]
    return Report(f"Error over wall time: {found.scene}", lead, sections, found.about, data, brief, rows)


def precision_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_shared(parser, "scenes", "--set", "--solvers", "--resume", "--out", "--rrd", "--docs")
    options.add_count(parser, "--repeats", "timed runs of each point (default: %(default)s)", 3)
    budget = "for a scene's sweep; finer points that would exceed it are left out"
    options.add_seconds(parser, "--budget", 120.0, budget)
    parser.add_argument("--duration", metavar="TIME", help="simulated time, instead of the scene's")
    known = f"{', '.join(Problem.observables)}; of dye {', '.join(DyeProblem.observables)}"
    parser.add_argument("--observable", metavar="A,B", help=f"what is plotted beside positions (default: all): {known}")


def precision_command(args: argparse.Namespace) -> int:
    """Sweep each scene; 1 where a reference could judge nothing. A solver that diverges is a result."""
    failed, panels = False, dict[str, list[plots.Panel]]()
    for one in _check(args):
        found, name = sweep_scene(one, args), one.scene.name
        print(f"\n{found.own_sentence}")
        print(f"\n{name}: {found.how}\npredictable: {found.horizon.describe()}")
        print(choices(found).text())
        print(f"of the times: {found.about['load']}")
        print(verdicts(found).text())
        print(f"{len(found.points)} points, {sum(not p.done for p in found.points)} of them failed; "
              f"{len(found.sweep.omitted)} left out")  # fmt: skip
        report(found).write_beside(args.out / f"precision-{name}", args.docs, f"precision {name}")
        panels |= tabs(found)
        if all(judgement.verdict in ("failed", "no point") for judgement in judge(found.points, found.floors)):
            print(f"{name}: the reference judges no point", file=sys.stderr)
            failed = True
    if args.rrd is not None:
        from nuno_bench.report import rerun

        rerun.write(args.rrd, "nuno bench precision", panels)
    return int(failed)


def _check(args: argparse.Namespace) -> list[Loaded]:
    """The scenes. Raises BadInput before anything runs."""
    plots.require_drawing(args.rrd)
    overrides = [*args.overrides, *([f"duration={args.duration}"] if args.duration else []), "allow_unstable=true"]
    loaded = [decide(scene_file.read(shipped.find(name), overrides)) for name in args.scenes]
    kinds = {DyeProblem if one.solver is None else Problem for one in loaded}
    solvers = [list(registry.installed(kind.group)) for kind in kinds]
    observables = [list(kind.observables) for kind in kinds]
    for field, given, each in (("--solvers", args.solvers, solvers), ("--observable", args.observable, observables)):
        wanted, known = options.names_of(given), [name for names in each for name in names]
        options.require_known(wanted, known, field.removeprefix("--").removesuffix("s"), field)
        if given is not None and not wanted:
            raise BadInput("none is named: the sweep would be empty", field=field, value=given)
        if wanted and not all(set(wanted) & set(names) for names in each):
            remedy = "name some of both, or give scenes of cloth and scenes of dye by turns"
            raise BadInput("one of the scenes has none of these", field=field, value=given, remedy=remedy)
    names = [one.scene.name for one in loaded]
    if len(set(names)) < len(names):
        raise BadInput("two scenes have one name, and would write the same files", field="SCENE", value=names)
    for name in names:
        page.check_section(args.docs, f"precision {name}")
    if args.resume:
        require_kept([args.out / f"precision-{name}.jsonl" for name in names])
    return loaded


def _own(text: str | None, known: Collection[str]) -> list[str]:
    """Return the names that are known: scenes of cloth and of dye have different ones."""
    return [name for name in options.names_of(text) if name in known]


def sweep_scene(loaded: Loaded, args: argparse.Namespace) -> Findings:
    """Reference, horizon and sweep of one scene. Raises BadInput."""
    say = partial(print, f"{loaded.scene.name}:", file=sys.stderr)
    others, path = machine.OtherLoad(), args.out / f"precision-{loaded.scene.name}.jsonl"
    digest = hashlib.blake2b(json.dumps(loaded.data, sort_keys=True, default=str).encode(), digest_size=16).hexdigest()
    kept = SweepFile(path, {"scene": digest, "repeats": args.repeats, "versions": versions()}, args.resume, say)
    say(f"at most {duration(args.budget)} for the points, and as much for each run of the reference; --resume goes on "
        f"from {path}")  # fmt: skip
    problem, premises = pose(loaded), premises_of(loaded, resumes=False)
    solvers, omitted = choose_solvers(problem, _own(args.solvers, registry.installed(problem.group)))
    solvers, own = add_own(problem, solvers)
    sweep = start_sweep(problem, solvers, say)
    sweep.omitted[:0] = omitted
    reference, horizon = refer(problem, args.budget, say)
    scales = problem.scales(reference.run.series)
    floors = measure_errors(reference.check.series, reference.run.series, scales, horizon.frames)
    runner = Runner(problem, reference, scales, horizon.frames, args.repeats)
    with kept:
        run_sweep(sweep, runner, solvers, kept, args.budget, say)
    disturbed = "" if horizon.fades else f"; disturbance {DISTURBANCE:g} of the size"
    about = machine.about(
        others,
        scene=f"{problem.describe()}, {problem.frames} frames, {problem.frames * problem.frame:.3g} s",
        reference=f"{reference.how}; {reference.seconds:.2g} s for both{disturbed}",
    )
    watched = _own(args.observable, problem.observables)
    return Findings(problem, sweep, floors, horizon, reference.how, about, own, premises, watched)
