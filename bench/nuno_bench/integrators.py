"""`nuno bench integrators SCENE`: the skirt paper's comparison of methods, repeated and reported as it is, and maps of
the constants at which each of the paper's sentences holds.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nuno.collision.bodies import build_bodies
from nuno.collision.distance import signed_distance
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno_bench import machine, options
from nuno_bench.problem import make_problem
from nuno_bench.report import page, plots
from nuno_bench.report.page import Figure, Report, Table, number
from nuno_bench.report.plots import Curve, Panel
from nuno_bench.stability import mesh_overrides, stiffen
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

# One scene run by several integrators, with split and unsplit bones, and what each run did.
#
# The simulation is stepped directly: services would add nothing to the physics (their digests are
# equal) and would blur the times.

INTEGRATORS = ("euler", "symplectic_euler", "rk4", "rk4_printed")
SPLIT = "bodies.0.collider.split"
PAPERS_CONTACT = ("contact={plugin: penalty, margin: 0 m}",)
"""Overrides for the paper's contact, whose bodies have no margin."""
RUNAWAY = 10.0
"""A run counts as run away once its energy has grown by this multiple of the work that lifts the
garment by its own size. Growth, and that work, are the same wherever height zero is; the energy
itself is not, so a multiple of the start would be another limit for a dancer on a stage."""
SERIES = ("t", "kinetic", "gravitational", "springs", "hinges", "energy", "penetration", "distance", "stretch")


@dataclass(frozen=True)
class Trace:
    """One run.

    series   (frames + 1,) per name of SERIES: time [s], energies [J], deepest penetration [m],
             mean distance of free vertices from the bodies [m], largest stretch (1 = twice as long); both by the bodies
             that it is judged by, whichever it touched
    ended    [s] when the state stopped being finite, or None
    seconds  time of all steps, per repeat; steps taken; limit: largest stable step [s]
    lift     work that lifts the garment by its own size, the diagonal of its box at the start [J]; 0 without gravity
    """

    integrator: str
    split: bool
    series: dict[str, Float]
    ended: float | None
    message: str
    seconds: tuple[float, ...]
    steps: int
    dt: float
    limit: float
    lift: float

    @property
    def outcome(self) -> str:
        return "done" if self.ended is None else f"diverged at {self.ended:.2f} s"

    @property
    def runaway(self) -> float | None:
        """Time at which the energy has first grown by RUNAWAY times the lift [s]; None if it never does.

        Without gravity a run has only run away where it is no longer finite.
        """
        energy = self.series["energy"]
        most = RUNAWAY * self.lift if self.lift > 0.0 else np.inf
        frames = np.flatnonzero((energy - energy[0] > most) | ~np.isfinite(energy))
        return float(self.series["t"][frames[0]]) if frames.size else self.ended

    @property
    def microseconds(self) -> float:
        """Median time of a step [us]; runs that end early take fewer steps."""
        return 1e6 * statistics.median(self.seconds) / max(1, self.steps)

    def finite(self, name: str) -> Float:
        """The finite values of a series."""
        values = self.series[name]
        return values[np.isfinite(values)]

    def peak(self, name: str) -> float:
        """Largest finite value of a series."""
        return float(self.finite(name).max())

    @property
    def energies(self) -> tuple[float, float, float]:
        """At the start, at most, and at the end [J], of the frames in which it was finite."""
        energy = self.finite("energy")
        return float(energy[0]), float(energy.max()), float(energy[-1])

    @property
    def derived(self) -> dict[str, Any]:
        """Return the quantities that follow from the fields."""
        peaks = {name: self.peak(name) for name in ("penetration", "distance", "stretch")}
        found = {name: getattr(self, name) for name in ("outcome", "runaway", "microseconds", "energies")}
        return found | {"peaks": peaks}


