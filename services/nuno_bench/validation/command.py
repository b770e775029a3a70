"""`nuno validate`: the laws of physics, held against every installed solver."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from nuno_bench import machine, options
from nuno_bench.report import page, plots
from nuno_bench.sweep import places
from nuno_bench.validation import page as shown
from nuno_bench.validation import suite
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cases", nargs="*", metavar="CASE", help="cases by name or its beginning (default: all)")
    options.add_shared(parser, "--solvers", "--json", "--html", "--docs")
    places.add_arguments(parser)
    parser.add_argument("--list", action="store_true", help="name the cases and their laws, and run nothing")


def main(args: argparse.Namespace) -> int:
    """Run the cases, print the table; the exit code is 1 where a solver failed one."""
    parts = suite.choose_parts(args.cases, options.names_of(args.solvers))
    if args.list:
        cases = [case for part in parts for case in part.cases]
        width = max(len(case.name) for case in cases)
        print("\n".join(f"{case.name:{width}}  {case.law} ({case.source})" for case in cases))
        return 0
    _check_files(args)
    others = machine.Others()
    with places.opened(args) as where:
        outcomes = suite.check_all(parts, where, lambda text: print(text, file=sys.stderr))
    print("\n\n".join(shown.screen(part, outcomes) for part in parts))
    print("\n".join(["", *map(shown.line, shown.bad(outcomes).rows), suite.summary(parts, outcomes)]))
    shown.report(parts, outcomes, machine.about(others)).write(args.html, args.json, args.docs, "validate")
    return int(any(outcome.verdict == "failed" for outcome in outcomes))


def _check_files(args: argparse.Namespace) -> None:
    """Raises BadInput, before anything runs, for what could not be written afterwards."""
    if args.html is not None:
        plots.require_matplotlib()
    for flag in ("json", "html"):
        path: Path | None = getattr(args, flag)
        if path is not None and not path.resolve().parent.is_dir():
            raise BadInput("no such folder", field=f"--{flag}", value=str(path.parent), remedy="make it first")
    page.check_section(args.docs, "validate")
