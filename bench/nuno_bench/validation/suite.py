"""`nuno validate`: every law of `nuno_bench.validation.laws` against every installed solver, and what came out."""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from nuno import registry
from nuno.formatting import roughly
from nuno_bench.options import require_known
from nuno_bench.sweep.executor import Executor, Lost
from nuno_bench.validation.laws import contacts, dye, dye_spread, nets, oscillator, statics
from nuno_bench.validation.laws.base import Broken, Case, Outcome, Unsupported
from nuno_schemas.errors import BadInput, nearest

CASES: tuple[Case, ...] = tuple(
    case for module in (oscillator, nets, statics, contacts, dye_spread, dye) for case in module.laws
)
GROUPS = {"nuno.integrators": "cloth", "nuno.dye_solvers": "dye"}
"""What the solvers of each group solve."""
SLIPS = {"rk4_printed": "kept with the paper's slips: gravity counted twice, damping frozen at the step's start"}
"""Solvers that are there to show what a mistake does: what they fail is reported, but is no failure of the suite."""
SAY_EVERY = 5.0
"""How often it is said how much is left [s]."""


@dataclass(frozen=True)
class Part:
    """Cases, and the solvers that they are held against, by name; `of` says what those solve."""

    of: str
    cases: tuple[Case, ...]
    solvers: tuple[str, ...]


def choose_parts(cases: Sequence[str], solvers: Sequence[str]) -> list[Part]:
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
            parts.append(Part(of, own, names))
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
    """What a case says of a solver. A plugin that raises has failed, whatever it raises."""
    begin, name = time.perf_counter(), str(plugin.name)
    outcome = Outcome(case.name, name, "passed")
    try:
        found = case.measure(plugin)
        outcome = replace(outcome, found=found)
        # NaN compares false with everything: an error that is none has failed.
        if not found.error <= found.allowed:
            raise Broken(f"error {found.error:.2g}, at most {found.allowed:.2g} is allowed")
    except Unsupported as reason:
        outcome = replace(outcome, verdict="unsupported", reason=str(reason))
    except Exception as error:
        why = str(error) if isinstance(error, Broken) else f"{type(error).__name__}: {error}"
        outcome = replace(outcome, verdict="failed", reason=why)
    if outcome.verdict == "failed" and name in SLIPS:
        outcome = replace(outcome, verdict="slip", reason=SLIPS[name])
    return replace(outcome, seconds=time.perf_counter() - begin)


def check_named(task: tuple[str, str]) -> Outcome:
    """What the case of a name says of the solver of a name."""
    case, solver = task
    found = next(one for one in CASES if one.name == case)
    return check(found, registry.load(found.group, solver))


def check_all(parts: Sequence[Part], executor: Executor, say: Callable[[str], None]) -> list[Outcome]:
    """Every case with every solver of its part, in this order.

    They are taken in an order drawn at random: the mean of those that are done is then that of those that are left,
    whatever each takes, which is how long they will take on this machine.
    """
    every = [(case.name, name) for part in parts for case in part.cases for name in part.solvers]
    drawn, found = random.Random(len(every)).sample(every, len(every)), dict[tuple[str, str], Outcome]()
    say(f"{len(every)} checks; the first of them tell how long all take")
    begin, said = time.monotonic(), 0.0
    for key, outcome in executor.run(check_named, drawn):
        if isinstance(outcome, BadInput | Lost):
            outcome = Outcome(*key, "failed", str(outcome))
        found[key] = outcome
        spent, done, left = time.monotonic() - begin, len(found), len(every) - len(found)
        if spent >= said + SAY_EVERY and done >= 2 * executor.width and left:
            said = spent
            say(f"{done} of {len(every)}, {roughly(spent / done * left)} left")
    return [found[key] for key in every]


def count(outcomes: Sequence[Outcome]) -> dict[str, int]:
    """How many outcomes of each verdict."""
    verdicts = ("passed", "failed", "slip", "unsupported")
    return {verdict: sum(outcome.verdict == verdict for outcome in outcomes) for verdict in verdicts}


def summary(parts: Sequence[Part], outcomes: Sequence[Outcome]) -> str:
    """The counts in a sentence, and how many solvers can pose each case."""
    found = count(outcomes)
    text = f"{found['passed']} passed, {found['failed']} failed, {found['unsupported']} unsupported"
    if found["slip"]:
        text += f", {found['slip']} slips of {', '.join(sorted({o.solver for o in outcomes if o.verdict == 'slip'}))}"
    for part in parts:
        least, most = min(posed := count_posed(part, outcomes).values()), max(posed)
        text += f"; each case of {part.of} posed by {least if least == most else f'{least} to {most}'} solvers"
    return text


def count_posed(part: Part, outcomes: Sequence[Outcome]) -> dict[str, int]:
    """How many solvers support each case."""
    posed = Counter(outcome.case for outcome in outcomes if outcome.verdict != "unsupported")
    return {case.name: posed[case.name] for case in part.cases}
