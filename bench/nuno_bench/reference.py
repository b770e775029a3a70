"""The reference that errors are measured against: two independent solvers at tight tolerance, or at small steps.

How far the two are apart is the floor: an error near it says nothing. Two solvers of one family
could share a mistake only in the force, which `nuno validate` checks by closed forms.

Cloth that swings freely is chaotic: whatever disturbs it grows, rounding and a solver's error alike. So positions are
compared only as long as a twin that starts DISTURBANCE away stays within LOST, of the cloth's size. A reference that is
only as good as the disturbance cannot say better than LOST where a vertex is from there on, and LOST is the coarsest
accuracy that a comparison of positions is of use for; what is left to compare beyond are observables.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nuno.plugin_contract import registry
from nuno_bench.problem import SCHEME, AnyProblem, DyeProblem, Problem, Run, Series, simulate
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
DISTURBANCE = 1e-10
"""Root mean square over the free vertices, as a share of the size."""
LOST = 1e-3
SEED = 20
DYE_FINER = (32, 16, 8, 4, 2)
"""Steps for one that is stable, tried in turn: the first that ends within the time allowed, halved steps and all."""
DYE_CHECKED = (64, 32, 16, 8, 4, 2, 1)
"""Steps a frame of a solver that any step is stable for, tried in turn."""


@dataclass(frozen=True)
class ReferenceRuns:
    """The run that errors are measured against, an independent one, and how both were made."""

    run: Run
    check: Run
    how: str
    seconds: float


@dataclass(frozen=True)
class Reference(ReferenceRuns):
    """That of a moving cloth: twin(disturbance) runs it again from disturbed positions (n, 3) [m]."""

    twin: Callable[[Float], Run]


def no_reference(problem: Any, value: str, limit: str | None = None) -> BadInput:
    """The refusal of a scene that no reference ends in time for, or ends well for."""
    remedy = "raise --budget, shorten the run with --duration, or soften the scene"
    problem_text = "the scene has no reference to measure errors against"
    return BadInput(problem_text, problem.loaded.file, value=value, limit=limit, remedy=remedy)


def make_reference(problem: Problem, most_seconds: float, say: Callable[[str], None]) -> Reference:
    """The scene's reference; each run of it may take `most_seconds`. Raises BadInput where none ends in that time."""
    found, first = list[tuple[Run, float]](), 0
    for name in (PRIMARY, CHECK):
        say(f"reference: {name}")
        try:
            found.append(_tightest(problem, name, first, most_seconds))
        except BadInput as refused:
            if found:
                raise
            say(f"{name} does not end in time ({refused.value})")
            return stepped_reference(problem, most_seconds, say)
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


def stepped_reference(problem: Problem, most_seconds: float, say: Callable[[str], None]) -> Reference:
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
        say(f"reference: {name}, {finer} steps for one that is stable")
        runs.append((run(name, finer * stable), finer * stable))
        made.append(f"{name} at 1/{finer} of its stable step")
    (first, steps), (check, _) = runs

    def twin(disturbance: Float) -> Run:
        return run(STEPPED[0], steps, disturbance)

    return Reference(first, check, ", checked by ".join(made), first.seconds + check.seconds, twin)


@dataclass(frozen=True)
class Horizon:
    """Up to when positions are compared.

    frames   frames whose positions are compared, the start among them
    t        the last of them [s]
    whole    whether that is the whole run
    growth   how far the disturbance has grown by then, as a multiple of itself
    distance (f,) of the twin at every frame, as a share of the size
    fades    whether nothing that disturbs the scene can grow
    """

    frames: int
    t: float
    whole: bool
    growth: float
    distance: Float
    fades: bool = False

    def describe(self) -> str:
        if self.fades:
            return "the whole run: what disturbs diffusion fades"
        grown = f"a disturbance of {DISTURBANCE:g} of the cloth's size grows {self.growth:.3g} times"
        if self.whole:
            return f"the whole run: {grown} in {self.t:.3g} s"
        return f"{self.t:.3g} s: {grown} by then, and passes {LOST:g} of the size in the next frame"


def disturb(problem: Problem) -> Float:
    """(n, 3) displacements of the free vertices [m], at random, the same for every run."""
    moved = np.zeros((problem.fabric.number, 3))
    moved[problem.free] = np.random.default_rng(SEED).normal(size=(int(problem.free.sum()), 3))
    spread = np.sqrt((moved[problem.free] ** 2).sum(axis=1).mean())
    return np.asarray(moved * (DISTURBANCE * problem.size / spread))


