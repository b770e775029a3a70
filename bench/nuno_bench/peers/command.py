"""`nuno bench peers`: the same cloth in other engines and in ours, in the same run: what comes of it beside time."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from nuno_bench import machine, options
from nuno_bench.peers.page import Comparison, SheetComparison, versions
from nuno_bench.peers.pile import PileComparison, PileSolver, ask, five_sheets, look
from nuno_bench.peers.problem import REFERENCE, SECONDS, judge
from nuno_bench.peers.process import PILE_KINDS, SHEET_KINDS, SKIRT_KINDS, Engine, EnginePoint, S, measure
from nuno_bench.peers.python import Nuno, stiff_sheet
from nuno_bench.peers.skirt import DURATION, SkirtComparison, converge, hula_skirt
from nuno_bench.peers.skirt import look as look_at_skirt
from nuno_bench.report import page, plots
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float


@dataclass(frozen=True)
class Scene:
    """A problem that engines are compared on.

    says     what is compared
    section  of the documentation
    kinds    of engines
    require  raises BadInput where something is missing that it cannot be without
    measure  kinds, what is left out, what was asked for (repeats, limit, duration [s]): all that is found
    """

    says: str
    section: str
    kinds: Sequence[Engine]
    require: Callable[[], None]
    measure: Callable[[list[Engine], list[str], argparse.Namespace], Comparison[Any]]


def peers_arguments(parser: argparse.ArgumentParser) -> None:
    scenes = "; ".join(f"{name}: {scene.says}" for name, scene in SCENES.items())
    parser.add_argument(
        "scene", nargs="?", choices=list(SCENES), default="sheet", help=f"{scenes} (default: %(default)s)"
    )
    names = "; ".join(f"{name}: {', '.join(groups(scene.kinds))}" for name, scene in SCENES.items())
    parser.add_argument("--only", metavar="NAME,NAME", help=f"which engines (default: all installed); {names}")
    options.add_count(parser, "--repeats", "runs at each setting (default: %(default)s)", 3)
    options.add_seconds(parser, "--duration", DURATION, "simulated time, of the skirt alone")
    limit = "wall time of a setting, start and all; no repeats after a third of it"
    options.add_seconds(parser, "--limit", 200.0, limit)
    options.add_shared(parser, "--out", "--html", "--docs")


def peers_command(args: argparse.Namespace) -> int:
    """Run every setting, print the tables, write page and JSON. A peer that breaks is a finding."""
    scene = SCENES[args.scene]
    if args.scene != "skirt" and args.duration != DURATION:
        problem, remedy = f"what is said of the {args.scene} is of {SECONDS:g} s", "nuno bench peers skirt takes others"
        raise BadInput(problem, field="--duration", value=f"{args.duration:g} s", remedy=remedy)
    scene.require()
    kinds = choose(scene.kinds, args.only)
    left_out = leave_out(kinds, args.only)
    page.check_section(args.docs, scene.section)
    others = machine.OtherLoad()
    found = scene.measure(kinds, left_out, args)
    used = [kind.package for kind in kinds if kind.package and not kind.missing]
    for table in page.nonempty(found.tables()):
        print(table.text() if isinstance(table, page.Table) else table)
    for text in [*map(": ".join, found.notes().rows), *found.verdicts(), *left_out]:
        print(text)
    report = found.report(machine.about(others, peers=versions(used)))
    base = args.out / scene.section.replace(" ", "-")
    report.write(args.html or base.with_suffix(".html"), base.with_suffix(".json"), args.docs, scene.section)
    return 0


def points_of(
    kinds: Sequence[Engine], posed: object, score: Callable[[Float], S], asked: argparse.Namespace,
    seconds: float = SECONDS,
) -> Iterator[EnginePoint[S]]:  # fmt: skip
    """Yield the points of every installed engine at all of its settings."""
    for kind in kinds:
        for name in () if kind.missing else kind.settings:
            print(f"{kind.name}, {name} ...", file=sys.stderr)
            yield measure(kind, name, posed, score, asked.repeats, asked.limit, seconds)


def measure_sheet(kinds: list[Engine], left_out: list[str], asked: argparse.Namespace) -> SheetComparison:
    """Compare engines on the stiff sheet with our converged run."""
    sheet = stiff_sheet()
    print("the converged run ...", file=sys.stderr)
    converged, begin = Nuno(sheet, REFERENCE), time.perf_counter()
    exact = converged.advance(SECONDS)
    taken, score = time.perf_counter() - begin, partial(judge, sheet, exact=exact)
    return SheetComparison(kinds, list(points_of(kinds, sheet, score, asked)), left_out, taken)


def measure_contact(kinds: list[Engine], left_out: list[str], asked: argparse.Namespace) -> PileComparison:
    """Judge every engine's frames of the pile, and ask ipctk questions about ours."""
    pile = five_sheets()
    points = list(points_of(kinds, pile, partial(look, pile), asked))
    answers = []
    if any(kind.name == "ipctk" for kind in kinds):
        print("questions to ipctk ...", file=sys.stderr)
        answers = ask(pile, PileSolver(pile, "plugin: symplectic_euler, dt: auto").advance(SECONDS), asked.repeats)
    return PileComparison(kinds, points, left_out, answers)


