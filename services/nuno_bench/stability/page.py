"""What `nuno bench stability` shows: one set of tables and panels for page, screen, documentation and rerun file."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from nuno_bench.report.page import Facts, Figure, Part, Table
from nuno_bench.report.plots import INK, Curve, Panel, draw
from nuno_bench.report.result import number
from nuno_bench.stability.case import ACCURATE, CLASSES, EXACT, LOST, ROUGHNESS, RUNAWAY
from nuno_bench.stability.sweep import Mapped, Row

LEAD = "What each solver makes of the scene at every step and stiffness, above its limit too."
HOW = (
    f"A point is a few frames from a start whose vertices stand up to {ROUGHNESS:g} of the shortest spring off their "
    "places, so that every mode takes part. It is held against an adaptive run at a tight tolerance. It is exact up to "
    f"a distance of {EXACT:g} of how far that run moves, and accurate up to {ACCURATE:g}, unless its energy is off by "
    f"more than that of the motion. Beyond, it is damped away where {LOST:.0%} of that energy is missing, diverged "
    f"where it is not finite or has gained {RUNAWAY:g} times as much, and drifting otherwise. Refused: the solver "
    "itself declined, or did not converge. A scene's own run refuses steps above the line."
)
AXES = {
    "stiffness": "stiffness, as a multiple of the scene's",
    "mesh": "shortest spring [mm]",
}
COLOURS = {
    "exact": "#0072b2",
    "accurate": "#7fc4ee",
    "damped away": "#f0e442",
    "drifting": "#e69f00",
    "diverged": "#b03a00",
    "refused": "#8a8f98",
    "left out": "#c9cdd3",
}
"""After Okabe & Ito 2008; classes also differ in lightness."""
MARKS = {"damped away": "v", "drifting": "o", "diverged": "X", "refused": "_", "left out": "."}
"""Of classes that are not square."""


def summary(found: Mapped) -> str:
    """Points in all, and of each class that occurs."""
    tally = Counter(point.outcome for row in found.rows for point in row.points)
    kinds = ", ".join(f"{tally[name]} {name}" for name in CLASSES if tally[name])
    return f"{number(sum(tally.values()))} points: {kinds}" if tally else "no points"


def counts(rows: Sequence[Row]) -> Table:
    """How many points fell into each class, by map and solver."""
    found: dict[tuple[str, str], Counter[str]] = {}
    for row in rows:
        found.setdefault((row.axis, row.solver), Counter()).update(point.outcome for point in row.points)
    lines = [[*key, *(str(classes[name]) for name in CLASSES)] for key, classes in sorted(found.items())]
    return Table(("map", "solver", *CLASSES), lines, "Points of each class.")


def beyond(rows: Sequence[Row]) -> Table:
    """How the stated limits compare with the maps: points that were lost below, and above, out of all."""
    found: dict[str, list[int]] = {}
    for row in rows:
        if not math.isfinite(row.limit) or row.limit <= 0.0:
            continue
        tally = found.setdefault(row.solver, [0, 0, 0, 0])
        for point in row.points:
            if point.outcome in ("left out", "refused"):
                continue
            above, lost = point.dt > row.limit, point.outcome == "diverged"
            tally[2 * above] += 1
            tally[2 * above + 1] += lost
    lines = [[solver, f"{b} of {a}", f"{d} of {c}"] for solver, (a, b, c, d) in sorted(found.items())]
    return Table(("solver", "lost below its limit", "lost above it"), lines, "Points of all maps. Lost: diverged.")


def place_of(row: Row) -> float:
    """Where a row stands: its factor, or the shortest spring [mm]."""
    return 1e3 * row.edge if row.axis == "mesh" else row.value


def maps(rows: Sequence[Row], axis: str) -> list[Panel]:
    """A panel a solver: its points over axis and step, each class a curve, and the limit that it states."""
    panels = []
    for solver in sorted({row.solver for row in rows if row.axis == axis}):
        own = sorted((row for row in rows if (row.axis, row.solver) == (axis, solver)), key=place_of)
        curves = []
        for name, colour in COLOURS.items():
            points = [(place_of(row), point) for row in own for point in row.points if point.outcome == name]
            x, dt = np.array([place for place, _ in points]), np.array([point.dt for _, point in points])
            said = [f"{name}: step {p.dt:.3g} s at {place:.3g}, error {p.error:.2g}" for place, p in points]
            curves.append(Curve(name, x, dt, colour, marker=MARKS.get(name, "s"), size=6.0, loose=True, labels=said))
        limits = np.array([row.limit if row.limit > 0.0 else math.nan for row in own])
        if np.isfinite(limits).any():
            curves.append(Curve("stated limit", np.array([*map(place_of, own)]), limits, INK))
        none = "" if np.isfinite(limits).any() else ", no limit"
        none = ", no stable step" if all(row.limit == 0.0 for row in own) else none
        panels.append(Panel(solver + none, curves, AXES[axis], "step [s]", log="xy"))
    return panels


def tabs(found: Sequence[Mapped]) -> dict[str, list[Panel]]:
    """All panels by scene and kind of map."""
    made = {f"{one.scene}, {axis}": maps(one.rows, axis) for one in found for axis in AXES}
    return {name: panels for name, panels in made.items() if panels}


def figures(found: Mapped) -> list[Figure]:
    """The maps, one for each kind."""
    made = {axis: maps(found.rows, axis) for axis in AXES}
    said = "Classes over {} and the step. The black line is the limit that each solver states."
    return [Figure(draw(panels, 3, 2.0, shared=True), said.format(AXES[axis]), axis)
            for axis, panels in made.items() if panels]  # fmt: skip


def sections(found: Mapped, about: dict[str, str]) -> Iterator[tuple[str, list[Part]]]:
    """The page's."""
    if found.rows:
        yield "", [HOW]
        for one in figures(found):
            yield f"{one.name.capitalize()} and step", [one]
        yield "Limits", [beyond(found.rows)]
        yield "Points", [counts(found.rows)]
    yield "Left out", [*(found.omissions or ["Nothing."])]
    yield "Made by", [Facts(about)]


def document(found: Mapped, about: dict[str, str]) -> list[Part]:
    """What goes into a documentation page's section."""
    tables = (counts(found.rows), beyond(found.rows))
    return [
        f"{summary(found)}.",
        *figures(found),
        *(table for table in tables if table.rows),
        *(f"Left out: {text}." for text in found.omissions),
        Facts(about),
    ]


def lines(found: Mapped) -> Table:
    """The CSV's: a line per point."""
    headings = ("axis", "value", "edge", "solver", "limit", "dt", "outcome", "error", "gained", "seconds", "why")
    points = [vars(point) | {"edge": row.edge, "limit": row.limit} for row in found.rows for point in row.points]
    return Table(headings, [[_written(point[name]) for name in headings] for point in points])


def _written(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def data(found: Mapped, about: dict[str, str]) -> dict[str, Any]:
    """All that was found, for JSON."""
    return {
        "about": about,
        "omissions": found.omissions,
        "rows": [row.json() for row in found.rows],
    }
