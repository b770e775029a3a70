"""`nuno bench stability SCENE…`: maps over stiffness or mesh, and step."""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from nuno.formatting import duration
from nuno.plugin_contract import registry
from nuno.scene import scene_file, shipped
from nuno_bench import machine, options
from nuno_bench.problem import Problem, Run, Series, lengths_at_rest, make_problem, simulate
from nuno_bench.reference import PRIMARY, tight
from nuno_bench.report import page, plots
from nuno_bench.report.page import Figure, Part, Report, Sections, Table, number, reason_of
from nuno_bench.report.plots import INK, Curve, Panel, draw
from nuno_bench.sweep.executor import (
    Executor,
    PackedScene,
    SweepFile,
    add_executor_arguments,
    open_executor,
    pack,
    require_kept,
    unpacked,
    versions,
)
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric, Float

# A scene at a stiffness or mesh, by any solver at any step: the class of what comes out, and the sweep over all.

FACTORS = (1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3)
"""Multiples of the scene's stiffness."""
MESHES = (0.25, 0.5, 1.5)
"""Multiples of the scene's numbers of vertices along each side; 1 is the stiffness map's middle."""

MOST_HALVINGS = 11
"""Of a frame, to the shortest step."""
CLASSES = ("exact", "accurate", "damped away", "drifting", "diverged", "refused", "left out")
EXACT, ACCURATE = 1e-3, 5e-2
"""Largest distance from the reference, as a share of how far the reference moves."""
HIDDEN = 1.0
"""Energy, as a multiple of the motion's, that may be off while positions are right: symplectic methods' wavers by
omega dt of what their stiffest modes hold. The motion's is the reference's largest change of any kind of energy."""
LOST = 5e-2
"""Share of the motion's energy that must be missing for it to count as damped away."""
RUNAWAY = 100.0
"""Energy gained, or distance, as a multiple of the motion's, from which on a run counts as diverged."""
ROUGHNESS = 1e-6
"""Vertices start this part of the shortest spring off their places, so that every mode takes part;
little enough for stiff ones to carry no energy that counts."""
HOW = (
    f"A point is a few frames from a start whose vertices stand up to {ROUGHNESS:g} of the shortest spring off their "
    "places, so that every mode takes part. It is held against an adaptive run at a tight tolerance. It is exact up to "
    f"a distance of {EXACT:g} of how far that run moves, and accurate up to {ACCURATE:g}, unless its energy is off by "
    f"more than that of the motion. Beyond, it is damped away where {LOST:.0%} of that energy is missing, diverged "
    f"where it is not finite or has gained {RUNAWAY:g} times as much, and drifting otherwise. Refused: the solver "
    "itself declined, or did not converge. A scene's own run refuses steps above the line."
)
TIGHT = 1e-8
"""Tolerance of the reference."""
LONGEST = 0.1
"""Most simulated time of a point [s]: a few frames, in which an unstable mode grows beyond all bounds."""


@dataclass(frozen=True)
class Variant:
    """A scene at a stiffness factor or a mesh size, which a row of points shares."""

    scene: PackedScene
    overrides: tuple[str, ...]
    axis: str
    value: float


@dataclass(frozen=True)
class MapPoint:
    """A step of a solver at a setting: its class, and the figures behind it.

    edge           of the shortest spring [m]
    limit          the longest stable step, by the solver itself [s]; nan where it refuses the scene
    error, gained  farthest from the reference, and energy more than it has, as shares of the reference's motion
    seconds        of the run [s]
    """

    axis: str
    value: float
    edge: float
    solver: str
    limit: float
    dt: float
    outcome: str
    error: float = math.nan
    gained: float = math.nan
    seconds: float = 0.0
    why: str = ""

    @property
    def limited(self) -> bool:
        """Whether there are both steps that the solver calls stable, and others."""
        return 0.0 < self.limit < math.inf


def pose(setting: Variant) -> Problem:
    """The beginning of the scene at its stiffness or mesh. Raises BadInput."""
    with unpacked(setting.scene, [*setting.overrides, "allow_unstable=true"]) as loaded:
        problem = make_problem(loaded, threads=1)
    frames = max(1, min(problem.frames, round(LONGEST / problem.frame)))
    problem = replace(problem, poses=problem.poses[: frames + 1])
    if setting.axis != "stiffness":
        return problem
    return replace(problem, system=replace(problem.system, fabric=stiffen(problem.fabric, setting.value)))


