"""`nuno bench peers`: the stiff sheet in other engines and in ours, in the same run: error beside time."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

from nuno_bench import extras, machine, options
from nuno_bench.peers import page as shown
from nuno_bench.peers.problem import REFERENCE, SECONDS
from nuno_bench.peers.process import measure
from nuno_bench.peers.python import Nuno, stiff_sheet
from nuno_bench.peers.table import KINDS, Kind
from nuno_bench.report import page, plots

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
    page.check_section(args.docs, "peers")
    others = machine.Others()
    found = measure_all(kinds, left_out, args.repeats, args.limit)
    used = [kind.package for kind in kinds if kind.package and not kind.missing]
    print(shown.settings(found).text())
    for text in [*map(": ".join, shown.notes(found).rows), *shown.verdicts(found), *found.left_out]:
        print(text)
    report = shown.report(found, machine.about(others, peers=shown.versions(used)))
    report.write_beside(args.out / "peers", args.docs, "peers")
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
            extras.require(f"{only} needs", kind.package, "--only")
    told = [f"left out, {', '.join(names)}: {extras.missing(package)}" for package, names in lacking.items()]
    for text in told:
        print(text, file=sys.stderr)
    return told


def measure_all(kinds: list[Kind], left_out: list[str], repeats: int, limit: float) -> shown.Found:
    """Points of every kind that is installed, against the converged run of ours."""
    sheet = stiff_sheet()
    print("the converged run ...", file=sys.stderr)
    converged, begin = Nuno(sheet, REFERENCE), time.perf_counter()
    exact = converged.advance(SECONDS)
    taken, points = time.perf_counter() - begin, []
    for kind in kinds:
        for name in () if kind.missing else kind.settings:
            print(f"{kind.name}, {name} ...", file=sys.stderr)
            points.append(measure(kind, name, sheet, exact, repeats, limit))
    return shown.Found(kinds, points, left_out, taken)
