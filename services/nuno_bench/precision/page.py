"""The page of `nuno bench precision`, and the same tables for the screen and for documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nuno_bench.precision.errors import POSITIONS, Error
from nuno_bench.precision.findings import (
    ABOVE,
    CHOICE_HEADINGS,
    FLOOR_HEADINGS,
    ORDER_HEADINGS,
    choice_rows,
    judge,
    order_rows,
    solvers_of,
)
from nuno_bench.precision.own import Own, describe
from nuno_bench.precision.plots import Panel, error_over_time
from nuno_bench.precision.point import Point
from nuno_bench.precision.sweep import Sweep
from nuno_bench.problem.dye import AMOUNTS, DYE_OBSERVABLES
from nuno_bench.problem.horizon import LOST, Horizon
from nuno_bench.problem.observe import OBSERVABLES
from nuno_bench.report import markdown, page
from nuno_bench.report.result import number

LEAD = "Every solver at a sweep of steps or tolerances: its error against a reference, over the wall time it took. "


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
FLOOR = (
    "Dotted, the floor: how far the reference and the independent run that checks it are apart; an error near it may "
    "be the reference's own."
)
VERDICTS = (
    "Verdict: judged, where all errors are known; in part, where some are too near the floor to be; failed, where all "
    "are."
)
FAILURES = "Crosses above the figures stand for these, at the time they took."
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
        """That of every vertex or cell where it can be compared, then the observables shown."""
        return [name for name in (self.kind.leading, *self.shown) if name in self.floors]

    @property
    def leading(self) -> str:
        """The quantity that orders are fitted in."""
        return self.quantities[0]


def render(found: Findings) -> str:
    """The whole page."""
    order = solvers_of(found.points)
    sections: list[tuple[str, Sequence[page.Part]]] = [
        ("", [own_sentence(found)]),
        ("Which solver for which accuracy", [_choices(found), _verdicts(found)]),
        (f"{found.kind.leading.capitalize()}, inside the predictable time", _leading(found, order)),
    ]
    panels = [_panel(found, name) for name in found.shown if name in found.floors]
    if panels:
        figure = page.Figure(
            error_over_time(found.points, panels, order, _own(found)),
            "Beyond the predictable time too. Marks as above.",
        )
        sections.append(("What is observed, over the whole run", [figure]))
    failed = [[p.solver, p.setting, p.outcome, p.message, _time(p)] for p in found.points if not p.done]
    if failed:
        table = page.Table(("solver", "setting", "outcome", "why", "time [s]"), failed, FAILURES, prose=True)
        sections.append(("Failures and divergences", [table]))
    if found.sweep.omitted:
        table = page.Table(("solver", "settings", "reason"), left_out(found), "Not run, coarsest first.", prose=True)
        sections.append(("Left out", [table]))
    errors, costs = page.Table(*error_table(found), _ERRORS), page.Table(*cost_table(found), _COSTS)
    sections.append(("All points", [errors, costs]))
    sections.append(("Made by", [page.Facts(found.about)]))
    return page.render(f"Error over wall time: {found.scene}", LEAD + found.kind.scales, sections)


def own_sentence(found: Findings) -> str:
    """What the scene as it is costs and delivers, and what it would with a step twice as large."""
    return describe(found.own, found.sweep, found.leading, found.floors[found.leading].l2)


_ERRORS = (
    "Final: at the last frame of the predictable time; l2: root mean square over its frames; beside it the farthest "
    "vertex or cell of any of them. Observables: root mean square over all frames."
)
_COSTS = "Time is the median over repeats, in the solver's own calls, without compiling."


def left_out(found: Findings) -> list[list[str]]:
    """A line per solver: which settings were not run, and why the first of them was not."""
    rows: dict[str, list[str]] = {}
    for one in found.sweep.omitted:
        known = rows.setdefault(one.solver, [one.solver, one.setting or "all", one.reason])
        if one.setting and known[1] != one.setting:
            known[1] += f"; {one.setting}"
    return list(rows.values())


def _verdicts(found: Findings) -> page.Table:
    rows = [judgement.row() for judgement in judge(found.points, found.floors)]
    said = f"Reference: {found.how}. Floor: how far the two are apart; errors above {ABOVE:g} times that are known. "
    return page.Table(FLOOR_HEADINGS, rows, said + VERDICTS)


def _choices(found: Findings) -> page.Table:
    headings, rows = choices(found)
    said = "The fastest solver whose error is within each accuracy, and the next ones. Of the times: "
    return page.Table(headings, rows, f"{said}{found.about['load']}.")


def choices(found: Findings) -> tuple[Sequence[str], list[list[str]]]:
    """Headings and rows of the fastest solver by quantity and accuracy."""
    rows = [[name, *row] for name in found.quantities for row in choice_rows(found.points, name, found.floors[name].l2)]
    return ("in", *CHOICE_HEADINGS), rows


def _leading(found: Findings, order: Sequence[str]) -> list[page.Part]:
    orders = page.Table(ORDER_HEADINGS, orders_of(found), f"Order seen: slope of the error in {found.leading}.")
    name = found.kind.leading
    if name not in found.floors:
        gone = f"Positions cannot be compared: a disturbance passes {LOST:g} of the size in the first frame."
        return [gone, orders]
    caption = (
        f"{name.capitalize()} are compared over {found.horizon.describe()}. Bars: all repeats. Hollow: beyond the "
    )
    caption += (
        "stability limit, and finished all the same. Crosses: not finished, see below. Ring: the scene as it is. "
    )
    caption += FLOOR
    return [page.Figure(error_over_time(found.points, [_panel(found, name)], order, _own(found)), caption), orders]


def orders_of(found: Findings) -> list[list[str]]:
    """Rows under ORDER_HEADINGS."""
    floor = found.floors[found.leading].l2
    return order_rows(found.points, found.leading, floor, found.sweep.first_calls, found.own.loose)


def _own(found: Findings) -> tuple[str, str]:
    """Key of the scene's own point; that of none where it has none."""
    return found.own.solver, found.own.setting