def stiffen(fabric: Fabric, factor: float) -> Fabric:
    """All springs, triangles and hinges stiffer by a factor; damping by its root, which keeps its share of the
    critical.
    """
    springs, hinges, membrane = fabric.springs, fabric.hinges, fabric.membrane
    if springs is not None:
        k_lock = None if springs.k_lock is None else springs.k_lock * factor
        springs = replace(springs, k=springs.k * factor, c=springs.c * math.sqrt(factor), k_lock=k_lock)
    if membrane is not None:
        membrane = replace(membrane, moduli=membrane.moduli * factor, damping=membrane.damping * math.sqrt(factor))
    hinges = hinges and replace(hinges, k=hinges.k * factor)
    bending = fabric.bending and replace(fabric.bending, weight=fabric.bending.weight * factor)
    return replace(fabric, springs=springs, hinges=hinges, membrane=membrane, bending=bending)


def shortest(fabric: Fabric) -> float:
    """Length of the shortest spring or side of a membrane's triangle at rest [m]; 0 where there is none."""
    rest = lengths_at_rest(fabric)[1]
    return float(rest[rest > 0.0].min()) if (rest > 0.0).any() else 0.0


def run(problem: Problem, plugin: Any, config: Any, steps: int, most: float = math.inf) -> Run:
    """The path with so many steps a frame, of at most so many seconds, from a start that is a little rough."""
    return simulate(problem, plugin, config, steps, roughness(problem), most)


def roughness(problem: Problem) -> Float:
    """(n, 3) how far the start is from the scene's own [m]."""
    rough = np.zeros((problem.fabric.number, 3))
    random = np.random.default_rng(1).uniform(-1.0, 1.0, (int(problem.free.sum()), 3))
    rough[problem.free] = ROUGHNESS * shortest(problem.fabric) * random
    return rough


def make_reference(problem: Problem) -> Series:
    """The same, by an adaptive solver at a tight tolerance. Raises BadInput where it cannot be made."""
    found = tight(problem, PRIMARY, TIGHT, math.inf, roughness(problem))
    if found.status != "ok":
        why = f"the reference run by {PRIMARY} {found.status}: {found.message}"
        raise BadInput(why, remedy="look at the scene with nuno plan")
    return found.series


def classify(path: Series, reference: Series) -> tuple[str, float, float]:
    """Class, error and energy gained, both as shares of the reference's motion."""
    moved = float(np.abs(reference.x - reference.x[0]).max()) or 1.0
    motion = float(np.abs(reference.parts - reference.parts[0]).max()) or 1.0
    error = float(np.abs(path.x - reference.x).max()) / moved
    # Where the reference rests in between, only its own scale makes sense.
    apart = (path.parts - reference.parts).sum(axis=1)
    gained = float(apart[np.argmax(np.abs(apart))]) / motion
    if not (np.isfinite(error) and np.isfinite(gained)) or gained > RUNAWAY or error > RUNAWAY:
        return "diverged", error, gained
    if error <= ACCURATE and abs(gained) <= HIDDEN:
        return "exact" if error <= EXACT else "accurate", error, gained
    return "damped away" if gained < -LOST else "drifting", error, gained


@dataclass(frozen=True)
class StabilityMap:
    """A scene with its points in the order of settings and solvers, and what was left out, in words."""

    scene: str
    points: Sequence[MapPoint]
    omissions: Sequence[str]


def mesh_overrides(path: Path, overrides: Sequence[str], factor: float) -> list[str]:
    """Further overrides that give every object so many times the vertices along its sides.

    Raises BadInput for a model without a resolution: its mesh is what its file says.
    """
    loaded = scene_file.read(path, overrides)
    made = []
    for i, model in enumerate(loaded.models):
        at, config = f"objects.{i}.model", model.config
        if hasattr(config, "resolution"):
            sides = [max(3, 1 + round(factor * (side - 1))) for side in config.resolution]
            made.append(f"{at}.resolution={sides}")
        elif hasattr(config, "columns") and hasattr(config, "rows"):
            made += [f"{at}.{name}={max(6, round(factor * getattr(config, name)))}" for name in ("columns", "rows")]
        else:
            raise BadInput(f"the model {model.name} has no resolution", str(path), field=at)
    return made


def settings_of(path: Path, overrides: Sequence[str]) -> tuple[list[Variant], list[str]]:
    """All settings of a scene, the middle ones first, and the names of what cannot be varied."""
    scene = pack(path, overrides)
    found = [Variant(scene, (), "stiffness", value) for value in FACTORS]
    omissions = []
    try:
        for value in MESHES:
            found.append(Variant(scene, tuple(mesh_overrides(path, overrides, value)), "mesh", value))
    except BadInput as error:
        omissions.append(f"the map over mesh sizes: {error.problem}")
    return sorted(found, key=lambda s: (abs(math.log(s.value)), s.axis)), omissions


def step_counts(frame: float, omega: float) -> list[int]:
    """Steps a frame in powers of two, to the explicit limit 2 / omega of a hundred times the stiffness, halved."""
    wanted = math.ceil(math.log2(max(2.0, frame * omega * 10.0)))
    return [2**i for i in range(min(MOST_HALVINGS, wanted) + 1)]