def run_experiment(path: Path, overrides: Sequence[str], repeats: int, say: Callable[[str], None]) -> list[Trace]:
    """All of INTEGRATORS with split and unsplit bones. Raises BadInput for a scene that cannot be run.

    Penalty contact is the paper's, without a margin, unless the scene or an override gives one. Repeats are taken in
    rounds over all variants, so that a machine that slows down slows all.
    """
    overrides = _papers_contact(path, overrides)
    variants = [(name, split) for split in (True, False) for name in INTEGRATORS]
    scenes = [
        scene_file.read(
            path, [*overrides, f"solver.plugin={name}", f"{SPLIT}={str(split).lower()}", "allow_unstable=true"]
        )
        for name, split in variants
    ]
    traces: list[Trace] = []
    for variant, loaded in zip(variants, scenes, strict=True):
        say(f"{variant[0]}, {'split' if variant[1] else 'unsplit'} bones")
        traces.append(run_variant(loaded, *variant))
    for turn in range(1, repeats):
        say(f"times, round {turn + 1} of {repeats}")
        for i, (variant, loaded) in enumerate(zip(variants, scenes, strict=True)):
            again = run_variant(loaded, *variant, measured=False)
            traces[i] = replace(traces[i], seconds=traces[i].seconds + again.seconds)
    return traces


def _papers_contact(path: Path, overrides: Sequence[str]) -> list[str]:
    """Overrides with the paper's contact before them, where the scene has penalty contact and none gives a margin."""
    contacts = scene_file.read(path, overrides).contacts
    own = any(contact.name == "penalty" and "margin" not in contact.given for contact in contacts)
    return [*(PAPERS_CONTACT if own else ()), *overrides]


def run_variant(
    loaded: Loaded, name: str, split: bool, measured: bool = True, shape: Loaded | None = None, stiffness: float = 1.0
) -> Trace:
    """Run a variant to its end, or to the frame in which it diverges; unmeasured runs are only timed.

    `shape` is a scene whose bodies it is judged by, instead of its own; springs are `stiffness` times as stiff.
    """
    problem, chosen, bodies = make_problem(loaded), loaded.integrator, build_bodies(shape or loaded)
    if stiffness != 1.0:
        problem = replace(problem, system=replace(problem.system, fabric=stiffen(problem.fabric, stiffness)))
    limit = problem.limit(chosen.plugin, chosen.config)
    steps = problem.own_steps(limit)
    run, rows = problem.run(chosen.plugin, chosen.config, steps), list[tuple[float, ...]]()
    for t, x, report in zip(run.series.t, run.series.x, run.reports, strict=False):
        if measured:
            distance = signed_distance(x, bodies.geometry, bodies.poses(t))
            finite = distance[np.isfinite(distance)]
            inside, mean = (max(0.0, -finite.min()), finite.mean()) if finite.size else (np.nan, np.nan)
            energy = [float(report.energy.get(kind, 0.0)) for kind in SERIES[1:5]]
            rows.append((t, *energy, sum(energy), float(inside), float(mean), report.stretch))
    weight = float(problem.fabric.mass.sum()) * float(np.linalg.norm(problem.system.gravity))
    return Trace(
        integrator=name,
        split=split,
        series=dict(zip(SERIES, np.array(rows).T, strict=True)) if measured else {},
        ended=None if run.status == "ok" else problem.frame * len(run.series.t),
        message=run.message,
        seconds=(run.seconds,),
        steps=run.totals["steps"],
        dt=problem.frame / steps,
        limit=limit.dt,
        lift=weight * problem.size,
    )


HEADINGS = (
    "method", "bones", "outcome", "start [J]", "max [J]", "end [J]", "deep [mm]", "stretch", "dt / limit", "step [us]",
    "run [s]",
)  # fmt: skip
CAPTION = (
    "Energy is kinetic, gravitational and elastic together, over the frames in which it was finite. "
    "Deep: largest penetration of free vertices, by a routine other than the contact force's. "
    "Stretch: largest strain of a spring. Step and run: medians over repeats, compilation apart."
)
LEAD = (
    "The same skirt on the same dancer, at the same step, by each method, with bones cut in pieces and whole. "
    "Outcomes are reported as they came."
)
DEEPER = 1.5
"""Penetration counts as another from this multiple of symplectic Euler's on."""
SLOWER = 1.1
"""Times within a tenth of each other count as the same."""


