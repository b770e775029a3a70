"""`nuno bench speed`: every measured bar as a named case, medians and spread, compile time apart."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import traceback
from collections.abc import Iterable

from nuno_bench import extras, machine, options
from nuno_bench.report import markdown
from nuno_bench.report.result import HEADINGS, Result, number, rows, text_table
from nuno_bench.speed import limits

CASES = {
    "grid-256": ("nuno_bench.speed.steps.explicit", "grid_256"),
    "net-256": ("nuno_bench.speed.steps.explicit", "net_256"),
    "irregular": ("nuno_bench.speed.steps.explicit", "irregular"),
    "sheet-32": ("nuno_bench.speed.steps.explicit", "sheet_32"),
    "numpy": ("nuno_bench.speed.steps.explicit", "numpy_slices"),
    "stiff": ("nuno_bench.speed.steps.stiff", "stiff_sheet"),
    "scipy": ("nuno_bench.speed.steps.scipy", "scipy_peer"),
    "stiffness": ("nuno_bench.speed.steps.stiffness", "stiffness"),
    "closest": ("nuno_bench.speed.leg.closest", "closest"),
    "fit": ("nuno_bench.speed.leg.fit", "fits"),
    "sdf": ("nuno_bench.speed.leg.sdf", "sdf"),
    "wrinkle": ("nuno_bench.speed.wrinkle", "wrinkle"),
    "render": ("nuno_bench.speed.leg.render", "render"),
    "dye": ("nuno_bench.speed.dye", "dye"),
    "pipeline": ("nuno_bench.speed.pipeline", "pipeline"),
    "start": ("nuno_bench.speed.processes", "start"),
    "memory": ("nuno_bench.speed.processes", "memory"),
    "recording": ("nuno_bench.speed.pipeline", "recording"),
}
"""Module and function of each case; a function takes the number of repeats and gives results."""


NEEDS = {"scipy": ("scipy",)}
"""Packages without which a case cannot be measured."""
PEERS = {"closest": ("rtree", "igl", "open3d"), "dye": ("devito",)}
"""Packages beside which a case is measured where they are installed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"which to run (default: all): {', '.join(CASES)}")
    options.add_repeats(parser, 7, "samples of each figure")
    options.add_shared(parser, "--json", "--html", "--docs")


def main(args: argparse.Namespace) -> int:
    """Run the cases; 1 if any could not be measured. A missed bar is a finding, not a failure."""
    options.require_known(args.cases, CASES, "case", "CASE")
    options.require_repeats(args.repeats)
    if args.docs is not None:
        markdown.check_section(args.docs, _section(args.cases))
    if args.html is not None:
        from nuno_bench.report.plots import require_matplotlib

        require_matplotlib()
    for name in args.cases:
        extras.require(f"the case {name} needs", NEEDS.get(name, ()), "CASE")
    lacking = _tell_lacking(args.cases or CASES)
    others = machine.Others()
    results: list[Result] = []
    for name in (name for name in args.cases or CASES if not extras.missing(NEEDS.get(name, ()))):
        print(f"{name} ...", file=sys.stderr)
        results += run_case(name, args.repeats)
    about = machine.describe() | {"load": others.describe()} | lacking | _limits(results)
    _show(results, about)
    _write(args, results, about)
    return 1 if any(result.failure for result in results) else 0


def _tell_lacking(cases: Iterable[str]) -> dict[str, str]:
    """What is left out for a package that is not installed, by what lacks it; said before anything runs."""
    lacking = {f"{name} is left out": extras.missing(NEEDS.get(name, ())) for name in cases}
    lacking |= {f"{name} has fewer peers": extras.missing(PEERS.get(name, ())) for name in cases}
    said = {what: extras.told(packages) for what, packages in lacking.items() if packages}
    for what, text in said.items():
        print(f"{what}: {text}", file=sys.stderr)
    return said


def run_case(name: str, repeats: int) -> list[Result]:
    """A case's results; one that fails gives a result that says why."""
    module, function = CASES[name]
    try:
        results: list[Result] = getattr(importlib.import_module(module), function)(repeats)
    except Exception as error:  # any failure is a finding about this case, and others still count
        traceback.print_exc()
        return [Result(name, "could not be measured", "", failure=f"{type(error).__name__}: {error}")]
    return results


def _limits(results: list[Result]) -> dict[str, str]:
    if not any(result.limit for result in results):
        return {}
    roots, memory = limits.inverse_roots(), limits.bandwidth()
    text = f"{roots * 1e-9:.2f} billion 1/sqrt a second (float64, all cores), {memory * 1e-9:.0f} GB/s from memory"
    return {"limits": f"{text}; 6 springs computed a vertex allow {roots / 6e6:.0f} million vertex-steps/s"}


def _show(results: list[Result], about: dict[str, str]) -> None:
    print(text_table(HEADINGS, rows(results)))
    notes = {f"{r.case}, {r.what}": r.failure or r.note for r in results if r.failure or r.note}
    print()
    for name, text in (notes | about).items():
        print(f"{name}: {text}")
    print(summary(results))


def summary(results: list[Result]) -> str:
    """One sentence: how many bars were met, which were not."""
    judged = [r for r in results if r.bar is not None or r.failure]
    missed = [f"{r.case} ({r.what}: {number(r.median)} {r.unit})" for r in judged if r.verdict == "missed"]
    failed = [r.case for r in judged if r.verdict == "failed"]
    text = f"{len(judged) - len(missed) - len(failed)} of {len(judged)} bars met"
    text += f"; missed: {', '.join(missed)}" if missed else ""
    return text + (f"; could not be measured: {', '.join(failed)}" if failed else "")


def _section(cases: list[str]) -> str:
    """Of a page: all cases together have one, and some of them one of their own."""
    return " ".join(["speed", *cases])


def _write(args: argparse.Namespace, results: list[Result], about: dict[str, str]) -> None:
    if args.json is not None:
        data = {"command": machine.command(), "machine": about, "results": [result.json() for result in results]}
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps(data, indent=1) + "\n")
        print(f"written {args.json}")
    if args.html is not None:
        from nuno_bench.speed.page import write_page

        write_page(args.html, results, about, summary(results))
        print(f"written {args.html}")
    if args.docs is not None:
        text = [summary(results) + ".", markdown.table(HEADINGS, rows(results))]
        markdown.replace_section(
            args.docs, _section(args.cases), [*text, markdown.facts({"command": machine.command(), **about})]
        )
        print(f"written {args.docs}")
