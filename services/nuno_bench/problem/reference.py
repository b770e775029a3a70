"""What errors are measured against: the exact motion, or two independent solvers at tight tolerance.

How far the two are apart is the floor: an error near it says nothing. Two solvers of one family
could share a mistake only in the force, which `nuno validate` checks by closed forms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from nuno import registry
from nuno.cloth import build
from nuno_bench.problem.closed_form import closed_form
from nuno_bench.problem.observe import Problem, Run, simulate
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, State
from nuno_schemas.system import StepReport

GROUP = "nuno.integrators"
PRIMARY, CHECK = "dop853", "dopri5"
TOLERANCES = (1e-11, 1e-10, 1e-9, 1e-8, 1e-7)
"""Of a step, tried in turn: the first that the scene allows (far from the origin positions are rounded
more than that) and that ends within the time allowed."""


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


def make_reference(problem: Problem, most_seconds: float, told: Callable[[str], None]) -> Reference:
    """The scene's reference; each run of it may take `most_seconds`. Raises BadInput where none ends in that time."""

    def twin_at(tolerance: float) -> Callable[[Float], Run]:
        return lambda disturbance: _tight(problem, PRIMARY, tolerance, math.inf, disturbance)

    exact = closed_form(problem, _measure(problem))
    if exact is not None:
        told("the scene is linear: its exact motion is the reference")
        how = "the exact motion (matrix exponential of the linear system); its floor is rounding"
        return Reference(*exact, how, 0.0, twin_at(_allowed(problem)))
    told(f"reference: {PRIMARY}")
    try:
        run, tolerance = _tightest(problem, PRIMARY, 0, most_seconds)
    except BadInput as refused:
        from nuno_bench.problem.stepped import stepped_reference

        told(f"{PRIMARY} does not end in time ({refused.value})")
        return stepped_reference(problem, most_seconds, told)
    told(f"reference: {CHECK}")
    check, checked = _tightest(problem, CHECK, TOLERANCES.index(tolerance), most_seconds)
    how = f"{PRIMARY} at tolerance {tolerance:g}, checked by {CHECK} at {checked:g}"
    return Reference(run, check, how, run.seconds + check.seconds, twin_at(tolerance))


def _tightest(problem: Problem, name: str, first: int, most_seconds: float) -> tuple[Run, float]:
    """A run at the tightest tolerance, from the `first` on, that ends in time. Raises BadInput where none does."""
    at, why = first, ""
    while at < len(TOLERANCES):
        try:
            run = _tight(problem, name, TOLERANCES[at], most_seconds)
        except BadInput as refused:
            at, why = at + 1, refused.problem
            continue
        if run.status == "ok":
            return run, TOLERANCES[at]
        at, why = at + _decades(problem, run), f"{run.status}: {run.message}"
    raise BadInput(
        "the scene has no reference to measure errors against",
        problem.loaded.file,
        value=f"{name}: {why}",
        limit=f"tolerances from {TOLERANCES[first]:g} to {TOLERANCES[-1]:g}",
        remedy="raise --budget, shorten the run with --duration, or soften the scene",
    )


def _decades(problem: Problem, run: Run) -> int:
    """By how many tolerances to loosen, from how far a run came: its work falls by 10^(1/6) with each, for order 5."""
    reached = max(1, len(run.series.t) - 1)
    return max(1, math.ceil(6.0 * math.log10(problem.frames / reached)))


def _allowed(problem: Problem) -> float:
    """The tightest tolerance that the scene's place allows."""
    primary = registry.load(GROUP, PRIMARY)
    for tolerance in TOLERANCES:
        try:
            primary.prepare(primary.Config(tolerance=tolerance), problem.system, build.start_state(problem.fabric))
        except BadInput:
            continue
        return tolerance
    return TOLERANCES[-1]


def _tight(problem: Problem, name: str, tolerance: float, most_seconds: float, disturbance: Float | None = None) -> Run:
    plugin = registry.load(GROUP, name)
    return simulate(problem, plugin, plugin.Config(tolerance=tolerance), 1, disturbance, most_seconds)


def _measure(problem: Problem) -> Callable[[State], StepReport]:
    """Energies of any state, by a solver's report of no step."""
    primary = registry.load(GROUP, PRIMARY)
    config = primary.Config()
    memory = primary.prepare(config, problem.system, build.start_state(problem.fabric))

    def measure(state: State) -> StepReport:
        report: StepReport = primary.advance(problem.system, state, memory, None, 0, problem.frame)
        return report

    return measure
