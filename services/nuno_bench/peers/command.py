"""`nuno bench peers`: the stiff sheet in other engines and in ours, in the same run: error beside time."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench import extras, machine, options
from nuno_bench.peers import page as shown
from nuno_bench.peers.problem import Sheet
from nuno_bench.peers.process import Point, measure
from nuno_bench.peers.table import KINDS, Kind, label
from nuno_bench.report import markdown, plots
from nuno_bench.report.result import text_table
from nuno_bench.speed.steps import stiff
from nuno_schemas.errors import BadInput

GROUPS = {
    name: [kind for kind in KINDS if kind.name.partition("-")[0] == name] for name in ("nuno", "mujoco", "newton")
}
"""What a name of --only may stand for as a whole."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    names = ", ".join([*GROUPS, *(kind.name for kind in KINDS)])
    parser.add_argument("--only", metavar="NAME,NAME", help=f"which of {names} (default: all installed)")
    options.add_repeats(parser, 3, "seconds to simulate at each setting")
    limit = "wall time of a setting, start and all; no repeats after a third of it"
    options.add_seconds(parser, "--limit", 200.0, limit)
    options.add_shared(parser, "--out", "--docs")


def main(args: argparse.Namespace) -> int:
    """Run every setting, print the table, write page and JSON. A peer that breaks is a finding."""
    plots.require_matplotlib()
    kinds = choose(args.only)
    left_out = leave_out(kinds, args.only)
    options.require_repeats(args.repeats)
    if not args.limit > 0.0:
        raise BadInput("a setting needs time", field="--limit", value=args.limit, limit="> 0 s")
    if args.docs is not None:
        markdown.check_section(args.docs, "peers")
    args.out.mkdir(parents=True, exist_ok=True)
    others = machine.Others()
    found = measure_all(kinds, left_out, args.repeats, args.limit)
    used = [kind.package for kind in kinds if kind.package and not kind.missing]
    about = {"command": machine.command(), **machine.describe(), "peers": shown.versions(used)}
    about["load"] = others.describe()
    print(text_table(shown.HEADINGS, shown.rows(found)))
    told = [": ".join([", ".join(note[:2]), note[2]]) for note in shown.notes(found)]
    for text in [*told, *shown.verdicts(found), *found.left_out]:
        print(text)
    for file in shown.write(args.out / "peers", found, about):
        print(f"written {file}")
    if args.docs is not None:
        markdown.replace_section(args.docs, "peers", [*shown.sections(found), markdown.facts(about)])
        print(f"written {args.docs}")
    return 0


def choose(only: str | None) -> list[Kind]:
    """Kinds by their names, or by the engine's. Raises BadInput for any other name."""
    known = {kind.name: [kind] for kind in KINDS} | GROUPS
    names = options.names_of(only)
    options.require_known(names, known, "peer", "--only")
    chosen = [kind for name in names for kind in known[name]]
    return [kind for kind in KINDS if not names or kind in chosen]


def leave_out(kinds: Sequence[Kind], only: str | None) -> list[str]:
    """Which are not installed and how they are, a sentence for each package, said before anything runs.

    Raises BadInput where the user asked for one by name.
    """
    lacking: dict[str, list[str]] = {}
    for kind in (kind for kind in kinds if kind.missing):
        lacking.setdefault(kind.package, []).append(kind.name)
    if only:
        extras.require(f"{only} needs", lacking, "--only")
    told = [f"left out, {', '.join(names)}: {extras.told([package])}" for package, names in lacking.items()]
    for text in told:
        print(text, file=sys.stderr)
    return told


def stiff_sheet(overrides: Sequence[str] = ()) -> Sheet:
    """The shipped scene's sheet as plain arrays."""
    simulation = Simulation(scene_file.read(scene_file.find(stiff.SCENE), tuple(overrides)), None, None, 1)
    fabric, system = simulation.fabric, simulation.system
    springs = fabric.springs
    assert springs is not None
    return Sheet(
        x=fabric.position.copy(),
        mass=fabric.mass,
        pinned=fabric.pinned,
        pairs=springs.pairs().astype(np.int64),
        k=springs.per_spring(springs.k),
        rest=springs.per_spring(springs.rest),
        c=springs.per_spring(springs.c),
        gravity=np.asarray(system.gravity, np.float64),
        drag=np.full((), system.damping),
    )


def measure_all(kinds: list[Kind], left_out: list[str], repeats: int, limit: float) -> shown.Found:
    """Points of every kind that is installed, against the converged run of ours."""
    sheet = stiff_sheet()
    print("the converged run ...", file=sys.stderr)
    exact = stiff.run(*stiff.REFERENCE)
    points: list[Point] = []
    for kind in kinds:
        for setting in () if kind.missing else kind.settings:
            print(f"{kind.name}, {label(setting)} ...", file=sys.stderr)
            points.append(measure(kind, setting, label(setting), sheet, exact.x, repeats, limit))
    return shown.Found(kinds, points, left_out, exact.seconds)
