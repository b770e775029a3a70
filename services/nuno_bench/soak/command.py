"""`nuno soak`: what must hold however long, whatever breaks and whoever asks; each part in figures."""

from __future__ import annotations

import argparse
import importlib
import sys
import traceback
from collections.abc import Callable, Iterable

from nuno_bench import extras, machine, options
from nuno_bench.report import markdown
from nuno_bench.report.result import Result, number, text_table

PARTS: dict[str, str] = {
    "same-bits": "nuno_bench.soak.same_bits.part",
    "access": "nuno_bench.soak.access.part",
    "faults": "nuno_bench.soak.faults.part",
    "lost": "nuno_bench.soak.lost.part",
    "hosts": "nuno_bench.soak.hosts.part",
    "fuzz": "nuno_bench.soak.fuzz.part",
}
"""Module of each part; its `run(quick, seed)` gives results, of which every bar is a law: a missed one is a failure."""

NEEDS = {"fuzz": ("atheris", "coverage")}
"""Packages without which a part cannot be run."""
LOOKS = {"same-bits": ("rerun",), "access": ("rerun",)}
"""Packages without which a part tries less."""

HEADINGS = ("case", "what", "found", "must be", "verdict")
VERDICTS = {"bar met": "holds", "aim met": "holds", "missed": "BROKEN", "failed": "FAILED", "": ""}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"which to run (default: all): {', '.join(PARTS)}")
    parser.add_argument("--quick", action="store_true", help="a small share of each, for a look")
    parser.add_argument("--seed", type=int, default=0, help="what random moments and inputs are drawn from (0)")
    options.add_shared(parser, "--docs")


def main(args: argparse.Namespace) -> int:
    """Run the parts one after the other; 1 if anything that must hold does not."""
    options.require_known(args.parts, PARTS, "part", "PART")
    for part in args.parts:
        extras.require(f"the part {part} needs", NEEDS.get(part, ()), "PART")
    parts = args.parts or [part for part in PARTS if not extras.missing(NEEDS.get(part, ()))]
    _tell_lacking(args.parts or PARTS)
    if args.docs is not None:
        for part in parts:
            markdown.check_section(args.docs, f"soak {part}")
    broken = 0
    for part in parts:
        print(f"{part} ...", file=sys.stderr)
        others = machine.Others()
        results = run_part(part, args.quick, args.seed)
        about = machine.describe() | {"load": others.describe()}
        broken += show(part, results)
        if args.docs is not None:
            how = f"nuno soak {part} --seed {args.seed}{' --quick' if args.quick else ''}"
            section = [summary(results), markdown.table(HEADINGS, rows(results)), *notes(results)]
            markdown.replace_section(args.docs, f"soak {part}", [*section, markdown.facts({"command": how, **about})])
    return int(broken > 0)


def _tell_lacking(parts: Iterable[str]) -> None:
    """Say before anything runs what is left out, and how it need not be."""
    for part in parts:
        if lacking := extras.missing(NEEDS.get(part, ())):
            print(f"{part} is left out: {extras.told(lacking)}", file=sys.stderr)
        if lacking := extras.missing(LOOKS.get(part, ())):
            print(f"{part} tries no viewer: {extras.told(lacking)}", file=sys.stderr)


def run_part(part: str, quick: bool, seed: int) -> list[Result]:
    """A part's results; one that fails as a whole gives a result that says why."""
    try:
        run: Callable[[bool, int], list[Result]] = importlib.import_module(PARTS[part]).run
        return run(quick, seed)
    except Exception as error:  # what the part is about did not hold, and the other parts still count
        traceback.print_exc()
        return [Result(part, "could not be run", "", failure=f"{type(error).__name__}: {error}")]


def show(part: str, results: list[Result]) -> int:
    """Print the table; gives how many results are not what they must be."""
    print(text_table(HEADINGS, rows(results)))
    for line in notes(results):
        print(line)
    print(f"{part}: {summary(results)}")
    return len([r for r in results if r.verdict in ("missed", "failed")])


def rows(results: list[Result]) -> list[list[str]]:
    """One row of text per result, under HEADINGS; of several samples the median and what they lie between."""
    table = []
    for result in results:
        found, wanted = "-", ""
        if result.samples:
            found = number(result.median)
            if len(result.samples) > 1:
                found += f" ({number(min(result.samples))} to {number(max(result.samples))})"
            found = f"{found} {result.unit}".rstrip()
        if result.bar is not None:
            wanted = f"at {'most' if result.at_most else 'least'} {number(result.bar)}"
        table.append([result.case, result.what, found, wanted, VERDICTS[result.verdict]])
    return table


def summary(results: list[Result]) -> str:
    """One sentence: how much of what must hold does, and what does not."""
    judged = [r for r in results if r.verdict]
    broken = [r for r in judged if r.verdict in ("missed", "failed")]
    text = f"{len(judged) - len(broken)} of {len(judged)} hold"
    named = [f"{r.case} ({r.failure or f'{r.what}: {number(r.median)} {r.unit}'})" for r in broken]
    return f"{text}; not: {', '.join(named)}." if broken else f"{text}."


def notes(results: list[Result]) -> list[str]:
    """What the table has no room for."""
    return [f"{r.case}, {r.what}: {r.failure or r.note}" for r in results if r.failure or r.note]