@dataclass(frozen=True)
class Task:
    """The rows of some solvers at one setting: a point may take `most` seconds, all of them `left`."""

    setting: Variant
    solvers: tuple[str, ...]
    most: float
    left: float

    def describe(self) -> str:
        return f"{self.setting.axis} x {self.setting.value:g}"


def measure_all(
    settings: Sequence[Variant],
    solvers: Sequence[str],
    kept: SweepFile,
    budget: float,
    executor: Executor,
    say: Callable[[str], None],
) -> tuple[list[MapPoint], list[str]]:
    """All points, in the order of the settings and solvers, and what was left out.

    A solver's points at a setting are kept as they come, where none of them is left out.
    """
    omissions, points = list[str](), [MapPoint(**point) for line in kept.lines for point in line["points"]]
    known = {(point.axis, point.value, point.solver) for point in points}
    wanted = {s: tuple(name for name in solvers if (s.axis, s.value, name) not in known) for s in settings}
    if any(wanted.values()):
        compile_all(settings[0], solvers, say)
    deadline = time.monotonic() + budget
    most = 0.5 * executor.width * budget / max(1, sum(map(len, wanted.values())))
    # Taken when it can be started: clocks of other machines would make nothing of a deadline.
    tasks = (Task(s, names, most, deadline - time.monotonic()) for s, names in wanted.items() if names)
    for task, found in executor.run(measure_setting, tasks):
        say(f"{task.describe()} ({max(0.0, deadline - time.monotonic()):.0f} s left at most)")
        if isinstance(found, BadInput | RunFailed):
            omissions.append(f"{task.describe()}, {', '.join(task.solvers)}: {reason_of(found)}")
            continue
        for row in found:
            points += row
            if all(point.outcome != "left out" for point in row):
                kept.add({"points": [vars(point) for point in row]})
    places = {(s.axis, s.value): i for i, s in enumerate(settings)}
    if all(point.outcome == "left out" for point in points):
        why = f" ({omissions[0]})" if omissions else ""
        raise RunFailed(f"no point was measured within {budget:g} s{why}: give a longer --budget, or fewer --solvers")
    points.sort(key=lambda point: (places[point.axis, point.value], solvers.index(point.solver), -point.dt))
    if any(setting.axis == "mesh" for setting in settings):
        points += [replace(one, axis="mesh") for one in points if (one.axis, one.value) == ("stiffness", 1.0)]
    if missing := sum(point.outcome == "left out" for point in points):
        omissions.append(f"{missing} points that would have taken too long (left out on the maps)")
    return points, omissions


def compile_all(setting: Variant, solvers: Sequence[str], say: Callable[[str], None] = lambda text: None) -> None:
    """One call of every solver: processes of this machine then load what this one compiled."""
    problem = pose(setting)
    names = tuple(dict.fromkeys((PRIMARY, *solvers)))
    for index, name in enumerate(names, 1):
        say(f"compiling, where that has not been done: {name}, {index} of {len(names)}")
        plugin = registry.load(Problem.group, name)
        with contextlib.suppress(BadInput, RunFailed):
            problem.first_call(plugin, plugin.Config(), 1, 0)


def measure_setting(task: Task) -> list[list[MapPoint]]:
    """The points of each solver of a task. Raises BadInput where its setting cannot be posed, or no time is left."""
    if task.left <= 0.0:
        raise BadInput("the budget of time")
    setting = task.setting
    problem, plugin = pose(setting), registry.load(Problem.group, PRIMARY)
    compile_all(setting, task.solvers)  # here, too, what was compiled takes its time to load
    deadline = time.monotonic() + task.left
    # The same steps for every stiffness: those of the scene's own.
    omega = pose(replace(setting, axis="mesh")).limit(plugin, plugin.Config()).omega
    counts, reference = step_counts(problem.frame, float(omega)), make_reference(problem)
    return [measure_row(problem, setting, name, counts, reference, task.most, deadline) for name in task.solvers]


def measure_row(
    problem: Problem,
    setting: Variant,
    solver: str,
    counts: Sequence[int],
    reference: Series,
    most: float,
    deadline: float,
) -> list[MapPoint]:
    """A point for each number of steps a frame, from long steps to short ones.

    A point that would take more than `most` seconds, or start after `deadline` (time.monotonic), is left out.
    """
    plugin = registry.load(Problem.group, solver)
    config, points, each, limit = plugin.Config(), list[MapPoint](), 0.0, math.nan
    with contextlib.suppress(BadInput, RunFailed):
        limit = problem.limit(plugin, config).dt
    for count in sorted(counts):
        dt, edge = problem.frame / count, shortest(problem.fabric)
        point = MapPoint(setting.axis, setting.value, edge, solver, limit, dt, "refused")
        if 2.0 * each > most or time.monotonic() > deadline:
            points.append(replace(point, outcome="left out", why="the budget of time"))
            continue
        try:
            found = run(problem, plugin, config, count, 2.0 * most)
        except (BadInput, RunFailed) as refused:
            points.append(replace(point, why=reason_of(refused)))
            continue
        if found.status == "ok":
            outcome, error, gained = classify(found.series, reference)
            point = replace(point, error=error, gained=gained)
        else:
            outcome = {"cut": "left out", "diverged": "diverged"}.get(found.status, "refused")
        # What ends early says nothing of the next point's cost.
        each = found.seconds if found.status in ("ok", "cut") else each
        points.append(replace(point, outcome=outcome, seconds=found.seconds, why=found.message))
    return points


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


