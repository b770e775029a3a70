"""What a case is, what it says of a solver, and how it runs one: through the plugin protocol alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np

from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Bool, Fabric, Float, Hinges, Springs, State
from nuno_schemas.system import StepReport, System

G = 9.81
"""Gravity of all cases [m/s^2]."""
DOWN = np.array([0.0, -G, 0.0])
NONE = np.zeros(3)
MOST_STEPS = 400_000
"""A case that would take a solver more steps than this is not posed to it."""
EXACT: Mapping[str, float] = {"tolerance": 1.0, "residual": 1e-12}
"""Steps of the given length, solved to rounding."""
ACCURATE: Mapping[str, float] = {"tolerance": 1e-8, "residual": 1e-8, "iterations": 100}
"""Steps as a careful user would have them."""


class Unsupported(Exception):
    """A case that a solver cannot pose, with the reason."""


class Broken(Exception):
    """A run that ended without a result, with what the solver said."""


@dataclass(frozen=True)
class Found:
    """A measured quantity and what the law says of it.

    error    distance between the two, in the case's own measure; allowed: the most it may be
    series   figures behind it, e.g. the error at each step, for the page
    """

    measured: float
    expected: float
    error: float
    allowed: float
    series: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    """A law with a name: `measure(solver)` gives a Found, or raises Unsupported or Broken.

    `group` is the entry-point group of the solvers that it is of.
    """

    name: str
    law: str
    source: str
    measure: Callable[[Any], Found]
    group: str = "nuno.integrators"


@dataclass(frozen=True)
class Outcome:
    """What a case says of a solver. `slip`: failed as the solver's own description announces."""

    case: str
    solver: str
    verdict: Literal["passed", "failed", "unsupported", "slip"]
    reason: str = ""
    found: Found | None = None
    seconds: float = 0.0

    def json(self) -> dict[str, Any]:
        """All fields; numbers that are not finite as text."""
        kept = {name: value for name, value in vars(self).items() if name != "found"}
        if self.found is None:
            return kept
        figures = {name: value for name, value in vars(self.found).items() if name != "series"}
        safe = {name: value if math.isfinite(value) else str(value) for name, value in figures.items()}
        return kept | safe | {"series": {name: list(values) for name, values in self.found.series.items()}}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Outcome:
        """The same again."""
        own = {each.name: data[each.name] for each in fields(Outcome) if each.name != "found"}
        if "measured" not in data:
            return Outcome(**own)
        series = {name: tuple(values) for name, values in data["series"].items()}
        figures = {name: float(data[name]) for name in ("measured", "expected", "error", "allowed")}
        return Outcome(**own, found=Found(**figures, series=series))


class Run:
    """A solver on one system, from the fabric's start."""

    def __init__(self, plugin: Any, system: System, settings: Mapping[str, float] = EXACT) -> None:
        self.plugin, self.system = plugin, system
        known = {name: value for name, value in settings.items() if name in plugin.Config.model_fields}
        self.config = plugin.Config(**known)
        self.state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
        self.memory = plugin.prepare(self.config, system, self.state)

    def go(self, steps: int, dt: float, poses: tuple[Poses, Poses] | None = None) -> StepReport:
        """One interval of whole steps. Raises Broken where the solver does not end well."""
        with np.errstate(all="ignore"):
            report: StepReport = self.plugin.advance(self.system, self.state, self.memory, poses, steps, dt)
        if report.status != "ok":
            raise Broken(f"{report.status}: {report.message}")
        return report

    def energy(self) -> float:
        """Energy of the present state [J], kinetic, gravitational and elastic."""
        return float(sum(self.go(0, 1.0).energy.values()))


def choose_step(run: Run, duration: float, longest: float, intervals: int = 1) -> tuple[int, float]:
    """Steps and step [s] for each of so many intervals of `duration`: 0.7 of the limit, what it resolves, `longest`.

    Raises Unsupported for a solver that has no stable step here, or needs too many in all.
    """
    limit = run.plugin.limit(run.config, run.system, run.state)
    if limit.dt <= 0.0:
        raise Unsupported("no step of this method is stable without damping")
    dt = min(longest, 0.7 * float(limit.dt), float(limit.resolved))
    total = intervals * duration / dt
    if total > MOST_STEPS:
        raise Unsupported(f"it would take {total:,.0f} steps of {dt:.2g} s, more than {MOST_STEPS:,}")
    steps = max(1, math.ceil(duration / dt * (1.0 - 1e-12)))
    return steps, duration / steps


def make_fabric(
    position: Float,
    springs: Springs | None = None,
    mass: Float | float = 1.0,
    pinned: Bool | None = None,
    velocity: Float | None = None,
    hinges: Hinges | None = None,
) -> Fabric:
    """A net at `position` (n, 3) [m]; mass [kg], one or (n,)."""
    n = position.shape[0]
    return Fabric(
        "law",
        np.ascontiguousarray(position, np.float64),
        np.zeros((n, 3)) if velocity is None else np.ascontiguousarray(velocity, np.float64),
        np.full(n, 1.0) * mass,
        np.zeros(n, bool) if pinned is None else pinned,
        np.zeros((0, 3), np.int32),
        springs,
        hinges,
    )


def chain(n: int, k: Float | float, rest: Float | float, c: float = 0.0) -> Springs:
    """Springs between consecutive vertices of n; k [N/m] and rest [m], one or (n - 1,)."""
    first = np.arange(n - 1, dtype=np.int32)
    one = np.ones(n - 1)
    return Springs.from_pairs(np.stack([first, first + 1], axis=1), one * k, one * rest, one * c)


def fit_order(steps: Float, errors: Float) -> float:
    """Slope of log error over log step; NaN where an error is 0 or not finite."""
    if not (np.isfinite(errors).all() and (errors > 0.0).all()):
        return math.nan
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def order_slack(order: int) -> float:
    """How far a fitted order may lie from the nominal one: methods from order 5 on meet rounding soon."""
    return 0.1 if order < 5 else 0.3
