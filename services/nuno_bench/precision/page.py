"""What `nuno bench precision` shows: one set of tables and panels for page, screen, documentation and rerun file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from nuno_bench.precision.errors import POSITIONS, Error
from nuno_bench.precision.findings import (
    ABOVE,
    CHOICE_HEADINGS,
    FLOOR_HEADINGS,
    ORDER_HEADINGS,
    by_solver,
    choice_rows,
    judge,
    order_rows,
)
from nuno_bench.precision.own import Own, describe
from nuno_bench.precision.point import Point
from nuno_bench.precision.sweep import Sweep
from nuno_bench.problem.dye import AMOUNTS, DYE_OBSERVABLES
from nuno_bench.problem.horizon import LOST, Horizon
from nuno_bench.problem.observe import OBSERVABLES
from nuno_bench.report.page import Facts, Figure, Part, Table
from nuno_bench.report.plots import INK, MARKERS, Curve, Panel, draw
from nuno_bench.report.result import number


@dataclass(frozen=True)
class Kind:
    """What is compared of a scene.

    leading   the quantity of every vertex or cell
    farthest  what its largest error is called
    titles    of the figures, by quantity
    scales    what errors are shares of, in a sentence
    """

    leading: str
    farthest: str
    titles: Mapping[str, str]
    scales: str


CLOTH = Kind(
    POSITIONS,
    "farthest",
    {POSITIONS: "positions: error / size"} | {name: f"{name}: {text}" for name, text in OBSERVABLES.items()},
    "Errors are shares of the cloth's size (positions, centre of mass, drop), of the largest change of any kind of "
    "energy (energy), or strains; each is the root mean square over the frames.",
)
DYE = Kind(
    AMOUNTS,
    "largest",
    {AMOUNTS: "amounts: error / their root mean square"} | {n: f"{n}: {text}" for n, text in DYE_OBSERVABLES.items()},
    "Errors are shares of the largest root mean square of the cells' amounts (amounts, mobile and fixed dye of every "
    "cell), of all dye (mobile, fixed), or of the largest spread (spread); each is the root mean square over the "
    "frames.",
)
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
COUNTED = ("steps", "stages", "rejected_steps", "newton_steps", "linear_iterations", "evaluations")


@dataclass(frozen=True)
class Findings:
    """One scene's sweep with all that it was judged by.

    floors   disagreement of the references by quantity
    shown    observables that are plotted
    frame    length of a frame [s]
    own      which points are the scene as it is
    """

    scene: str
    sweep: Sweep
    floors: Mapping[str, Error]
    horizon: Horizon
    how: str
    shown: Sequence[str]
    about: Mapping[str, str]
    frame: float
    own: Own
    kind: Kind = CLOTH

    @property
    def points(self) -> list[Point]:
        return self.sweep.points

    @property
    def quantities(self) -> list[str]:
        """That of every vertex or cell where it can be compared, then the observables shown.

        Orders are fitted in the first.
        """
        return [name for name in (self.kind.leading, *self.shown) if name in self.floors]


def own_sentence(found: Findings) -> str:
    """What the scene as it is costs and delivers, and what it would with a step twice as large."""
    leading = found.quantities[0]
    return describe(found.own, found.sweep, leading, found.floors[leading].l2)


def choices(found: Findings) -> Table:
    """The fastest solver by quantity and accuracy."""
    rows = [[name, *row] for name in found.quantities for row in choice_rows(found.points, name, found.floors[name].l2)]
    said = "The fastest solver whose error is within each accuracy, and the next ones. Of the times: "
    return Table(("in", *CHOICE_HEADINGS), rows, f"{said}{found.about['load']}.")


def verdicts(found: Findings) -> Table:
    """Whether the reference can judge each quantity."""
    said = f"Reference: {found.how}. Floor: how far the two are apart; errors above {ABOVE:g} times that are known. "
    return Table(FLOOR_HEADINGS, [one.row() for one in judge(found.points, found.floors)], said + VERDICTS)


def orders(found: Findings) -> Table:
    """The order that each solver shows."""
    name, sweep = found.quantities[0], found.sweep
    rows = order_rows(found.points, name, found.floors[name].l2, sweep.first_calls, found.own.loose)
    return Table(ORDER_HEADINGS, rows, f"Order seen: slope of the error in {name}.")


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
    leading = found.kind.leading if found.kind.leading in found.floors else ""
    observed = [name for name in found.floors if name != leading]
    counted = [name for name in COUNTED if any(name in point.totals for point in found.points)]
    rows = []
    for point in (point for own in by_solver(found.points).values() for point in own):
        errors = [point.error(name) for name in observed]
        if leading:
            error = point.errors.get(leading)
            errors[:0] = [error.final, error.l2, error.linf] if error else [None] * 3
        spread = f"{number(min(point.seconds))} - {number(max(point.seconds))}" if len(point.seconds) > 1 else ""
        counts = [f"{point.totals[name]:,}" if name in point.totals else "" for name in counted]
        shown = [f"{error:.2e}" if error is not None else "" for error in errors]
        rows.append([point.solver, point.setting, point.outcome, _time(point), spread, *shown, *counts])
    names = ["final", "l2", found.kind.farthest] if leading else []
    names += [*observed, *(name.replace("_", " ") for name in counted)]
    return Table(["solver", "setting", "outcome", "time [s]", "min - max", *names], rows, ERRORS)


def _time(point: Point) -> str:
    return number(point.median) if point.seconds else ""


def figure(found: Findings, names: Sequence[str], caption: str) -> Figure:
    """Errors in some quantities over wall time."""
    return Figure(
        draw([over_wall_time(found, name) for name in names], height=3.9 if len(names) == 1 else 3.0), caption
    )


def over_wall_time(found: Findings, name: str) -> Panel:
    """A curve per solver; a point that did not reach its end has no error, and stands above the panel."""
    timed = [point for point in found.points if point.seconds]
    curves = []
    for i, (solver, own) in enumerate(by_solver(timed).items()):
        errors = [math.inf if not point.done else _or_nan(point.error(name)) for point in own]
        curves.append(
            Curve(solver, np.array([point.median for point in own]), np.array(errors), i,
                  marker=MARKERS[i % len(MARKERS)], hollow=[point.beyond for point in own],
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
    return Panel(found.kind.titles[name], curves, "wall time [s]", log="xy")


def _or_nan(error: float | None) -> float:
    return math.nan if error is None else error


def over_frames(found: Findings, name: str) -> Panel:
    """The error of every run at each compared frame but the first."""
    curves = []
    for i, own in enumerate(by_solver(found.points).values()):
        for point in (point for point in own if point.history.get(name)):
            t = found.frame * np.arange(1.0, len(point.history[name]) + 1.0)
            curves.append(Curve(f"{point.solver}, {point.setting}", t, np.array(point.history[name]), i))
    return Panel(f"{name} over simulated time", curves, "simulated time [s]", "error", log="y")


def tabs(found: Sequence[Findings]) -> dict[str, list[Panel]]:
    """All panels by scene and quantity."""
    return {
        f"{one.scene}, {name}": [over_wall_time(one, name), over_frames(one, name)]
        for one in found
        for name in one.quantities
    }


def sections(found: Findings) -> Iterator[tuple[str, list[Part]]]:
    """The page's."""
    name = found.kind.leading
    yield "", [own_sentence(found)]
    yield "Which solver for which accuracy", [choices(found), verdicts(found)]
    caption = f"{name.capitalize()} are compared over {found.horizon.describe()}. {MARKED} {FLOOR}"
    shown: Part = f"Positions cannot be compared: a disturbance passes {LOST:g} of the size in the first frame."
    if name in found.floors:
        shown = figure(found, [name], caption)
    yield f"{name.capitalize()}, inside the predictable time", [shown, orders(found)]
    if observed := [name for name in found.quantities if name != found.kind.leading]:
        observables = figure(found, observed, "Beyond the predictable time too. Marks as above.")
        yield "What is observed, over the whole run", [observables]
    for heading, table in (("Failures and divergences", failures(found)), ("Left out", left_out(found))):
        if table.rows:
            yield heading, [table]
    yield "All points", [every_point(found)]
    yield "Made by", [Facts(found.about)]