def stability_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_shared(parser, "scenes", "--set", "--solvers", "--resume", "--out", "--rrd", "--docs")
    options.add_seconds(parser, "--budget", 180.0, "wall time for each scene")
    add_executor_arguments(parser)


def stability_command(args: argparse.Namespace) -> int:
    """Map each scene, print the counts, write page, CSV and JSON. A run that diverges is a result."""
    plots.require_drawing(args.rrd)
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
    with open_executor(args) as where:
        for path in paths:
            tabs |= panels_by_tab(_map(args, path, names or installed, where))
    if args.rrd is not None:
        from nuno_bench.report import rerun

        rerun.write(args.rrd, "nuno bench stability", tabs)
    return 0


def _rows(args: argparse.Namespace, path: Path) -> Path:
    folder: Path = args.out
    return folder / f"stability-{path.stem}.rows.jsonl"


def _map(args: argparse.Namespace, path: Path, solvers: Sequence[str], where: Executor) -> StabilityMap:
    """Map one scene and write its page."""
    say = partial(print, f"{path.stem}:", file=sys.stderr)
    others, base = machine.OtherLoad(), args.out / f"stability-{path.stem}"
    settings, omissions = settings_of(path, args.overrides)
    identity = {"scene": settings[0].scene.digest, "solvers": list(solvers), "versions": versions()}
    kept = SweepFile(_rows(args, path), identity, args.resume, say)
    say(f"at most {duration(args.budget)}, and what compiling takes; --resume goes on from {kept.path}")
    with kept:
        points, lost = measure_all(settings, solvers, kept, args.budget, where, say)
    found = StabilityMap(path.stem, points, [*omissions, *lost])
    print(f"{path.stem}: {summary(found)}")
    print(counts(points).text())
    for text in found.omissions:
        print(f"left out: {text}")
    about = machine.about(others, points=where.where)
    report(found, about).write_beside(base, args.docs, f"stability {path.stem}")
    return found


def summary(found: StabilityMap) -> str:
    """Points in all, and of each class that occurs."""
    tally = Counter(point.outcome for point in found.points)
    kinds = ", ".join(f"{tally[name]} {name}" for name in CLASSES if tally[name])
    return f"{number(sum(tally.values()))} points: {kinds}" if tally else "no points"


def counts(points: Sequence[MapPoint]) -> Table:
    """Return a table of the number of points in each class, by map and solver."""
    tally = Counter((point.axis, point.solver, point.outcome) for point in points)
    keys = sorted({key[:2] for key in tally})
    rows = [[axis, solver, *(str(tally[axis, solver, name]) for name in CLASSES)] for axis, solver in keys]
    return Table(("map", "solver", *CLASSES), rows, "Points of each class.")


def beyond(points: Sequence[MapPoint]) -> Table:
    """Return a table of stated limits against the maps: points lost below them, and above, out of all."""
    known = [p for p in points if p.limited and p.outcome not in ("left out", "refused")]
    tally = Counter((p.solver, p.dt > p.limit, p.outcome == "diverged") for p in known)
    rows = [
        [solver, *(f"{tally[solver, above, True]} of {tally[solver, above, True] + tally[solver, above, False]}"
                   for above in (False, True))]
        for solver in sorted({point.solver for point in known})
    ]  # fmt: skip
    return Table(("solver", "lost below its limit", "lost above it"), rows, "Points of all maps. Lost: diverged.")


def maps(points: Sequence[MapPoint], axis: str) -> list[Panel]:
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


def _place(point: MapPoint) -> float:
    """Return a point's place on its axis: the factor, or the shortest spring [mm]."""
    return 1e3 * point.edge if point.axis == "mesh" else point.value


def panels_by_tab(found: StabilityMap) -> dict[str, list[Panel]]:
    """The panels by scene and kind of map, of those kinds that were mapped."""
    made = {f"{found.scene}, {axis}": maps(found.points, axis) for axis in AXES}
    return {name: panels for name, panels in made.items() if panels}


def report(found: StabilityMap, about: Mapping[str, str]) -> Report:
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