def integrators_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", help="a scene with a garment on a skeleton, e.g. skirt-paper")
    options.add_count(parser, "--repeats", "runs of each variant that are timed (default: %(default)s)", 3)
    options.add_shared(parser, "--set", "--out", "--docs")


def integrators_command(args: argparse.Namespace) -> int:
    """Run, print the table and the map, write page, CSV and JSON. A run that diverges is a result."""
    plots.require_matplotlib()
    page.check_section(args.docs, "integrators")
    path: Path = shipped.find(args.scene)
    loaded = scene_file.read(path, args.overrides)
    if not loaded.colliders or loaded.colliders[0].name != "skeleton":
        problem = "the comparison needs a skeleton as its first body"
        raise BadInput(problem, str(path), field="bodies.0", remedy="use skirt-paper")
    others, say = machine.OtherLoad(), partial(print, file=sys.stderr)
    traces = run_experiment(path, args.overrides, args.repeats, say)
    print(runs(traces).text())
    cells = map_settings(path, args.overrides, say)
    print(regions(cells).text())
    found = report(path.stem, traces, cells, machine.about(others))
    found.write_beside(args.out / f"integrators-{path.stem}", args.docs, "integrators")
    return 0


def runs(traces: Sequence[Trace]) -> Table:
    """A line per run."""
    rows = []
    for trace in traces:
        stretch = trace.peak("stretch")
        rows.append([
            trace.integrator,
            "split" if trace.split else "unsplit",
            trace.outcome,
            *map(number, trace.energies),
            number(trace.peak("penetration") * 1e3),
            f"{stretch:.1%}" if stretch < 100 else number(stretch),
            number(trace.dt / trace.limit) if trace.limit > 0 else "> any",
            number(trace.microseconds),
            number(statistics.median_high(trace.seconds)),
        ])  # fmt: skip
    return Table(HEADINGS, rows, CAPTION)


def report(scene: str, traces: Sequence[Trace], cells: Sequence[Cell], about: Mapping[str, str]) -> Report:
    """The page, all figures with their series, and the documentation's section."""
    where, drawn_map = regions(cells), euler_map(cells)
    table = runs(traces)
    drawn = [(name, [figure([trace for trace in traces if trace.split == split])])
             for split, name in ((True, "Bones in pieces"), (False, "Whole bones"))]  # fmt: skip
    sections: page.Sections = [("Where it holds as the paper says", [where, drawn_map]), ("Runs", [table]), *drawn]
    data = {"runs": [vars(trace) | trace.derived for trace in traces]}
    rows = [{"integrator": trace.integrator, "split": trace.split} | dict(zip(SERIES, values, strict=True))
            for trace in traces for values in zip(*(trace.series[name] for name in SERIES), strict=True)]  # fmt: skip
    return Report(f"Integrators on {scene}", LEAD, sections, about, data, [where, drawn_map, table, CAPTION], rows)


def figure(traces: Sequence[Trace]) -> Figure:
    """Energy and penetration over time; a run that ran away is drawn up to there and marked."""
    panels = []
    for title, name, scale in (("Energy [J]", "energy", 1.0), ("Deepest penetration [mm]", "penetration", 1e3)):
        curves = []
        for i, trace in enumerate(traces):
            lost = trace.runaway
            kept = trace.series["t"] < (np.inf if lost is None else lost)
            ended = "" if lost is None else f"runs away at {lost:.2f} s"
            x, y = trace.series["t"][kept], scale * trace.series[name][kept]
            curves.append(Curve(trace.integrator, x, y, i, trace.integrator == "rk4_printed", ended))
        panels.append(Panel(title, curves, "time [s]"))
    gone = ", ".join(f"{trace.integrator} at {trace.runaway:.2f} s" for trace in traces if trace.runaway is not None)
    ending = (
        f"A cross ends a curve where the energy has grown by {RUNAWAY:g} times what lifts the garment by its own "
        f"size: {gone}."
    )
    caption = f"Energy and deepest penetration of each frame. {ending if gone else 'No run ran away.'}"
    return Figure(plots.draw(panels), caption)


# Maps over stiffness, damping, mesh and step: where each of the paper's sentences holds. The paper prints a step and
# none of its constants, so that one set of constants decides nothing.

