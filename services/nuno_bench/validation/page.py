"""What `nuno validate` shows: a table for a screen, a page, a section of the documentation."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nuno_bench.report import markdown, page, plots
from nuno_bench.report.plots import Curve
from nuno_bench.report.result import number
from nuno_bench.validation.laws.base import Case, Found, Outcome
from nuno_bench.validation.suite import Part

LEAST, MOST = 1e-12, 1e3
"""Shares of what is allowed beyond these, such as 0, are drawn there."""
WIDTH = 120
"""Columns of a screen."""
LEAD = (
    "Laws with closed forms, held against every installed solver through the plugin interface alone. A cell gives "
    "the error, in the case's own measure; a case that a solver cannot pose is unsupported, not passed."
)


def screen(part: Part, outcomes: Sequence[Outcome]) -> str:
    """Cases as rows, solvers as columns, in as many tables as a screen's width asks for."""
    cases, solvers = part.cases, part.solvers
    table = {(o.case, o.solver): o for o in outcomes}
    first = max(len(case.name) for case in cases)
    widths = {name: max(7, *map(len, name.split("_"))) for name in solvers}
    groups: list[list[str]] = [[]]
    for name in solvers:
        if first + sum(widths[n] + 1 for n in [*groups[-1], name]) > WIDTH and groups[-1]:
            groups.append([])
        groups[-1].append(name)
    return "\n\n".join(_screen(cases, group, widths, first, table) for group in groups)


def _screen(
    cases: Sequence[Case],
    solvers: Sequence[str],
    widths: dict[str, int],
    first: int,
    table: dict[tuple[str, str], Outcome],
) -> str:
    words = [name.split("_") for name in solvers]
    height = max(map(len, words))
    lines = []
    for row in range(height):
        parts = [w[row - height + len(w)] if row >= height - len(w) else "" for w in words]
        lines.append(" ".join([" " * first, *(p.rjust(widths[n]) for p, n in zip(parts, solvers, strict=True))]))
    for case in cases:
        cells = [_cell(table[case.name, name]).rjust(widths[name]) for name in solvers]
        lines.append(" ".join([case.name.ljust(first), *cells]))
    return "\n".join(line.rstrip() for line in lines)


def _cell(outcome: Outcome) -> str:
    if outcome.verdict == "passed" and outcome.found:
        return short(outcome.found.error)
    return {"failed": "FAILED", "slip": "slip"}.get(outcome.verdict, "-")


def short(error: float) -> str:
    """An error in as few characters as say its size."""
    if not math.isfinite(error):
        return str(error)
    return "0" if error == 0.0 else f"{error:.0e}".replace("e-0", "e-").replace("e+0", "e+")


def details(outcomes: Sequence[Outcome]) -> list[str]:
    """A line on each failure, and one on all slips of a solver."""
    lines = [f"failed: {o.case}, {o.solver}: {_figures(o)}{o.reason}" for o in outcomes if o.verdict == "failed"]
    return lines + [f"slip: {solver}, {reason}: {'; '.join(names)}" for solver, reason, names in _slips(outcomes)]


def _slips(outcomes: Sequence[Outcome]) -> list[tuple[str, str, list[str]]]:
    """Solver, what it announces, and the cases that it fails for it."""
    found: dict[tuple[str, str], list[str]] = {}
    for outcome in outcomes:
        if outcome.verdict == "slip":
            found.setdefault((outcome.solver, outcome.reason), []).append(outcome.case)
    return [(solver, reason, names) for (solver, reason), names in found.items()]


def _figures(outcome: Outcome) -> str:
    found = outcome.found
    return f"measured {number(found.measured)}, expected {number(found.expected)}; " if found else ""


