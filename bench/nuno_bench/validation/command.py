"""`nuno validate`: the laws of physics, held against every installed solver."""

from __future__ import annotations

import argparse
import math
import random
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from nuno.formatting import roughly
from nuno.plugin_contract import registry
from nuno_bench import machine, options
from nuno_bench.options import require_known
from nuno_bench.report import page, plots
from nuno_bench.report.page import Figure, Part, Report, Sections, Table, number
from nuno_bench.report.plots import Curve, Panel, draw
from nuno_bench.sweep.executor import Executor, add_executor_arguments, open_executor
from nuno_bench.validation import contacts, dye, oscillator, statics
from nuno_bench.validation.law import BrokenRun, Case, Outcome, Unsupported
from nuno_schemas.errors import BadInput, RunFailed, nearest

# Every law against every installed solver, and what came out.

CASES: tuple[Case, ...] = tuple(
    case for laws in (oscillator.laws, statics.net_laws, statics.laws, contacts.laws, dye.laws) for case in laws
)
GROUPS = {"nuno.integrators": "cloth", "nuno.dye_solvers": "dye"}
"""Subject of the solvers of each group."""
SLIPS = {"rk4_printed": "kept with the paper's slips: gravity counted twice, damping frozen at the step's start"}
"""Solvers that are there to show what a mistake does: what they fail is reported, but is no failure of the suite."""
SAY_EVERY = 5.0
"""Time between two messages on the time that is left [s]."""


@dataclass(frozen=True)
class Suite:
    """Cases, and the solvers that they are held against, by name; `of` says what those solve."""

    of: str
    cases: tuple[Case, ...]
    solvers: tuple[str, ...]


def choose_parts(cases: Sequence[str], solvers: Sequence[str]) -> list[Suite]:
    """Cases and solvers by name, or all, in a part for each kind of solver.

    Raises BadInput for a name that is unknown, and where no solver that is named can be held to a case that is.
    """
    known = {group: sorted(registry.installed(group)) for group in GROUPS}
    every = [name for names in known.values() for name in names]
    require_known(solvers, every, "solver", "--solvers")
    chosen, parts = choose_cases(cases), []
    for group, of in GROUPS.items():
        own = tuple(case for case in chosen if case.group == group)
        names = tuple(name for name in dict.fromkeys(solvers or known[group]) if name in known[group])
        if own and names:
            parts.append(Suite(of, own, names))
    if not parts:
        kinds = " and ".join(sorted({GROUPS[case.group] for case in chosen}))
        raise BadInput(f"the cases are of {kinds}, the solvers are not", field="--solvers", value=", ".join(solvers))
    return parts


def choose_cases(names: Sequence[str]) -> list[Case]:
    """Cases by name, or by the words they begin with; all where none is named. Raises BadInput."""
    chosen: list[Case] = []
    for name in names:
        found = [case for case in CASES if case.name == name] or [c for c in CASES if c.name.startswith(name)]
        if not found:
            known = [case.name for case in CASES]
            raise BadInput("no such case", field="CASE", value=name, remedy=nearest(name, known))
        chosen += [case for case in found if case not in chosen]
    return chosen or list(CASES)


def check(case: Case, plugin: Any) -> Outcome:
    """Hold a solver against a case. A plugin that raises has failed, whatever it raises."""
    begin, name = time.perf_counter(), str(plugin.name)
    outcome = Outcome(case.name, name, "passed")
    try:
        found = case.measure(plugin)
        outcome = replace(outcome, found=found)
        # NaN compares false with everything: an error that is none has failed.
        if not found.error <= found.allowed:
            raise BrokenRun(f"error {found.error:.2g}, at most {found.allowed:.2g} is allowed")
    except Unsupported as reason:
        outcome = replace(outcome, verdict="unsupported", reason=str(reason))
    except Exception as error:
        why = str(error) if isinstance(error, BrokenRun) else f"{type(error).__name__}: {error}"
        outcome = replace(outcome, verdict="failed", reason=why)
    if outcome.verdict == "failed" and name in SLIPS:
        outcome = replace(outcome, verdict="slip", reason=SLIPS[name])
    return replace(outcome, seconds=time.perf_counter() - begin)


def check_named(task: tuple[str, str]) -> Outcome:
    """Hold a solver against a case, both by name."""
    case, solver = task
    found = next(one for one in CASES if one.name == case)
    return check(found, registry.load(found.group, solver))


def check_all(parts: Sequence[Suite], executor: Executor, say: Callable[[str], None]) -> list[Outcome]:
    """Return the outcome of every case with every solver of its suite, in this order.

    They are taken in an order drawn at random: the mean of those that are done is then that of those that are left,
    whatever each takes, which is how long they will take on this machine.
    """
    every = [(case.name, name) for part in parts for case in part.cases for name in part.solvers]
    drawn, found = random.Random(len(every)).sample(every, len(every)), dict[tuple[str, str], Outcome]()
    say(f"{len(every)} checks; the first of them tell how long all take")
    begin, said = time.monotonic(), 0.0
    for key, outcome in executor.run(check_named, drawn):
        if isinstance(outcome, BadInput | RunFailed):
            outcome = Outcome(*key, "failed", str(outcome))
        found[key] = outcome
        spent, done, left = time.monotonic() - begin, len(found), len(every) - len(found)
        if spent >= said + SAY_EVERY and done >= 2 * executor.width and left:
            said = spent
            say(f"{done} of {len(every)}, {roughly(spent / done * left)} left")
    return [found[key] for key in every]