STIFFNESS = (1 / 16, 1 / 4, 1.0)
"""Multiples of the scene's springs."""
DAMPING = (0.5, 2.0, 8.0, 32.0)
"""Of the motion [1/s]."""
MESHES = (0.4, 0.7, 1.0)
"""Multiples of the scene's columns and rows."""
STEPS = (0.5e-3, 2e-3)
"""[s]; the paper's is 2 ms."""
VIOLENT = 4.0
"""Euler moves violently from this multiple of symplectic Euler's largest kinetic energy on."""
LEAVES = 1.2
"""Cloth leaves the body from this multiple of its mean distance by symplectic Euler in the same frame on."""
WHOLE = "whole bones"
"""Symplectic Euler with one capsule a bone."""
CALM, ROUGH, OFF, LOST = "moves as symplectic Euler", "violent", "violent, off the body", "runs away"
CLASSES = {CALM: "#0072b2", ROUGH: "#e69f00", OFF: "#b03a00", LOST: "#8a8f98"}
"""What Euler does, and its colour."""


HOW = (
    f"Settings: springs {', '.join(map(number, STIFFNESS))} times as stiff as the scene's, damping "
    f"{', '.join(map(number, DAMPING))} /s, meshes of {', '.join(map(number, MESHES))} times as many columns and rows, "
    f"steps of {', '.join(number(1e3 * dt) for dt in STEPS)} ms. Violent: {VIOLENT:g} times symplectic Euler's largest "
    f"kinetic energy. Off the body: {LEAVES:g} times its mean distance in the same frame. Deeper: {DEEPER:g} times, by "
    "the deepest vertex, into the body with bones in pieces; contact is the paper's, without a margin "
    "unless the scene gives one."
)


class Setting(NamedTuple):
    """A point of the maps: multiples of the scene's stiffness and mesh, damping [1/s] and step [s]."""

    stiffness: float
    damping: float
    mesh: float
    dt: float


@dataclass(frozen=True)
class Cell:
    """A setting, and its runs by method, bones in pieces, and by WHOLE; depths are into bones in pieces by all."""

    setting: Setting
    runs: Mapping[str, Trace]

    def deeper(self, name: str) -> float:
        """Penetration of a run over symplectic Euler's with bones in pieces."""
        return self.runs[name].peak("penetration") / max(self.runs["symplectic_euler"].peak("penetration"), 1e-9)

    def slower(self, name: str) -> float:
        """Time of a step over symplectic Euler's."""
        return self.runs[name].microseconds / self.runs["symplectic_euler"].microseconds

    @property
    def euler(self) -> str:
        """Which of CLASSES Euler is in."""
        mine, base = self.runs["euler"], self.runs["symplectic_euler"]
        if mine.runaway is not None:
            return LOST
        if mine.peak("kinetic") < VIOLENT * base.peak("kinetic"):
            return CALM
        return OFF if self.farthest >= LEAVES else ROUGH

    @property
    def farthest(self) -> float:
        """Largest of Euler's mean distances over symplectic Euler's in the same frame."""
        mine, base = self.runs["euler"].series["distance"], self.runs["symplectic_euler"].series["distance"]
        frames = min(len(mine), len(base))
        return float(np.nanmax(mine[:frames] / base[:frames]))


def map_settings(path: Path, overrides: Sequence[str], say: Callable[[str], None]) -> list[Cell]:
    """Run every method at every setting of a scene. Raises BadInput for a scene that cannot be run."""
    settings = [Setting(*one) for one in itertools.product(STIFFNESS, DAMPING, MESHES, STEPS)]
    cells = []
    for i, setting in enumerate(settings, 1):
        if i % 6 == 1:
            say(f"map, setting {i} of {len(settings)}")
        cells.append(Cell(setting, _run_setting(path, overrides, setting)))
    return cells


def setting_overrides(path: Path, overrides: Sequence[str], setting: Setting) -> list[str]:
    """Overrides of a scene for a setting, but for its stiffness."""
    own = [] if setting.mesh == 1.0 else mesh_overrides(path, overrides, setting.mesh)
    return [*_papers_contact(path, overrides), *own, f"damping={setting.damping}", f"solver.dt={setting.dt} s",
            "allow_unstable=true"]  # fmt: skip