def _panel(found: Findings, name: str) -> Panel:
    return Panel(name, found.kind.titles[name], found.floors[name].l2)


def error_table(found: Findings) -> tuple[list[str], list[list[str]]]:
    """Headings, and a line per point with its errors, solver by solver."""
    leading = ["final", "l2", found.kind.farthest] if found.kind.leading in found.floors else []
    observed = [name for name in found.floors if name != found.kind.leading]
    headings = ["solver", "setting", "outcome", "time [s]", *leading, *observed]
    return headings, [_errors(found, point) for point in _ordered(found)]


def cost_table(found: Findings) -> tuple[list[str], list[list[str]]]:
    """Headings, and a line per point with its times and what it counted, solver by solver."""
    counted = [name for name in COUNTED if any(name in point.totals for point in found.points)]
    rows = []
    for point in _ordered(found):
        spread = f"{number(min(point.seconds))} - {number(max(point.seconds))}" if len(point.seconds) > 1 else ""
        counts = [f"{point.totals[name]:,}" if name in point.totals else "" for name in counted]
        rows.append([point.solver, point.setting, _time(point), spread, *counts])
    return ["solver", "setting", "time [s]", "min - max", *(name.replace("_", " ") for name in counted)], rows


def _ordered(found: Findings) -> list[Point]:
    """Points solver by solver, from coarse to fine."""
    order = solvers_of(found.points)
    return sorted(found.points, key=lambda point: (order.index(point.solver), -point.finer))


def _errors(found: Findings, point: Point) -> list[str]:
    errors: list[float | None] = []
    if found.kind.leading in found.floors:
        own = point.errors.get(found.kind.leading)
        errors += [own.final, own.l2, own.linf] if own else [None] * 3
    errors += [point.error(name) for name in found.floors if name != found.kind.leading]
    shown = [f"{error:.2e}" if error is not None else "" for error in errors]
    return [point.solver, point.setting, point.outcome, _time(point), *shown]


def _time(point: Point) -> str:
    return number(point.median) if point.seconds else ""


def docs_picture(found: Findings) -> str:
    """A file of SVG: errors in the leading quantity, on white because pages may be dark."""
    figure = error_over_time(found.points, [_panel(found, found.leading)], solvers_of(found.points), _own(found))
    return figure.replace("<svg ", '<svg style="background: #fff" ', 1)


def docs_parts(found: Findings, picture: str) -> list[str]:
    """What goes into a documentation page's section: the leading quantity, and what is named once a solver.

    `picture` is where the page finds its figure.
    """
    name = found.leading
    floor = found.floors[name].l2
    failed: dict[str, list[str]] = {}
    for point in found.points:
        if not point.done:
            failed.setdefault(point.solver, [point.solver, point.setting, point.outcome, point.message])
    said = f"Reference: {found.how}, {floor:.1e} apart in {name}. Predictable: {found.horizon.describe()}."
    parts = [
        said,
        f"![Error in {name} over wall time]({picture})",
        markdown.table((f"error in {name} at most", *CHOICE_HEADINGS[1:]), choice_rows(found.points, name, floor)),
        markdown.table(ORDER_HEADINGS, orders_of(found)),
    ]
    if failed:
        parts.append(markdown.table(("first failure", "setting", "outcome", "why"), list(failed.values())))
    if found.sweep.omitted:
        parts.append(markdown.table(("left out", "settings", "why"), [_shortened(row) for row in left_out(found)]))
    return [*parts, markdown.facts(found.about)]


def _shortened(row: list[str]) -> list[str]:
    """A line of what was left out, its finer settings counted."""
    solver, settings, why = row
    first, *finer = settings.split("; ")
    return [solver, f"{first} and {len(finer)} finer" if finer else first, why]