def refer(problem: AnyProblem, budget: float, say: Callable[[str], None]) -> tuple[ReferenceRuns, Horizon]:
    """Return the reference and its horizon; each run of the reference may take `budget` [s]. Raises BadInput."""
    if isinstance(problem, DyeProblem):
        of_dye = make_dye_reference(problem, budget, say)
        t = of_dye.run.series.t
        return of_dye, Horizon(len(t), float(t[-1]), True, 0.0, np.zeros(len(t)), fades=True)
    reference = make_reference(problem, budget, say)
    say("predictable time: the disturbed twin")
    return reference, find_horizon(problem, reference)


def find_horizon(problem: Problem, reference: Reference) -> Horizon:
    """Run the twin."""
    t, x = reference.run.series.t, reference.run.series.x
    twin: Run = reference.twin(disturb(problem))
    reached = len(twin.series.t)
    apart = np.sqrt(((twin.series.x - x[:reached]) ** 2).sum(axis=2).mean(axis=1)) / problem.size
    lost = np.flatnonzero(~(apart <= LOST))
    frames = int(lost[0]) if lost.size else reached
    return Horizon(frames, float(t[frames - 1]), frames == len(t), float(apart[frames - 1] / DISTURBANCE), apart)


def make_dye_reference(problem: DyeProblem, most_seconds: float, say: Callable[[str], None]) -> ReferenceRuns:
    """The explicit scheme, extrapolated; its runs may take `most_seconds`, and those that check it as long again.

    The scheme's error is of first order in the step, so that 2 u(h / 2) - u(h) takes it away (Richardson 1911); what is
    left is of second order where amounts are smooth in time. It is checked by the closest of the other solvers, or by
    the same at twice the step where none is installed. Raises BadInput where not even the coarsest ends in that time.
    """
    plugin = registry.load(problem.group, SCHEME)
    config = plugin.Config()
    limit = problem.limit(plugin, config).dt
    stable = max(1, math.ceil(problem.frame / limit))
    each = problem.first_call(plugin, config, 2 * stable, TRIED)[1] / TRIED
    fitting = [finer for finer in DYE_FINER if 3 * finer * stable * problem.frames * each <= most_seconds]
    if not fitting:
        taken = 3 * DYE_FINER[-1] * stable * problem.frames * each
        why = f"{3 * DYE_FINER[-1]} times the stable steps take {taken:.3g} s"
        raise no_reference(problem, why, f"{most_seconds:g} s")
    finer = fitting[0]
    say(f"reference: {SCHEME}, {finer} and {2 * finer} steps for one that is stable")
    half, coarse, fine = (_run_dye(problem, plugin, n * stable) for n in (finer // 2, finer, 2 * finer))
    run = extrapolate(coarse, fine)
    how = f"{SCHEME} at 1/{finer} and 1/{2 * finer} of its stable step, extrapolated"
    others = [name for name in sorted(registry.installed(problem.group)) if name != SCHEME]
    found = [_check_dye(problem, name, stable * finer, most_seconds, say) for name in others]
    checks = [one for one in found if one] or [(extrapolate(half, coarse), "the same at twice the step")]
    check, said = min(checks, key=lambda pair: float(np.abs(pair[0].series.x - run.series.x).max()))
    return ReferenceRuns(run, check, f"{how}, checked by {said}", coarse.seconds + fine.seconds + check.seconds)


def _check_dye(
    problem: DyeProblem, name: str, steps: int, most_seconds: float, say: Callable[[str], None]
) -> tuple[Run, str] | None:
    """Another solver's run at as fine a step as time allows, and its words; None where it has none."""
    plugin = registry.load(problem.group, name)
    try:
        config = plugin.Config()
        counts = [steps] if math.isfinite(problem.limit(plugin, config).dt) else DYE_CHECKED
        for count in counts:
            each = problem.first_call(plugin, config, count, 2)[1] / 2
            if count * problem.frames * each <= most_seconds:
                say(f"reference: {name}, {count} steps a frame")
                run = problem.run(plugin, config, count, 2.0 * most_seconds)
                return (run, f"{name} at {count} steps a frame") if run.status == "ok" else None
    except (BadInput, ValueError):
        pass
    return None


def _run_dye(problem: DyeProblem, plugin: Any, steps: int) -> Run:
    run = problem.run(plugin, plugin.Config(), max(1, steps))
    if run.status != "ok":
        raise no_reference(problem, f"{SCHEME}: {run.status}: {run.message}")
    return run


def extrapolate(coarse: Run, fine: Run) -> Run:
    """Without the error of first order; `fine` took twice the steps of `coarse`."""
    a, b = coarse.series, fine.series
    values = {name: 2.0 * b.values[name] - a.values[name] for name in b.values}
    series: Series = replace(b, x=2.0 * b.x - a.x, values=values)
    return replace(fine, series=series, seconds=coarse.seconds + fine.seconds)
