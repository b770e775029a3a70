"""`nuno bench speed`: every measured bar as a named case, medians and spread, compile time apart."""

from __future__ import annotations

import argparse
import importlib
import sys
import traceback
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

from nuno_bench import machine, options
from nuno_bench.report import page
from nuno_bench.report.page import Table
from nuno_bench.report.result import Result, number, table
from nuno_bench.speed import record
from nuno_schemas.errors import BadInput

CASES = {
    "grid-256": "steps:grid_256",
    "net-256": "steps:net_256",
    "sheet-32": "steps:sheet_32",
    "membrane": "steps:membrane",
    "numbering": "steps:numbering",
    "stiff": "steps:stiff_sheet",
    "stiffness": "steps:stiffness",
    "closest": "leg:closest",
    "fit": "leg:fits",
    "sdf": "leg:sdf",
    "contact": "contact:contact",
    "wrinkle": "wrinkle:wrinkle",
    "render": "leg:render",
    "dye": "dye:dye",
    "pipeline": "processes:pipeline",
    "live": "live:live",
    "studio": "studio:studio",
    "start": "processes:start",
    "memory": "processes:memory",
}
"""Module beside this one and function of each case; a function takes the number of repeats and gives results."""
PEERS = {"closest": ("rtree", "igl", "open3d")}
"""Packages beside which a case is measured where they are installed."""
LEAD = (
    "Medians over repeats with the smallest and the largest sample. "
    "The first call, which compiles or loads, is in none of them."
)
OF_LIMIT = (
    "Of limit: the share of what this machine's reciprocal square roots allow; of dye, its memory at a step a pass."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"which to run (default: all): {', '.join(CASES)}")
    options.add_count(parser, "--repeats", "samples of each figure (default: %(default)s)", 7)
    options.add_shared(parser, "--json", "--html", "--docs")
    for name, what in (("--save", "append this run to"), ("--against", "tell what is slower or faster than in")):
        what += " a record of speed (default: the repository's)"
        parser.add_argument(name, nargs="?", type=Path, const=True, metavar="FILE", help=what)


def main(args: argparse.Namespace) -> int:
    """Run the cases; 1 if any could not be measured or has become slower. A missed bar is a finding, not a failure."""
    options.require_known(args.cases, CASES, "case", "CASE")
    section = " ".join(["speed", *args.cases])
    page.check_section(args.docs, section)
    save, against = _record(args.save, "--save"), _record(args.against, "--against")
    before = record.read_of_machine(against) if against else []
    if save and save.exists():
        record.read(save)  # so that a line is added to no other file
    lacking = _tell_lacking(args.cases or CASES)
    others = machine.Others()
    results: list[Result] = []
    for name in args.cases or CASES:
        print(f"{name} ...", file=sys.stderr)
        results += run_case(name, args.repeats)
    load = others.share()
    about = machine.about(others) | lacking | _limits(results)
    figures, said = table(results, OF_LIMIT), f"{summary(results)}."
    print(figures.text(), end="\n\n")
    for text in (*map(": ".join, notes(results)), *map(": ".join, about.items()), said):
        print(text)
    noted = Table(("what", "note"), notes(results), "Sizes, and what failed.", prose=True)
    changes = record.compare(before, results) if against else []
    since = record.describe_changes(changes, load) if against else []
    for part in since:
        print(part if isinstance(part, str) else f"\n{part.text()}\n")
    sections: page.Sections = [("", [said]), ("All figures", [figures]), ("Since", since), ("Notes", [noted])]
    data = {"results": [vars(one) | {"verdict": one.verdict} for one in results]}
    report = page.Report("Speed", LEAD, sections, about, data, [said, figures])
    report.write(args.html, args.json, args.docs, section)
    if save:
        record.append(save, record.Record.of(results, load))
        print(f"written {save}")
    return int(any(result.failure for result in results) or any(change.verdict == "slower" for change in changes))


def _record(given: Path | Literal[True] | None, field: str) -> Path | None:
    """The file of an option: the repository's where none is named."""
    if given is True:
        return record.own_file(field)
    if given and str(given) in CASES:
        raise BadInput("this is a case, and no file", field=field, value=str(given), remedy=f"name it before {field}")
    return given


def _tell_lacking(cases: Iterable[str]) -> dict[str, str]:
    """Cases whose peers are not installed, and how they are; said before anything runs."""
    lacking = {name: ", ".join(filter(None, map(options.missing_package, PEERS.get(name, ())))) for name in cases}
    said = {f"{name} has fewer peers": text for name, text in lacking.items() if text}
    for what, text in said.items():
        print(f"{what}: {text}", file=sys.stderr)
    return said


def run_case(name: str, repeats: int) -> list[Result]:
    """A case's results; one that fails gives a result that says why."""
    module, _, function = CASES[name].partition(":")
    try:
        case = getattr(importlib.import_module(f"nuno_bench.speed.{module}"), function)
        results: list[Result] = case(repeats)
    except Exception as error:  # any failure is a finding about this case, and others still count
        traceback.print_exc()
        return [Result(name, "could not be measured", "", failure=f"{type(error).__name__}: {error}")]
    return results


def _limits(results: list[Result]) -> dict[str, str]:
    if not any(result.limit for result in results):
        return {}
    from nuno_bench.speed.timing import bandwidth, inverse_roots

    roots, memory = inverse_roots(), bandwidth()
    text = f"{roots * 1e-9:.2f} billion 1/sqrt a second (float64, all cores), {memory * 1e-9:.0f} GB/s from memory"
    return {"limits": f"{text}; 6 springs computed a vertex allow {roots / 6e6:.0f} million vertex-steps/s"}


def notes(results: Sequence[Result]) -> list[tuple[str, str]]:
    """Each figure's name, and why it failed or what is to say of it."""
    return [(f"{r.case}, {r.what}", r.failure or r.note) for r in results if r.failure or r.note]


def summary(results: Sequence[Result]) -> str:
    """One sentence: how many bars were met, which were not."""
    judged = [r for r in results if r.bar is not None or r.failure]
    missed = [f"{r.case} ({r.what}: {number(r.median)} {r.unit})" for r in judged if r.verdict == "missed"]
    failed = [r.case for r in judged if r.verdict == "failed"]
    text = f"{len(judged) - len(missed) - len(failed)} of {len(judged)} bars met"
    text += f"; missed: {', '.join(missed)}" if missed else ""
    return text + (f"; could not be measured: {', '.join(failed)}" if failed else "")