def document(found: Findings) -> list[Part]:
    """What goes into a documentation page's section: the leading quantity, and what is named once a solver."""
    name = found.quantities[0]
    chosen, failed = choices(found), failures(found)
    chosen = replace(chosen, rows=[row for row in chosen.rows if row[0] == name])
    failed = replace(failed, rows=list({row[0]: row for row in reversed(failed.rows)}.values())[::-1])
    return [
        f"Reference: {found.how}, {found.floors[name].l2:.1e} apart in {name}. "
        f"Predictable: {found.horizon.describe()}.",
        figure(found, [name], f"Error in {name} over wall time"),
        *(table for table in (chosen, orders(found), failed, left_out(found)) if table.rows),
        Facts(found.about),
    ]


def lines(found: Findings) -> Table:
    """The CSV's: a line per point and quantity."""
    rows = []
    for p in found.points:
        start = [p.solver, p.setting, p.outcome, f"{p.median:.6g}" if p.seconds else ""]
        errors = [[name, *(f"{v:.9g}" for v in (e.final, e.l2, e.linf))] for name, e in p.errors.items()]
        rows += [[*start, *rest] for rest in errors or [[""] * 4]]
    return Table(("solver", "setting", "outcome", "seconds", "quantity", "final", "l2", "linf"), rows)


def data(found: Findings) -> dict[str, Any]:
    """All that was found, for JSON; nuno_bench.precision.compare reads it."""
    horizon = {name: value for name, value in vars(found.horizon).items() if name != "fades"}
    return {
        "about": dict(found.about),
        "scene": found.scene,
        "reference": {"how": found.how, "floors": {name: asdict(floor) for name, floor in found.floors.items()}},
        "horizon": horizon,
        "points": [asdict(point) for point in found.points],
        "own": asdict(found.own) | {"said": own_sentence(found)},
        "omitted": [asdict(one) for one in found.sweep.omitted],
        "first_calls": found.sweep.first_calls,
    }
