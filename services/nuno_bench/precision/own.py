"""The scene as it is: its own solver with its own step or tolerance, and what a step twice as large would cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from nuno_bench.precision.point import ABOVE, Point
from nuno_bench.precision.settings import RESIDUAL, Setting, Solver, at_steps, at_tolerance, has_residual
from nuno_bench.precision.sweep import Sweep
from nuno_bench.problem.dye import AnyProblem
from nuno_bench.report.result import number
from nuno_schemas.errors import BadInput

LOOSER = 10.0
"""Times an adaptive solver's own tolerance: it chooses its steps, so that twice its step cannot be asked for."""


@dataclass(frozen=True)
class Own:
    """Which points of a sweep are the scene as it is, and the same with a step twice as large.

    setting  label of the scene's own point; empty where `why` says that there is none
    larger   how the other differs, in words: "a step twice as large"
    coarser  label of that point; empty where `larger` says why it is not run
    """

    solver: str
    setting: str = ""
    why: str = ""
    larger: str = ""
    coarser: str = ""

    @property
    def loose(self) -> frozenset[tuple[str, str]]:
        """Keys of points whose error is not that of their step alone: the scene's residual stays as it is."""
        return frozenset((self.solver, label) for label in (self.setting, self.coarser) if RESIDUAL in label)


def add_own(problem: AnyProblem, solvers: Sequence[Solver]) -> tuple[list[Solver], Own]:
    """The solvers, the scene's own with its two settings among the others; they are run before all others."""
    name = problem.preset[0]
    found = next((solver for solver in solvers if solver.name == name), None)
    if found is None:
        return list(solvers), Own(name, why="it is not among the solvers that are swept")
    try:
        steps = problem.own_steps(found.limit)
    except BadInput as error:
        return list(solvers), Own(name, why=error.problem)
    own, coarser, larger = _tolerances(found, steps) if found.kind == "adaptive" else _steps(problem, found, steps)
    chosen = [replace(one, first=True) for one in (own, coarser) if one is not None]
    labels = {one.label for one in chosen}
    others = [one for one in found.settings if one.label not in labels]
    settings = tuple(sorted([*chosen, *others], key=lambda one: -one.finer))
    swept = [replace(one, settings=settings) if one is found else one for one in solvers]
    return swept, Own(name, own.label, "", larger, coarser.label if coarser else "")


def _tolerances(solver: Solver, steps: int) -> tuple[Setting, Setting | None, str]:
    """Its tolerance and a looser one, with the longest step that the scene allows."""
    tolerance = float(solver.config(Setting("", 1)).model_dump()["tolerance"])
    own, said = at_tolerance(solver.plugin, tolerance, steps), f"{LOOSER:g} times the tolerance"
    if LOOSER * tolerance > 1.0:
        return own, None, f"{said} is above 1, which no tolerance may be"
    return own, at_tolerance(solver.plugin, LOOSER * tolerance, steps), said


def _steps(problem: AnyProblem, solver: Solver, steps: int) -> tuple[Setting, Setting | None, str]:
    """Its steps a frame and half as many, rounded up, with the scene's own residual."""
    residual = float(solver.config(Setting("", steps)).model_dump()["residual"]) if has_residual(solver) else None
    own, said = at_steps(problem.frame, solver, steps, residual), "a step twice as large"
    if steps == 1:
        return own, None, f"{said} is longer than a frame, which it must divide"
    fewer = math.ceil(steps / 2)
    if steps % 2:
        said = f"a step {number(steps / fewer)} times as large (whole steps make a frame)"
    coarser = at_steps(problem.frame, solver, fewer, residual)
    if coarser.beyond:
        limits = f"{1e3 * coarser.finer:.4g} ms; at most {1e3 * solver.limit.dt:.4g} ms are stable"
        return own, None, f"{said} is above the stability limit ({limits})"
    return own, coarser, said


def describe(own: Own, sweep: Sweep, quantity: str, floor: float) -> str:
    """What the scene's own step costs and delivers in a quantity, and one twice as large, in one sentence."""
    if not own.setting:
        return f"This scene as it is ({own.solver}) has no point: {own.why}."
    found = {point.key: point for point in sweep.points}
    first, second = (found.get((own.solver, label)) for label in (own.setting, own.coarser))
    said = f"This scene as it is ({own.solver}, {own.setting}): {_result(first, own.setting, own, sweep, quantity)}"
    if not own.coarser:
        return f"{said}; {own.larger}."
    said += f"; with {own.larger} ({own.coarser}): {_result(second, own.coarser, own, sweep, quantity, first)}."
    errors = [error for point in (first, second) if point and (error := point.error(quantity)) is not None]
    if any(error <= ABOVE * floor for error in errors):
        said += f" Errors below {ABOVE * floor:.1e} are not known: the references themselves are {floor:.1e} apart."
    return said


def _result(point: Point | None, setting: str, own: Own, sweep: Sweep, quantity: str, base: Point | None = None) -> str:
    """Error and run time of a point, with what multiples of the base point's they are; or why it has none."""
    if point is None:
        reasons = (one.reason for one in sweep.omitted if one.solver == own.solver and one.setting in ("", setting))
        return f"not run, {next(reasons, 'no reason is known')}"
    if not point.done:
        return f"{point.outcome} ({point.message})" if point.message else point.outcome
    error, before = point.error(quantity), base.error(quantity) if base else None
    parts = [f"error in {quantity} {error:.2e}{_times(error, before)}"] if error is not None else []
    if point.seconds:
        parts.append(f"run time {number(point.median)} s{_times(point.median, base.median if base else None)}")
    return ", ".join(parts)


def _times(value: float, base: float | None) -> str:
    return f" ({number(value / base)} times)" if base and math.isfinite(base) else ""
