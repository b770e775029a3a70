"""`nuno bench stability SCENE…`: maps over stiffness or mesh, and step."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from nuno import registry
from nuno.formatting import duration
from nuno.scene import scene_file, shipped
from nuno.viewer.require import require as require_viewer
from nuno_bench import machine, options
from nuno_bench.problem.observe import Problem
from nuno_bench.report import page, plots
from nuno_bench.report.page import Figure, Part, Report, Sections, Table
from nuno_bench.report.plots import INK, Curve, Panel, draw
from nuno_bench.report.result import number
from nuno_bench.stability.sweep import CLASSES, HOW, Mapped, Point, measure_all, settings_of
from nuno_bench.sweep import places
from nuno_bench.sweep.executor import Executor, versions
from nuno_bench.sweep.storage import Kept, require_kept
from nuno_schemas.errors import BadInput

LEAD = "What each solver makes of the scene at every step and stiffness, above its limit too."
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_shared(parser, "scenes", "--set", "--solvers", "--resume", "--out", "--rrd", "--docs")
    options.add_seconds(parser, "--budget", 180.0, "wall time for each scene")
    places.add_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Map each scene, print the counts, write page, CSV and JSON. A run that diverges is a result."""
    plots.require_matplotlib()
    require_viewer(None, args.rrd, "--rrd")
    tabs = dict[str, list[plots.Panel]]()
    paths: list[Path] = [shipped.find(name) for name in args.scenes]
    for path in paths:
        if scene_file.read(path, args.overrides).solver is None:
            remedy = "nuno bench precision holds solvers of dye against each other"
            raise BadInput("the maps are of cloth that moves, and here none does", str(path), remedy=remedy)
        page.check_section(args.docs, f"stability {path.stem}")
    names, installed = options.names_of(args.solvers), sorted(registry.installed(Problem.group))
    options.require_known(names, installed, "solver", "--solvers")
    if args.resume:
        require_kept([_rows(args, path) for path in paths])
    with places.opened(args) as where:
        for path in paths:
            tabs |= panels_by_tab(_map(args, path, names or installed, where))
    if args.rrd is not None:
        from nuno_bench.report import rerun

        rerun.write(args.rrd, "nuno bench stability", tabs)
    return 0


def _rows(args: argparse.Namespace, path: Path) -> Path:
    folder: Path = args.out
    return folder / f"stability-{path.stem}.rows.jsonl"


def _map(args: argparse.Namespace, path: Path, solvers: Sequence[str], where: Executor) -> Mapped:
    """One scene."""
    say = partial(print, f"{path.stem}:", file=sys.stderr)
    others, base = machine.Others(), args.out / f"stability-{path.stem}"
    settings, omissions = settings_of(path, args.overrides)
    identity = {"scene": settings[0].scene.digest, "solvers": list(solvers), "versions": versions()}
    kept = Kept(_rows(args, path), identity, args.resume, say)
    say(f"at most {duration(args.budget)}, and what compiling takes; --resume goes on from {kept.path}")
    with kept:
        points, lost = measure_all(settings, solvers, kept, args.budget, where, say)
    found = Mapped(path.stem, points, [*omissions, *lost])
    print(f"{path.stem}: {summary(found)}")
    print(counts(points).text())
    for text in found.omissions:
        print(f"left out: {text}")
    about = machine.about(others, points=where.where)
    report(found, about).write_beside(base, args.docs, f"stability {path.stem}")
    return found


def summary(found: Mapped) -> str:
    """Points in all, and of each class that occurs."""
    tally = Counter(point.outcome for point in found.points)
    kinds = ", ".join(f"{tally[name]} {name}" for name in CLASSES if tally[name])
    return f"{number(sum(tally.values()))} points: {kinds}" if tally else "no points"


def counts(points: Sequence[Point]) -> Table:
    """How many points fell into each class, by map and solver."""
    tally = Counter((point.axis, point.solver, point.outcome) for point in points)
    keys = sorted({key[:2] for key in tally})
    rows = [[axis, solver, *(str(tally[axis, solver, name]) for name in CLASSES)] for axis, solver in keys]
    return Table(("map", "solver", *CLASSES), rows, "Points of each class.")


def beyond(points: Sequence[Point]) -> Table:
    """How the stated limits compare with the maps: points that were lost below, and above, out of all."""
    known = [p for p in points if p.limited and p.outcome not in ("left out", "refused")]
    tally = Counter((p.solver, p.dt > p.limit, p.outcome == "diverged") for p in known)
    rows = [
        [solver, *(f"{tally[solver, above, True]} of {tally[solver, above, True] + tally[solver, above, False]}"
                   for above in (False, True))]
        for solver in sorted({point.solver for point in known})
    ]  # fmt: skip
    return Table(("solver", "lost below its limit", "lost above it"), rows, "Points of all maps. Lost: diverged.")


def maps(points: Sequence[Point], axis: str) -> list[Panel]:
    """A panel a solver: its points over axis and step, each class a curve, and the limit that it states."""
    panels = []
    for solver in sorted({point.solver for point in points if point.axis == axis}):
        own = sorted((one for one in points if (one.axis, one.solver) == (axis, solver)), key=_place)
        curves = []
        for name, colour in COLOURS.items():
            shown = [point for point in own if point.outcome == name]
            x, dt = np.array([*map(_place, shown)]), np.array([point.dt for point in shown])
            said = [f"{name}: step {p.dt:.3g} s at {_place(p):.3g}, error {p.error:.2g}" for p in shown]
            curves.append(Curve(name, x, dt, colour, marker=MARKS.get(name, "s"), size=6.0, loose=True, labels=said))
        stated = dict.fromkeys((_place(point), point.limit) for point in own if point.limited)
        if stated:
            x, dt = np.array([*stated]).T
            curves.append(Curve("stated limit", x, dt, INK))
        none = ", no stable step" if all(point.limit == 0.0 for point in own) else ", no limit"
        panels.append(Panel(solver + none * (not stated), curves, AXES[axis], "step [s]", log="xy"))
    return panels


def _place(point: Point) -> float:
    """Where it stands: its factor, or the shortest spring [mm]."""
    return 1e3 * point.edge if point.axis == "mesh" else point.value


def panels_by_tab(found: Mapped) -> dict[str, list[Panel]]:
    """The panels by scene and kind of map, of those kinds that were mapped."""
    made = {f"{found.scene}, {axis}": maps(found.points, axis) for axis in AXES}
    return {name: panels for name, panels in made.items() if panels}


def report(found: Mapped, about: Mapping[str, str]) -> Report:
    """The page, all points, and the documentation's section."""
    made = {axis: maps(found.points, axis) for axis in AXES}
    said = "Classes over {} and the step. The black line is the limit that each solver states."
    figures = [Figure(draw(panels, 3, 2.0, shared=True), said.format(AXES[axis]), axis)
               for axis, panels in made.items() if panels]  # fmt: skip
    tables, omitted = [beyond(found.points), counts(found.points)], [f"Left out: {text}." for text in found.omissions]
    sections: Sections = [
        ("", [HOW]),
        *((f"{one.name.capitalize()} and step", [one]) for one in figures),
        ("Limits", tables[:1]),
        ("Points", tables[1:]),
        ("Left out", omitted or ["Nothing."]),
    ]
    brief: list[Part] = [f"{summary(found)}.", *figures, *tables[::-1], *omitted]
    return Report(f"Stability of {found.scene}", LEAD, sections, about, vars(found), brief, [*map(vars, found.points)])
