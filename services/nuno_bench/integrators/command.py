"""`nuno bench integrators SCENE`: the skirt paper's comparison of methods, repeated and reported as it is."""

from __future__ import annotations

import argparse
import csv
import json
import sys
from pathlib import Path

import numpy as np

from nuno.scene import scene_file
from nuno_bench import machine, options
from nuno_bench.integrators import findings
from nuno_bench.integrators.experiment import INTEGRATORS, RUNAWAY, SERIES, Trace, run_experiment
from nuno_bench.integrators.findings import Finding
from nuno_bench.report import markdown, page, plots
from nuno_bench.report.plots import Curve
from nuno_bench.report.result import number, text_table
from nuno_schemas.errors import BadInput

HEADINGS = (
    "method",
    "bones",
    "outcome",
    "start [J]",
    "max [J]",
    "end [J]",
    "deep [mm]",
    "stretch",
    "dt / limit",
    "step [us]",
    "run [s]",
)
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
    path, names = _check(args)
    others = machine.Others()
    traces = run_experiment(path, args.overrides, names, args.repeats, lambda text: print(text, file=sys.stderr))
    found = findings.compare(traces)
    about = {"command": machine.command(), **machine.describe(), "load": others.describe()}
    print(text_table(HEADINGS, [row(trace) for trace in traces]))
    for finding in found:
        print(f"\n{finding.claim}: {finding.verdict}\n  {finding.seen}")
    for file in write(args.out / f"integrators-{path.stem}", path.stem, traces, found, about):
        print(f"written {file}")
    if args.docs is not None:
        said = markdown.table(("the paper", "here", ""), [[f.claim, f.seen, f.verdict] for f in found])
        runs = markdown.table(HEADINGS, [row(trace) for trace in traces])
        markdown.replace_section(args.docs, "integrators", [said, runs, CAPTION, markdown.facts(about)])
        print(f"written {args.docs}")
    return 0


def _check(args: argparse.Namespace) -> tuple[Path, list[str]]:
    """The scene's file and the methods to compare. Raises BadInput before anything runs."""
    plots.require_matplotlib()
    if args.docs is not None:
        markdown.check_section(args.docs, "integrators")
    options.require_repeats(args.repeats)
    names = options.names_of(args.integrators)
    options.require_known(names, INTEGRATORS, "method in this comparison", "--integrators")
    path: Path = scene_file.find(args.scene)
    loaded = scene_file.read(path, args.overrides)
    if not loaded.colliders or loaded.colliders[0].name != "skeleton":
        problem = "the comparison needs a skeleton as its first body"
        raise BadInput(problem, str(path), field="bodies.0", remedy="use skirt-paper")
    return path, names


def row(trace: Trace) -> list[str]:
    """A line of the table, under HEADINGS."""
    energies = [trace.series["energy"][0], trace.peak("energy"), trace.last("energy")]
    share = number(trace.dt / trace.limit) if trace.limit > 0 else "> any"
    return [
        trace.integrator,
        "split" if trace.split else "unsplit",
        trace.outcome,
        *(number(float(energy)) for energy in energies),
        number(trace.peak("penetration") * 1e3),
        _percent(trace.peak("stretch")),
        share,
        number(trace.microseconds),
        number(sorted(trace.seconds)[len(trace.seconds) // 2]),
    ]


def _percent(ratio: float) -> str:
    return f"{ratio:.1%}" if ratio < 100 else f"{number(ratio)}"


def write(base: Path, scene: str, traces: list[Trace], found: list[Finding], about: dict[str, str]) -> list[Path]:
    """Write the page, the series as CSV and all figures as JSON, beside each other."""
    base.parent.mkdir(parents=True, exist_ok=True)
    html, table, data = (base.with_name(base.name + ending) for ending in (".html", ".csv", ".json"))
    html.write_text(render(scene, traces, found, about), encoding="utf-8")
    with table.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["integrator", "split", *SERIES])
        for trace in traces:
            for values in zip(*(trace.series[name] for name in SERIES), strict=True):
                writer.writerow([trace.integrator, trace.split, *(f"{value:.9g}" for value in values)])
    content = {
        "about": about,
        "runs": [trace.json() for trace in traces],
        "findings": [vars(f) | {"verdict": f.verdict} for f in found],
    }
    data.write_text(json.dumps(content, indent=1) + "\n")
    return [html, table, data]


def render(scene: str, traces: list[Trace], found: list[Finding], about: dict[str, str]) -> str:
    """The page."""
    body: list[tuple[str, list[page.Part]]] = [
        (
            "What was seen, and what the skirt paper says",
            [
                page.Table(
                    ("the paper", "here", ""),
                    [[f.claim, f.seen, f.verdict] for f in found],
                    "Verdicts follow from the figures below.",
                    prose=True,
                )
            ],
        ),
        ("Runs", [page.Table(HEADINGS, [row(trace) for trace in traces], CAPTION)]),
    ]
    for split, name in ((True, "Bones in pieces"), (False, "Whole bones")):
        chosen = [trace for trace in traces if trace.split == split]
        body.append((name, [page.Figure(figure(chosen), describe(chosen))]))
    body.append(("Made by", [page.Facts(about)]))
    return page.render(f"Integrators on {scene}", LEAD, body)


def figure(traces: list[Trace]) -> str:
    """Energy and penetration over time; a run that ran away is drawn up to there and marked."""

    def series(name: str, scale: float) -> list[Curve]:
        return [_curve(trace, name, scale, i) for i, trace in enumerate(traces)]

    return plots.curves(
        {"Energy [J]": series("energy", 1.0), "Deepest penetration [mm]": series("penetration", 1e3)}, "time [s]"
    )


def _curve(trace: Trace, name: str, scale: float, colour: int) -> Curve:
    lost = trace.runaway
    kept = trace.series["t"] < (np.inf if lost is None else lost)
    ended = "" if lost is None else f"runs away at {lost:.2f} s"
    return Curve(
        trace.integrator,
        trace.series["t"][kept],
        trace.series[name][kept] * scale,
        colour,
        trace.integrator == "rk4_printed",
        ended,
    )


def describe(traces: list[Trace]) -> str:
    """The figure's caption."""
    lost = [f"{trace.integrator} at {trace.runaway:.2f} s" for trace in traces if trace.runaway is not None]
    ending = (
        f"A cross ends a curve where the energy has grown by {RUNAWAY:g} times what lifts the garment by its own "
        f"size: {', '.join(lost)}."
        if lost
        else "No run ran away."
    )
    return f"Energy and deepest penetration of each frame. {ending}"