def count(outcomes: Sequence[Outcome]) -> dict[str, int]:
    """Return the number of outcomes of each verdict."""
    verdicts = ("passed", "failed", "slip", "unsupported")
    return {verdict: sum(outcome.verdict == verdict for outcome in outcomes) for verdict in verdicts}


def summary(parts: Sequence[Suite], outcomes: Sequence[Outcome]) -> str:
    """The counts in a sentence, and how many solvers can pose each case."""
    found = count(outcomes)
    text = f"{found['passed']} passed, {found['failed']} failed, {found['unsupported']} unsupported"
    if found["slip"]:
        text += f", {found['slip']} slips of {', '.join(sorted({o.solver for o in outcomes if o.verdict == 'slip'}))}"
    for part in parts:
        least, most = min(posed := count_posed(part, outcomes).values()), max(posed)
        text += f"; each case of {part.of} posed by {least if least == most else f'{least} to {most}'} solvers"
    return text


def count_posed(part: Suite, outcomes: Sequence[Outcome]) -> dict[str, int]:
    """Return the number of solvers that support each case."""
    posed = Counter(outcome.case for outcome in outcomes if outcome.verdict != "unsupported")
    return {case.name: posed[case.name] for case in part.cases}


ABREAST = 5
"""Solvers beside each other on a screen."""
LEAD = (
    "Laws with closed forms, held against every installed solver through the plugin interface alone. A cell gives "
    "the error, in the case's own measure; a case that a solver cannot pose is unsupported, not passed."
)


def validate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cases", nargs="*", metavar="CASE", help="cases by name or its beginning (default: all)")
    options.add_shared(parser, "--solvers", "--json", "--html", "--docs")
    add_executor_arguments(parser)
    parser.add_argument("--list", action="store_true", help="name the cases and their laws, and run nothing")


def validate_command(args: argparse.Namespace) -> int:
    """Run the cases, print the table; the exit code is 1 where a solver failed one."""
    parts = choose_parts(args.cases, options.names_of(args.solvers))
    if args.list:
        cases = [case for part in parts for case in part.cases]
        width = max(len(case.name) for case in cases)
        print("\n".join(f"{case.name:{width}}  {case.law} ({case.source})" for case in cases))
        return 0
    if args.html is not None:
        plots.require_matplotlib()
    for flag in ("json", "html"):
        path: Path | None = getattr(args, flag)
        if path is not None and not path.resolve().parent.is_dir():
            raise BadInput("no such folder", field=f"--{flag}", value=str(path.parent), remedy="make it first")
    page.check_section(args.docs, "validate")
    others = machine.OtherLoad()
    with open_executor(args) as where:
        outcomes = check_all(parts, where, lambda text: print(text, file=sys.stderr))
    print("\n\n".join(case_tables(part, outcomes) for part in parts))
    print("\n".join(["", *map(describe_bad, bad_table(outcomes).rows), summary(parts, outcomes)]))
    report(parts, outcomes, machine.about(others)).write(args.html, args.json, args.docs, "validate")
    return int(any(outcome.verdict == "failed" for outcome in outcomes))


def case_tables(part: Suite, outcomes: Sequence[Outcome]) -> str:
    """Cases as rows, solvers as columns, in as many tables as there are groups of solvers."""
    groups = [part.solvers[i : i + ABREAST] for i in range(0, len(part.solvers), ABREAST)]
    return "\n\n".join(Table(("case", *group), _cells(part, group, outcomes)).text() for group in groups)


def _cells(part: Suite, solvers: Sequence[str], outcomes: Sequence[Outcome]) -> list[list[str]]:
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


def error_table(part: Suite, outcomes: Sequence[Outcome]) -> Table:
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
    """Return a row of `bad_table` as a line for the screen."""
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


def report(parts: Sequence[Suite], outcomes: Sequence[Outcome], about: Mapping[str, str]) -> Report:
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
    said = summary(parts, outcomes)
    brief: list[Part] = [f"{said[0].upper()}{said[1:]}.", *(error_table(part, outcomes) for part in parts)]
    sections: Sections = [
        ("What came out", brief),
        ("What failed", [bad_table(outcomes)]),
        ("Unsupported", [unposed]),
        *((case.name.capitalize(), convergence_figures(case.name, outcomes)) for case in cases),
        ("Laws", [Table(("case", "law", "from"), laws, "What is measured.", prose=True)]),
        ("Figures", [Table(heads, figures, "Every case that was posed.")]),
    ]
    data = {"counts": count(outcomes), "outcomes": outcomes}
    return Report("Laws", LEAD, sections, about, data, [*brief, unposed])
