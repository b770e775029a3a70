"""`nuno validate`: the laws of physics, held against every installed solver."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from nuno_bench import machine, options
from nuno_bench.report import markdown, plots
from nuno_bench.sweep import executor, places
from nuno_bench.sweep.kept import Kept, hint, require
from nuno_bench.validation import page as shown
from nuno_bench.validation import suite
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cases", nargs="*", metavar="CASE", help="cases by name or its beginning (default: all)")
    options.add_shared(parser, "--solvers", "--resume", "--out", "--json", "--html", "--docs")
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
    places.check(args)
    path = args.out / "validate.rows.jsonl"
    if args.resume:
        require([path])
    asked = [[[case.name for case in part.cases], list(part.solvers)] for part in parts]
    with places.opened(args) as where:
        kept = Kept(path, {"parts": asked, "versions": executor.versions()}, args.resume)
        with hint(kept.path):
            outcomes = suite.check_all(parts, where, kept, lambda text: print(text, file=sys.stderr))
    kept.path.unlink()
    said, counts = suite.summary(parts, outcomes), suite.count(outcomes)
    print("\n\n".join(shown.screen(part, outcomes) for part in parts))
    print("\n".join(["", *shown.details(outcomes), said]))
    about = {"command": machine.command(), **machine.describe()}
    if args.json is not None:
        content = {"about": about, "counts": counts, "outcomes": [outcome.json() for outcome in outcomes]}
        args.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    if args.html is not None:
        args.html.write_text(shown.render(parts, outcomes, said, about), encoding="utf-8")
    if args.docs is not None:
        markdown.replace_section(args.docs, "validate", shown.document(parts, outcomes, said, about))
    for path in (args.json, args.html, args.docs):
        if path is not None:
            print(f"written {path}")
    return 1 if counts["failed"] else 0


def _check_files(args: argparse.Namespace) -> None:
    """Raises BadInput, before anything runs, for what could not be written afterwards."""
    if args.html is not None:
        plots.require_matplotlib()
    for flag in ("json", "html"):
        path: Path | None = getattr(args, flag)
        if path is not None and not path.resolve().parent.is_dir():
            raise BadInput("no such folder", field=f"--{flag}", value=str(path.parent), remedy="make it first")
    if args.docs is not None:
        markdown.check_section(args.docs, "validate")
