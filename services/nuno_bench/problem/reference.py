"""What errors are measured against: two independent solvers at tight tolerance, or at small steps.

How far the two are apart is the floor: an error near it says nothing. Two solvers of one family
could share a mistake only in the force, which `nuno validate` checks by closed forms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nuno import registry
from nuno_bench.problem.observe import Problem, Run, simulate
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

PRIMARY, CHECK = "dop853", "dopri5"
TOLERANCES = (1e-11, 1e-10, 1e-9, 1e-8, 1e-7)
"""Of a step, tried in turn: the first that the scene allows (far from the origin positions are rounded
more than that) and that ends within the time allowed."""
STEPPED = ("leapfrog", "symplectic_euler")
"""The reference by fixed steps, and what it is checked by."""
FINER = (64, 32, 16, 8)
"""Steps of theirs for one that is stable, tried in turn: the first that ends within the time allowed."""
TRIED = 20
"""Steps by which the cost of a run is estimated."""


@dataclass(frozen=True)
class Compared:
    """The run that errors are measured against, an independent one, and how both were made."""

    run: Run
    check: Run
    how: str
    seconds: float


@dataclass(frozen=True)
class Reference(Compared):
    """That of a moving cloth: twin(disturbance) runs it again from disturbed positions (n, 3) [m]."""

    twin: Callable[[Float], Run]


def no_reference(problem: Any, value: str, limit: str | None = None) -> BadInput:
    """The refusal of a scene that no reference ends in time for, or ends well for."""
    remedy = "raise --budget, shorten the run with --duration, or soften the scene"
    problem_text = "the scene has no reference to measure errors against"
    return BadInput(problem_text, problem.loaded.file, value=value, limit=limit, remedy=remedy)


def make_reference(problem: Problem, most_seconds: float, told: Callable[[str], None]) -> Reference:
    """The scene's reference; each run of it may take `most_seconds`. Raises BadInput where none ends in that time."""
    found, first = list[tuple[Run, float]](), 0
    for name in (PRIMARY, CHECK):
        told(f"reference: {name}")
        try:
            found.append(_tightest(problem, name, first, most_seconds))
        except BadInput as refused:
            if found:
                raise
            told(f"{name} does not end in time ({refused.value})")
            return stepped_reference(problem, most_seconds, told)
        first = TOLERANCES.index(found[0][1])
    (run, tolerance), (check, checked) = found

    def twin(disturbance: Float) -> Run:
        return tight(problem, PRIMARY, tolerance, math.inf, disturbance)

    how = f"{PRIMARY} at tolerance {tolerance:g}, checked by {CHECK} at {checked:g}"
    return Reference(run, check, how, run.seconds + check.seconds, twin)


def _tightest(problem: Problem, name: str, first: int, most_seconds: float) -> tuple[Run, float]:
    """A run at the tightest tolerance, from the `first` on, that ends in time. Raises BadInput where none does."""
    at, why = first, ""
    while at < len(TOLERANCES):
        try:
            run = tight(problem, name, TOLERANCES[at], most_seconds)
        except BadInput as refused:
            at, why = at + 1, refused.problem
            continue
        if run.status == "ok":
            return run, TOLERANCES[at]
        # From how far it came: the work of a method of order 5 falls by 10^(1/6) with each tolerance.
        reached = max(1, len(run.series.t) - 1)
        at += max(1, math.ceil(6.0 * math.log10(problem.frames / reached)))
        why = f"{run.status}: {run.message}"
    raise no_reference(problem, f"{name}: {why}", f"tolerances from {TOLERANCES[first]:g} to {TOLERANCES[-1]:g}")


def tight(problem: Problem, name: str, tolerance: float, most_seconds: float, disturbance: Float | None = None) -> Run:
    """A run by an adaptive solver, with a frame as its longest step. Raises BadInput where that is refused."""
    plugin = registry.load(problem.group, name)
    return simulate(problem, plugin, plugin.Config(tolerance=tolerance), 1, disturbance, most_seconds)


def stepped_reference(problem: Problem, most_seconds: float, told: Callable[[str], None]) -> Reference:
    """A reference by fixed steps; each run of it is estimated at `most_seconds` at most.

    Where cloth lands and slips, forces jump, and an adaptive method creeps from one jump to the next. Two methods of
    different order, at a small share of their stable step, are then known better in the time there is. Raises BadInput
    where not even the coarsest would end.
    """
    runs, made, finer = list[tuple[Run, int]](), list[str](), FINER[0]

    def run(name: str, steps: int, disturbance: Float | None = None) -> Run:
        plugin = registry.load(problem.group, name)
        found = simulate(problem, plugin, plugin.Config(), steps, disturbance)
        if found.status != "ok":
            raise no_reference(problem, f"{name}: {found.status}: {found.message}")
        return found

    for name in STEPPED:
        plugin = registry.load(problem.group, name)
        limit = problem.limit(plugin, plugin.Config()).dt
        stable = max(1, math.ceil(problem.frame / limit)) if limit > 0.0 else 1
        a_step = problem.first_call(plugin, plugin.Config(), FINER[-1] * stable, TRIED)[1] / TRIED
        finer = next((n for n in FINER if n <= finer and n * stable * problem.frames * a_step <= most_seconds), 0)
        if not finer:
            taken = FINER[-1] * stable * problem.frames * a_step
            why = f"{FINER[-1]} times the steps of {name} take {taken:.3g} s"
            raise no_reference(problem, why, f"{most_seconds:g} s")
        told(f"reference: {name}, {finer} steps for one that is stable")
        runs.append((run(name, finer * stable), finer * stable))
        made.append(f"{name} at 1/{finer} of its stable step")
    (first, steps), (check, _) = runs

    def twin(disturbance: Float) -> Run:
        return run(STEPPED[0], steps, disturbance)

    return Reference(first, check, ", checked by ".join(made), first.seconds + check.seconds, twin)