def measure_skirt(kinds: list[Engine], left_out: list[str], asked: argparse.Namespace) -> SkirtComparison:
    """Compare engines on the skirt with our converged run; another run checks that one."""
    print("the lead-in and the converged runs ...", file=sys.stderr)
    skirt = hula_skirt(asked.duration, threads=machine.cores())
    exact, points = converge(skirt, asked.duration)
    points += points_of(kinds, skirt, partial(look_at_skirt, skirt, exact=exact), asked, asked.duration)
    return SkirtComparison(kinds, points, left_out, skirt)


def groups(kinds: Sequence[Engine]) -> dict[str, list[Engine]]:
    """Return the engines that each name of --only stands for: all solvers of an engine, or one."""
    found: dict[str, list[Engine]] = {}
    for kind in kinds:
        if (engine := kind.name.partition("-")[0]) != kind.name:
            found.setdefault(engine, []).append(kind)
    return found | {kind.name: [kind] for kind in kinds}


def choose(kinds: Sequence[Engine], only: str | None) -> list[Engine]:
    """Kinds by their names, or by the engine's. Raises BadInput for any other name."""
    known, names = groups(kinds), options.names_of(only)
    options.require_known(names, known, "peer", "--only")
    chosen = [kind for name in names for kind in known[name]]
    return [kind for kind in kinds if not names or kind in chosen]


def leave_out(kinds: Sequence[Engine], only: str | None) -> list[str]:
    """Return a sentence for each package that is not installed, with the way to install it; print it first.

    Raises BadInput where the user asked for one by name.
    """
    lacking: dict[str, list[str]] = {}
    for kind in (kind for kind in kinds if kind.missing):
        lacking.setdefault(kind.package, []).append(kind.name)
        if only:
            options.require_package(f"{only} needs", kind.package, "--only")
    texts = [f"left out, {', '.join(names)}: {options.missing_package(package)}" for package, names in lacking.items()]
    for text in texts:
        print(text, file=sys.stderr)
    return texts


SCENES = {
    "sheet": Scene("the stiff sheet, its error beside time", "peers", SHEET_KINDS, plots.require_matplotlib,
                   measure_sheet),
    "contact": Scene("cloth that falls on cloth, its crossings beside time", "peers contact", PILE_KINDS,
                     partial(options.require_package, "cloth is looked at by", "ipctk"), measure_contact),
    "skirt": Scene("a skirt on a dancer, its error and crossings beside time", "peers skirt", SKIRT_KINDS,
                   plots.require_matplotlib, measure_skirt),
}  # fmt: skip
