"""Steps, tolerances and residuals that each installed solver is tried with on a scene, from coarse to fine."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pydantic import BaseModel, ValidationError

from nuno.plugin_contract import registry
from nuno_bench.options import require_known
from nuno_bench.problem import AnyProblem
from nuno_bench.report.page import number, reason_of
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.system import StepLimit

SHARES = (0.9, 0.5, 0.25, 0.1, 0.05, 0.025)
"""Steps, as shares of the stability limit."""
BEYOND = 1.5
"""Multiple of the limit at which failure is shown: the limit may be up to 1.2 times below the true one."""
ROUNDING = 1e-12
"""Relative: a step that is the limit itself may come out longer by this."""
FEW = (1, 2, 4, 8, 16, 32)
"""Steps a frame where nothing limits them, and of implicit methods."""
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
TIGHTEST_RESIDUAL = 1e-11
RESIDUAL = ", residual "
"""Begins the part of a label that gives the residual."""
LEFT_OUT = {"rk4_printed": "repeats the slips of the skirt paper, which change the motion it converges to"}
"""Solvers that are tried only where they are named."""
LOOSER = 10.0
"""Times an adaptive solver's own tolerance: it chooses its steps, so that twice its step cannot be asked for."""


@dataclass(frozen=True)
class Setting:
    """One point of a solver's sweep.

    label   what is set, in words; it names the point
    steps   a frame; for an adaptive solver 1
    fields  of the solver's configuration
    finer   what an error's order is fitted over: the step [s] or the tolerance
    share   of the stability limit that the step is, None where there is no step or nothing limits it
    work    estimated, as a multiple of the solver's first point that is not beyond the limit
    beyond  above the stability limit, to show the failure
    first   run before all others: what the scene itself says
    """

    label: str
    steps: int
    fields: Mapping[str, float] = field(default_factory=dict)
    finer: float = math.nan
    work: float = 1.0
    beyond: bool = False
    first: bool = False
    share: float | None = None


@dataclass(frozen=True)
class Solver:
    """An installed solver, its limit on the scene and its settings."""

    name: str
    plugin: Any
    limit: StepLimit
    settings: tuple[Setting, ...]
    base: Mapping[str, Any]

    @property
    def kind(self) -> str:
        if getattr(self.plugin, "adaptive", False):
            return "adaptive"
        if not hasattr(self.plugin, "explicit"):
            return "fixed steps" if math.isfinite(self.limit.dt) else "any step"
        return "fixed steps" if self.plugin.explicit else "implicit"

    @property
    def order(self) -> int:
        """Nominal order; 0 where it states none."""
        return int(getattr(self.plugin, "order", 0))

    def config(self, setting: Setting) -> BaseModel:
        chosen: BaseModel = self.plugin.Config.model_validate({**self.base, **setting.fields})
        return chosen


@dataclass(frozen=True)
class Omission:
    """A setting that was not run, with the reason; `setting` is empty for a whole solver."""

    solver: str
    setting: str
    reason: str


def choose_solvers(problem: AnyProblem, wanted: Sequence[str]) -> tuple[list[Solver], list[Omission]]:
    """The solvers named, or all that are installed, each with its sweep; and those left out.

    Raises BadInput for an unknown name, and where nothing is left to run.
    """
    known = registry.installed(problem.group)
    require_known(wanted, known, "solver", "--solvers")
    solvers, omitted = [], []
    for name in dict.fromkeys(wanted or known):
        if not wanted and name in LEFT_OUT:
            omitted.append(Omission(name, "", LEFT_OUT[name]))
            continue
        try:
            solvers.append(_choose(problem, name))
        except (BadInput, RunFailed) as error:
            omitted.append(Omission(name, "", reason_of(error)))
    if not solvers:
        reasons = "; ".join(f"{one.solver}: {one.reason}" for one in omitted)
        raise BadInput("no solver is left to run", field="--solvers", value=reasons or "none named")
    return solvers, omitted


def _choose(problem: AnyProblem, name: str) -> Solver:
    """A solver and its settings. Raises BadInput where it cannot be configured or run on this scene."""
    plugin, (preset, given) = registry.load(problem.group, name), problem.preset
    base = dict(given) if preset == name else {}
    try:
        config = plugin.Config.model_validate(base)
    except ValidationError as error:
        missing = ", ".join(str(one["loc"][0]) for one in error.errors() if one["loc"])
        raise BadInput(f"its configuration has no defaults ({missing}): name it in the scene") from None
    found = Solver(name, plugin, problem.limit(plugin, config), (), base)
    return replace(found, settings=tuple(_settings(problem.frame, found)))


def at_tolerance(plugin: Any, tolerance: float, steps: int = 1) -> Setting:
    """An adaptive solver's setting, with `steps` a frame at least.

    Work grows as tolerance^(-1 / (order + 1)): the estimate is of that order in the step.
    """
    text = f"{tolerance:.0e}"
    label = f"tolerance {text if math.isclose(float(text), tolerance) else number(tolerance)}"
    label += f", at least {steps} steps a frame" if steps > 1 else ""
    work = (TOLERANCES[0] / tolerance) ** (1.0 / (plugin.order + 1))
    return Setting(label, steps, {"tolerance": tolerance}, tolerance, work)


