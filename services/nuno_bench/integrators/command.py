"""`nuno bench integrators SCENE`: the skirt paper's comparison of methods, repeated and reported as it is."""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from nuno.scene import scene_file, shipped
from nuno_bench import machine, options
from nuno_bench.integrators import findings
from nuno_bench.integrators.experiment import INTEGRATORS, RUNAWAY, SERIES, Trace, run_experiment
from nuno_bench.report import page, plots
from nuno_bench.report.page import Figure, Report, Table
from nuno_bench.report.plots import Curve, Panel
from nuno_bench.report.result import number
from nuno_schemas.errors import BadInput

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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", help="a scene with a garment on a skeleton, e.g. skirt-paper")
    parser.add_argument(
        "--integrators", default=",".join(INTEGRATORS), metavar="A,B", help="methods to compare (default: %(default)s)"
    )
    options.add_repeats(parser, 3, "runs of each variant that are timed; with one, claims about time stay undecided")
    options.add_shared(parser, "--set", "--out", "--docs")


def main(args: argparse.Namespace) -> int:
    """Run, print the table and the findings, write page, CSV and JSON. A run that diverges is a result."""
    plots.require_matplotlib()
    page.check_section(args.docs, "integrators")
    names = options.names_of(args.integrators)
    options.require_known(names, INTEGRATORS, "method in this comparison", "--integrators")
    path: Path = shipped.find(args.scene)
    loaded = scene_file.read(path, args.overrides)
    if not loaded.colliders or loaded.colliders[0].name != "skeleton":
        problem = "the comparison needs a skeleton as its first body"
        raise BadInput(problem, str(path), field="bodies.0", remedy="use skirt-paper")
    others = machine.Others()
    traces = run_experiment(path, args.overrides, names, args.repeats, lambda text: print(text, file=sys.stderr))
    print(runs(traces).text())
    for claim, seen, verdict in findings.compare(traces):
        print(f"\n{claim}: {verdict}\n  {seen}")
    found = report(path.stem, traces, machine.about(others))
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


def report(scene: str, traces: Sequence[Trace], about: Mapping[str, str]) -> Report:
    """The page, all figures with their series, and the documentation's section."""
    found, table = findings.compare(traces), runs(traces)
    claims = Table(("the paper", "here", ""), found, "Verdicts follow from the figures below.", prose=True)
    drawn = [(name, [figure([trace for trace in traces if trace.split == split])])
             for split, name in ((True, "Bones in pieces"), (False, "Whole bones"))]  # fmt: skip
    sections: page.Sections = [("What was seen, and what the skirt paper says", [claims]), ("Runs", [table]), *drawn]
    data = {"runs": [vars(trace) | trace.derived for trace in traces], "findings": [one._asdict() for one in found]}
    rows = [{"integrator": trace.integrator, "split": trace.split} | dict(zip(SERIES, values, strict=True))
            for trace in traces for values in zip(*(trace.series[name] for name in SERIES), strict=True)]  # fmt: skip
    return Report(f"Integrators on {scene}", LEAD, sections, about, data, [claims, table, CAPTION], rows)


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
