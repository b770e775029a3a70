"""`nuno validate`: the laws of physics, held against every installed solver."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from nuno_bench import machine, options
from nuno_bench.report import page, plots
from nuno_bench.report.page import Figure, Part, Report, Sections, Table
from nuno_bench.report.plots import Curve, Panel, draw
from nuno_bench.report.result import number
from nuno_bench.sweep import places
from nuno_bench.validation import suite
from nuno_bench.validation.laws.base import Outcome
from nuno_schemas.errors import BadInput

ABREAST = 5
"""Solvers beside each other on a screen."""
LEAD = (
    "Laws with closed forms, held against every installed solver through the plugin interface alone. A cell gives "
    "the error, in the case's own measure; a case that a solver cannot pose is unsupported, not passed."
)


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
    print("\n\n".join(case_tables(part, outcomes) for part in parts))
    print("\n".join(["", *map(describe_bad, bad_table(outcomes).rows), suite.summary(parts, outcomes)]))
    report(parts, outcomes, machine.about(others)).write(args.html, args.json, args.docs, "validate")
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


def case_tables(part: suite.Part, outcomes: Sequence[Outcome]) -> str:
    """Cases as rows, solvers as columns, in as many tables as there are groups of solvers."""
    groups = [part.solvers[i : i + ABREAST] for i in range(0, len(part.solvers), ABREAST)]
    return "\n\n".join(Table(("case", *group), _cells(part, group, outcomes)).text() for group in groups)


def _cells(part: suite.Part, solvers: Sequence[str], outcomes: Sequence[Outcome]) -> list[list[str]]:
    """A row a case: its name, then a cell a solver."""
    table = {(o.case, o.solver): o for o in outcomes}
    return [[case.name, *(_cell(table[case.name, name]) for name in solvers)] for case in part.cases]


def _cell(outcome: Outcome) -> str:
    if outcome.verdict == "passed" and outcome.found:
        return short_error(outcome.found.error)
    return "-" if outcome.verdict == "unsupported" else outcome.verdict


def short_error(error: float) -> str:
    """An error in as few characters as say its size."""
    if not math.isfinite(error):
        return str(error)
    return "0" if error == 0.0 else f"{error:.0e}".replace("e-0", "e-").replace("e+0", "e+")


def error_table(part: suite.Part, outcomes: Sequence[Outcome]) -> Table:
    """Case, what it allows, a cell a solver."""
    rows = []
    for case, *cells in _cells(part, part.solvers, outcomes):
        allowed = [o.found.allowed for o in outcomes if o.case == case and o.found]
        low, high = (short_error(min(allowed)), short_error(max(allowed))) if allowed else ("", "")
        rows.append([case, low if low == high else f"{low} to {high}", *cells])
    return Table(["case", "allowed", *part.solvers], rows, f"Errors of solvers of {part.of}; a dash is unsupported.")


def bad_table(outcomes: Sequence[Outcome]) -> Table:
    """A row for each failure, and one for all slips of a solver."""
    rows = []
    for outcome in (o for o in outcomes if o.verdict == "failed"):
        found = outcome.found
        figures = f"measured {number(found.measured)}, expected {number(found.expected)}; " if found else ""
        rows.append(["failed", outcome.case, outcome.solver, figures + outcome.reason])
    rows += [["slip", cases, solver, reason] for solver, reason, cases in _by_reason(outcomes, "slip")]
    return Table(("", "case", "solver", "why"), rows, "A slip is announced by the solver itself.", prose=True)


def describe_bad(row: Sequence[str]) -> str:
    """What is bad, on a screen."""
    verdict, cases, solver, why = row
    return f"failed: {cases}, {solver}: {why}" if verdict == "failed" else f"slip: {solver}, {why}: {cases}"


def _by_reason(outcomes: Sequence[Outcome], verdict: str) -> list[list[str]]:
    """Rows of solver, reason and cases; numbers of steps in a reason differ by case, and are left out."""
    found: dict[tuple[str, str], list[str]] = {}
    for outcome in (o for o in outcomes if o.verdict == verdict):
        reason = "it would take too many steps" if outcome.reason.startswith("it would take") else outcome.reason
        found.setdefault((outcome.solver, reason), []).append(outcome.case)
    return [[solver, reason, ", ".join(cases)] for (solver, reason), cases in found.items()]


def convergence_figures(case: str, outcomes: Sequence[Outcome]) -> list[Part]:
    """Error over step of every solver, for a case that is of an order; nothing for any other."""
    own = [(o.solver, o.found) for o in outcomes if o.case == case and case.startswith("order") and o.found]
    lines = [
        Curve(f"{solver}: {f.measured:.2f}", np.array(f.series["dt"]), np.array(f.series["error"]), i, i % 2 == 1)
        for i, (solver, f) in enumerate(own)
    ]
    drawn = [draw([Panel("error [m, m/s]", lines, "step [s]", log="xy")])] if lines else []
    return [Figure(one, "Error over step, with the fitted order of each solver.") for one in drawn]


def report(parts: Sequence[suite.Part], outcomes: Sequence[Outcome], about: Mapping[str, str]) -> Report:
    """The page: counts, the table, what failed or was not posed, the laws, every figure."""
    cases = [case for part in parts for case in part.cases]
    laws = [[case.name, case.law, case.source] for case in cases]
    figures = [
        [o.case, o.solver, number(o.found.measured), number(o.found.expected), short_error(o.found.error),
         short_error(o.found.allowed), f"{o.seconds:.2f}"]
        for o in outcomes if o.found
    ]  # fmt: skip
    heads = ("case", "solver", "measured", "expected", "error", "allowed", "time [s]")
    lacking = ("solver", "unsupported because", "cases")
    unposed = Table(lacking, _by_reason(outcomes, "unsupported"), "Cases not posed.", prose=True)
    said = suite.summary(parts, outcomes)
    brief: list[Part] = [f"{said[0].upper()}{said[1:]}.", *(error_table(part, outcomes) for part in parts)]
    sections: Sections = [
        ("What came out", brief),
        ("What failed", [bad_table(outcomes)]),
        ("Unsupported", [unposed]),
        *((case.name.capitalize(), convergence_figures(case.name, outcomes)) for case in cases),
        ("Laws", [Table(("case", "law", "from"), laws, "What is measured.", prose=True)]),
        ("Figures", [Table(heads, figures, "Every case that was posed.")]),
    ]
    data = {"counts": suite.count(outcomes), "outcomes": outcomes}
    return Report("Laws", LEAD, sections, about, data, [*brief, unposed])