def reasons(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """Rows of solver, reason and cases, for what is unsupported; numbers in a reason may differ by case."""
    found: dict[tuple[str, str], list[str]] = {}
    for outcome in outcomes:
        if outcome.verdict == "unsupported":
            reason = "it would take too many steps" if outcome.reason.startswith("it would take") else outcome.reason
            found.setdefault((outcome.solver, reason), []).append(outcome.case)
    return [[solver, reason, ", ".join(cases)] for (solver, reason), cases in found.items()]


def matrix(part: Part, outcomes: Sequence[Outcome]) -> list[list[str]]:
    """Rows of the page's table: case, allowed, a cell a solver."""
    table = {(o.case, o.solver): o for o in outcomes}
    rows = []
    for case in part.cases:
        found = [table[case.name, name] for name in part.solvers]
        allowed = [o.found.allowed for o in found if o.found]
        low, high = (short(min(allowed)), short(max(allowed))) if allowed else ("", "")
        cells = [_cell(o).replace("FAILED", "failed") for o in found]
        rows.append([case.name, low if low == high else f"{low} to {high}", *cells])
    return rows


def render(parts: Sequence[Part], outcomes: Sequence[Outcome], said: str, about: dict[str, str]) -> str:
    """The page: counts, the table, what failed or was not posed, the laws, every figure."""
    tables = [
        page.Table(
            ["case", "allowed", *(name.replace("_", " ") for name in part.solvers)],
            matrix(part, outcomes),
            f"Errors of solvers of {part.of}; a dash is unsupported.",
        )
        for part in parts
    ]
    bad = [[o.case, o.solver, "failed", _figures(o) + o.reason] for o in outcomes if o.verdict == "failed"]
    bad += [["; ".join(names), solver, "slip", reason] for solver, reason, names in _slips(outcomes)]
    sections: list[tuple[str, list[page.Part]]] = [("What came out", [f"{said[0].upper()}{said[1:]}.", *tables])]
    if bad:
        table = page.Table(("case", "solver", "", "why"), bad, "A slip is announced by the solver itself.", prose=True)
        sections.append(("What failed", [table]))
    rows = reasons(outcomes)
    if rows:
        table = page.Table(("solver", "reason", "cases"), rows, "Cases that a solver cannot pose.", prose=True)
        sections.append(("Unsupported", [table]))
    cases = [case for part in parts for case in part.cases]
    text = "Error over step, with the fitted order of each solver."
    sections += [
        (case.name.capitalize(), [page.Figure(plots.draw([panel]), text)])
        for case in cases
        if (panel := convergence(case.name, outcomes))
    ]
    sources = [[case.name, case.law, case.source] for case in cases]
    sections.append(("Laws", [page.Table(("case", "law", "from"), sources, "What is measured.", prose=True)]))
    figures = [
        [o.case, o.solver, number(o.found.measured), number(o.found.expected), short(o.found.error),
         short(o.found.allowed), f"{o.seconds:.2f}"]
        for o in outcomes if o.found
    ]  # fmt: skip
    heads = ("case", "solver", "measured", "expected", "error", "allowed", "time [s]")
    sections.append(("Figures", [page.Table(heads, figures, "Every case that was posed.")]))
    return page.render("Laws", LEAD, [*sections, ("Made by", [page.Facts(about)])])


def fitted(case: str, outcomes: Sequence[Outcome]) -> list[tuple[str, Found]]:
    """Solvers and the errors that an order was fitted to, of a case that does so; none of any other."""
    own = [o for o in outcomes if o.case == case and case.startswith("order")]
    return [(o.solver, o.found) for o in own if o.found and o.found.series]


def convergence(case: str, outcomes: Sequence[Outcome]) -> plots.Panel | None:
    """Error over step of every solver, for a case that fits an order to them; None for any other."""
    lines = [
        Curve(f"{solver}: {f.measured:.2f}", np.array(f.series["dt"]), np.array(f.series["error"]), i, i % 2 == 1)
        for i, (solver, f) in enumerate(fitted(case, outcomes))
    ]
    return plots.Panel("error [m, m/s]", lines, "step [s]", log="xy") if lines else None


def laws(part: Part, outcomes: Sequence[Outcome]) -> plots.Panel:
    """A row a law, a dot a solver at its error as a share of what is allowed: right of 1 a law is broken."""
    rows = [case.name for case in reversed(part.cases)]
    curves = [Curve("allowed", np.ones(2), np.array([-0.5, len(rows) - 0.5]), plots.INK)]
    for i, solver in enumerate(part.solvers):
        own = [o for o in outcomes if o.solver == solver and o.verdict != "unsupported"]
        shares = [o.found.error / o.found.allowed if o.found else math.inf for o in own]
        x = np.clip(np.nan_to_num(shares, nan=MOST), LEAST, MOST)
        # Solvers stand a little apart in a law's row, so that equal errors do not hide each other.
        y = np.array([rows.index(o.case) for o in own]) + 0.25 - 0.5 * (i + 0.5) / len(part.solvers)
        said = [f"{o.case}: {o.verdict}, {short(o.found.error) if o.found else o.reason}" for o in own]
        curves.append(Curve(solver, x, y, i, marker="o", loose=True, labels=said))
    return plots.Panel("laws", curves, "error over what is allowed", log="x", rows=rows)


def tabs(parts: Sequence[Part], outcomes: Sequence[Outcome]) -> dict[str, list[plots.Panel]]:
    """The laws of each part, and each case that fits an order."""
    made = {f"laws of {part.of}": [laws(part, part.own(outcomes))] for part in parts}
    names = [case.name for part in parts for case in part.cases]
    return made | {name: [panel] for name in names if (panel := convergence(name, outcomes))}


def document(parts: Sequence[Part], outcomes: Sequence[Outcome], said: str, about: dict[str, str]) -> list[str]:
    """Parts of the documentation's section."""
    return [
        f"{said[0].upper()}{said[1:]}.",
        *(markdown.table(["case", "allowed", *part.solvers], matrix(part, outcomes)) for part in parts),
        markdown.table(("solver", "unsupported because", "cases"), reasons(outcomes)),
        markdown.facts(about),
    ]