def at_steps(frame: float, solver: Solver, steps: int, residual: float | None = None) -> Setting:
    """A setting of so many steps a frame [s], and of an implicit solver's residual."""
    dt, limit = frame / steps, solver.limit.dt if solver.kind == "fixed steps" else math.inf
    label = f"dt {dt * 1e3:.4g} ms" if dt < 1.0 else f"dt {dt:.4g} s"
    share = dt / limit if 0.0 < limit < math.inf else None
    label += "" if share is None else f", {number(share)} of limit"
    label += "" if residual is None else f"{RESIDUAL}{residual:.1e}"
    fields = {} if residual is None else {"residual": residual}
    return Setting(label, steps, fields, dt, float(steps), dt > limit * (1.0 + ROUNDING), share=share)


def has_residual(solver: Solver) -> bool:
    """Whether it has a residual to choose: where the step alone decides what a method resolves, there is none."""
    return "residual" in solver.plugin.Config.model_fields and math.isinf(solver.limit.resolved)


def _settings(frame: float, solver: Solver) -> list[Setting]:
    """From coarse to fine: tolerances, steps within and beyond the limit, or steps with a residual."""
    plugin, limit = solver.plugin, solver.limit
    if solver.kind == "adaptive":
        if "tolerance" not in plugin.Config.model_fields:
            raise BadInput("it chooses its own steps, and has no `tolerance` to sweep")
        return [at_tolerance(plugin, value) for value in TOLERANCES]
    if solver.kind != "fixed steps":
        if not has_residual(solver):
            return [at_steps(frame, solver, steps) for steps in FEW]
        # A force that is missing by a share r moves the solution by a share of order r however small the step, while
        # the step's error falls as its power `order`: so r falls by that power too, or it would end the convergence.
        start, power = float(plugin.Config.model_fields["residual"].default), max(1, solver.order)
        return [at_steps(frame, solver, steps, max(TIGHTEST_RESIDUAL, start / steps**power)) for steps in FEW]
    shares = [math.ceil(frame / (share * limit.dt) * (1.0 - ROUNDING)) for share in SHARES if limit.dt > 0.0]
    counts = {max(1, count) for count in shares}
    if len(counts) < 3:
        counts |= set(FEW)
    # Where no step at all is stable, all of them are beyond the limit already.
    # The fastest oscillation bears about this step in most methods: where the limit is far below it, as that of
    # explicit Euler, failure is cheaper to show there.
    oscillation = 1.8 / limit.omega if limit.omega > 0.0 and limit.dt * limit.omega < 0.2 else 0.0
    beyond = max(BEYOND * limit.dt, oscillation)
    if limit.dt > 0.0 and math.isfinite(beyond) and frame >= beyond:
        counts.add(math.floor(frame / beyond))
    return [at_steps(frame, solver, count) for count in sorted(counts)]


@dataclass(frozen=True)
class OwnSettings:
    """The points of a sweep that are the scene as it is, and the scene with a step twice as large.

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


def add_own(problem: AnyProblem, solvers: Sequence[Solver]) -> tuple[list[Solver], OwnSettings]:
    """The solvers, the scene's own with its two settings among the others; they are run before all others."""
    name = problem.preset[0]
    found = next((solver for solver in solvers if solver.name == name), None)
    if found is None:
        return list(solvers), OwnSettings(name, why="it is not among the solvers that are swept")
    try:
        steps = problem.own_steps(found.limit)
    except BadInput as error:
        return list(solvers), OwnSettings(name, why=error.problem)
    own, coarser, larger = _tolerances(found, steps) if found.kind == "adaptive" else _steps(problem, found, steps)
    chosen = [replace(one, first=True) for one in (own, coarser) if one is not None]
    labels = {one.label for one in chosen}
    others = [one for one in found.settings if one.label not in labels]
    settings = tuple(sorted([*chosen, *others], key=lambda one: -one.finer))
    swept = [replace(one, settings=settings) if one is found else one for one in solvers]
    return swept, OwnSettings(name, own.label, "", larger, coarser.label if coarser else "")


def _tolerances(solver: Solver, steps: int) -> tuple[Setting, Setting | None, str]:
    """Return settings with a solver's tolerance and a looser one, and the longest step that the scene allows."""
    tolerance = float(solver.config(Setting("", 1)).model_dump()["tolerance"])
    own, said = at_tolerance(solver.plugin, tolerance, steps), f"{LOOSER:g} times the tolerance"
    if LOOSER * tolerance > 1.0:
        return own, None, f"{said} is above 1, which no tolerance may be"
    return own, at_tolerance(solver.plugin, LOOSER * tolerance, steps), said


def _steps(problem: AnyProblem, solver: Solver, steps: int) -> tuple[Setting, Setting | None, str]:
    """Return settings with a solver's steps a frame and half as many, rounded up, and the scene's own residual."""
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
