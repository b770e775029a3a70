"""`nuno validate`: every law of `nuno_bench.laws` against every installed solver, and what came out."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from nuno import registry
from nuno_bench.executor import Executor, Lost
from nuno_bench.kept import Kept
from nuno_bench.laws import contacts, nets, oscillator, statics
from nuno_bench.laws.base import Broken, Case, Outcome, Unsupported
from nuno_schemas.errors import BadInput, nearest

CASES: tuple[Case, ...] = (*oscillator.CASES, *nets.CASES, *statics.CASES, *contacts.CASES)
GROUP = "nuno.integrators"
SLIPS = {"rk4_printed": "kept with the paper's slips: gravity counted twice, damping frozen at the step's start"}
"""Solvers that are there to show what a mistake does: what they fail is told, but is no failure of the suite."""
FEWEST = 3
"""Each case is supported by at least so many solvers, or the suite says that it is not."""


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


def choose_solvers(names: Sequence[str]) -> list[Any]:
    """Solver plugins by name, or all that are installed. Raises BadInput for an unknown one."""
    known = sorted(registry.installed(GROUP))
    for name in names:
        if name not in known:
            raise BadInput("no such solver", field="--solvers", value=name, remedy=nearest(name, known))
    return [registry.load(GROUP, name) for name in (dict.fromkeys(names) or known)]


def check(case: Case, plugin: Any) -> Outcome:
    """What a case says of a solver. A plugin that raises has failed, whatever it raises."""
    begin, name = time.perf_counter(), str(plugin.name)
    try:
        found = case.measure(plugin)
    except Unsupported as reason:
        outcome = Outcome(case.name, name, "unsupported", str(reason))
    except Broken as reason:
        outcome = Outcome(case.name, name, "failed", str(reason))
    except Exception as error:
        outcome = Outcome(case.name, name, "failed", f"{type(error).__name__}: {error}")
    else:
        # NaN compares false with everything: an error that is none has failed.
        passed = found.error <= found.allowed
        why = "" if passed else f"error {found.error:.2g}, at most {found.allowed:.2g} is allowed"
        outcome = Outcome(case.name, name, "passed" if passed else "failed", why, found)
    if outcome.verdict == "failed" and name in SLIPS:
        outcome = replace(outcome, verdict="slip", reason=SLIPS[name])
    return replace(outcome, seconds=time.perf_counter() - begin)


def check_named(task: tuple[str, str]) -> Outcome:
    """What the case of a name says of the solver of a name."""
    case, solver = task
    (plugin,) = choose_solvers([solver])
    return check(next(one for one in CASES if one.name == case), plugin)


def check_all(
    cases: Sequence[Case], solvers: Sequence[str], executor: Executor, kept: Kept, told: Callable[[str], None]
) -> list[Outcome]:
    """Every case with every solver, in this order; what comes is kept."""
    found = {(outcome.case, outcome.solver): outcome for outcome in map(Outcome.from_json, kept.lines)}
    every = [(case.name, name) for case in cases for name in solvers]
    wanted = [key for key in every if key not in found]
    left = Counter(case for case, _ in wanted)
    for key, outcome in executor.run(check_named, wanted):
        if isinstance(outcome, BadInput | Lost):
            why = str(outcome) if isinstance(outcome, BadInput) else outcome.reason
            outcome = Outcome(*key, "failed", why)
        found[key] = outcome
        kept.add(outcome.json())
        left[key[0]] -= 1
        if not left[key[0]]:
            told(f"{sum(not left[case.name] for case in cases)} of {len(cases)}: {key[0]}")
    return [found[key] for key in every]


def count(outcomes: Sequence[Outcome]) -> dict[str, int]:
    """How many outcomes of each verdict."""
    verdicts = ("passed", "failed", "slip", "unsupported")
    return {verdict: sum(outcome.verdict == verdict for outcome in outcomes) for verdict in verdicts}


def summary(outcomes: Sequence[Outcome], solvers: int) -> str:
    """The counts in a sentence, and the cases that too few solvers can pose."""
    found = count(outcomes)
    text = f"{found['passed']} passed, {found['failed']} failed, {found['unsupported']} unsupported"
    if found["slip"]:
        text += f", {found['slip']} slips of {', '.join(sorted({o.solver for o in outcomes if o.verdict == 'slip'}))}"
    if solvers >= FEWEST and (rare := rarely_posed(outcomes)):
        text += f"; posed by fewer than {FEWEST} solvers: {', '.join(rare)}"
    return text


def rarely_posed(outcomes: Sequence[Outcome]) -> list[str]:
    """Cases that fewer than FEWEST solvers support."""
    names = dict.fromkeys(outcome.case for outcome in outcomes)
    posed = {name: sum(o.case == name and o.verdict != "unsupported" for o in outcomes) for name in names}
    return [name for name, number in posed.items() if number < FEWEST]