def _run_setting(path: Path, overrides: Sequence[str], setting: Setting) -> dict[str, Trace]:
    given = setting_overrides(path, overrides, setting)
    shape = scene_file.read(path, [*given, f"{SPLIT}=true"])
    runs = {}
    for name, method, split in (*((name, name, True) for name in INTEGRATORS), (WHOLE, "symplectic_euler", False)):
        loaded = scene_file.read(path, [*given, f"solver.plugin={method}", f"{SPLIT}={str(split).lower()}"])
        runs[name] = run_variant(loaded, method, split, shape=shape, stiffness=setting.stiffness)
    return runs


def regions(cells: Sequence[Cell]) -> Table:
    """For each sentence of the paper, at how many settings it holds, and at which."""
    rows = [
        _region("symplectic Euler survives", cells, lambda cell: cell.runs["symplectic_euler"].ended is None),
        _region("explicit Euler survives", cells, lambda cell: cell.euler != LOST),
        _region("it survives and moves violently", cells, lambda cell: cell.euler in (ROUGH, OFF)),
        _region("and cloth leaves the body", cells, lambda cell: cell.euler == OFF),
    ]
    for name, what in (
        ("rk4", "by Runge-Kutta cloth sinks in deeper"),
        ("rk4_printed", "so it does by Runge-Kutta as printed"),
        (WHOLE, "whole bones let cloth deeper into the body"),
    ):
        ratios = {cell.setting: cell.deeper(name) for cell in cells}
        row = _region(what, cells, lambda cell, ratios=ratios: ratios[cell.setting] >= DEEPER)  # type: ignore[misc]
        rows.append([*row[:-1], f"{row[-1]}; {_range(list(ratios.values()))} as deep as symplectic Euler"])
    for what, times, whose in (
        ("a step of Runge-Kutta takes longer", [cell.slower("rk4") for cell in cells], "symplectic Euler's"),
        ("so does one with bones in pieces", [1.0 / cell.slower(WHOLE) for cell in cells], "whole bones'"),
    ):
        slower = f"{sum(time > SLOWER for time in times)} of {len(cells)}"
        rows.append([what, slower, f"{_range(times)} {whose} time"])
    return Table(("sentence", "settings", "where"), rows, HOW, prose=True)


def _region(says: str, cells: Sequence[Cell], holds: Callable[[Cell], bool]) -> list[str]:
    """A sentence, at how many settings it holds, and the range of each of their values."""
    found = [cell.setting for cell in cells if holds(cell)]
    parts = [
        f"{name} {', '.join(number(scale * value) for value in sorted({one[i] for one in found}))}{unit}"
        for i, (name, scale, unit) in enumerate(
            (("stiffness", 1.0, ""), ("damping", 1.0, " /s"), ("mesh", 1.0, ""), ("step", 1e3, " ms"))
        )
    ]
    return [says, f"{len(found)} of {len(cells)}", "; ".join(parts) if found else "nowhere"]


def _range(ratios: Sequence[float]) -> str:
    """Smallest, largest and median of ratios."""
    return f"{number(min(ratios))} to {number(max(ratios))} times, in the median {number(statistics.median(ratios))},"


def euler_map(cells: Sequence[Cell]) -> Figure:
    """What Euler does over stiffness and damping, a panel a mesh and step."""
    panels = []
    for mesh, dt in itertools.product(MESHES, STEPS):
        own = [cell for cell in cells if (cell.setting.mesh, cell.setting.dt) == (mesh, dt)]
        curves = []
        for name, colour in CLASSES.items():
            there = [cell.setting for cell in own if cell.euler == name]
            x, y = (np.array([one[i] for one in there], float) for i in (0, 1))
            curves.append(Curve(name, x, y, colour, marker="X" if name == LOST else "s", size=8.0, loose=True))
        panels.append(Panel(f"mesh {mesh:g}, step {1e3 * dt:g} ms", curves, "stiffness", "damping [1/s]", log="xy"))
    return Figure(plots.draw(panels, 2, 2.0, shared=True), "What explicit Euler does, by setting.", "euler")
