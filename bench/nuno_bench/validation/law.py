"""A law as a case with an outcome, and the runs of solvers for it: through the plugin protocol alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from inspect import getdoc
from typing import Any, Literal

import numpy as np

from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Bool, Fabric, Float, Hinges, Springs, State
from nuno_schemas.system import StepReport, System

NONE = np.zeros(3)
MOST_STEPS = 400_000
"""A case that would take a solver more steps than this is not posed to it."""
EXACT: Mapping[str, float] = {"tolerance": 1.0, "residual": 1e-12}
"""Steps of the given length, solved to rounding."""
ACCURATE: Mapping[str, float] = {"tolerance": 1e-8, "residual": 1e-8, "iterations": 100}
"""Steps as a careful user would have them."""


class Unsupported(Exception):
    """A case that a solver cannot pose, with the reason."""


class BrokenRun(Exception):
    """A run that ended without a result, with what the solver said."""


@dataclass(frozen=True)
class Measurement:
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

    `source` is where it is from, `group` the entry-point group of the solvers that it is of.
    """

    name: str
    law: str
    source: str
    measure: Callable[[Any], Measurement]
    group: str = "nuno.integrators"


class Laws(list[Case]):
    """The cases of a module, in order; each is added by decorating what measures it, whose docstring is the law."""

    def __init__(self, group: str = "nuno.integrators") -> None:
        self.group = group

    def __call__(
        self, name: str | Mapping[str, Mapping[str, Any]], source: str
    ) -> Callable[[Callable[..., Measurement]], Callable[..., Measurement]]:
        """A case of this name; or cases by name, each with what else `measure` is given."""

        def add(measure: Callable[..., Measurement]) -> Callable[..., Measurement]:
            law = (getdoc(measure) or "").partition("\n\n")[0].replace("\n", " ").rstrip(".")
            for one, given in ({name: {}} if isinstance(name, str) else name).items():
                self.append(Case(one, law, source, partial(measure, **given), self.group))
            return measure

        return add


@dataclass(frozen=True)
class Outcome:
    """Outcome of a case for a solver. `slip`: failed as the solver's own description announces."""

    case: str
    solver: str
    verdict: Literal["passed", "failed", "unsupported", "slip"]
    reason: str = ""
    found: Measurement | None = None
    seconds: float = 0.0


class SolverRun:
    """A solver on one system, from the fabric's start."""

    def __init__(self, plugin: Any, system: System, settings: Mapping[str, float] = EXACT) -> None:
        self.plugin, self.system = plugin, system
        known = {name: value for name, value in settings.items() if name in plugin.Config.model_fields}
        self.config = plugin.Config(**known)
        self.state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
        self.memory = plugin.prepare(self.config, system, self.state)

    def go(self, steps: int, dt: float, poses: tuple[Poses, Poses] | None = None) -> StepReport:
        """One interval of whole steps. Raises BrokenRun if the solver fails."""
        with np.errstate(all="ignore"):
            report: StepReport = self.plugin.advance(self.system, self.state, self.memory, poses, steps, dt)
        if report.status != "ok":
            raise BrokenRun(f"{report.status}: {report.message}")
        return report

    def energy(self) -> float:
        """Energy of the present state [J], kinetic, gravitational and elastic."""
        return float(sum(self.go(0, 1.0).energy.values()))

    def both(self) -> Float:
        """(2, n, 3) positions [m] and velocities [m/s]."""
        return np.stack([self.state.x, self.state.v])


def choose_step(run: SolverRun, duration: float, longest: float, intervals: int = 1) -> tuple[int, float]:
    """Steps and step [s] for each of so many intervals of `duration`: 0.7 of the limit, what it resolves, `longest`.

    Raises Unsupported for a solver that has no stable step here, or needs too many in all.
    """
    limit = run.plugin.limit(run.config, run.system, run.state)
    if limit.dt <= 0.0:
        raise Unsupported("no step of this method is stable without damping")
    return whole_steps(duration, min(longest, 0.7 * float(limit.dt), float(limit.resolved)), intervals)


def whole_steps(duration: float, dt: float, intervals: int = 1) -> tuple[int, float]:
    """Steps of at most dt [s] that make up `duration`, and their length. Raises Unsupported for too many in all."""
    if (total := intervals * duration / dt) > MOST_STEPS:
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
    n, x = len(position), np.ascontiguousarray(position, np.float64)
    v = np.zeros((n, 3)) if velocity is None else np.ascontiguousarray(velocity, np.float64)
    held = np.zeros(n, bool) if pinned is None else pinned
    return Fabric("law", x, v, np.full(n, 1.0) * mass, held, np.zeros((0, 3), np.int32), springs, hinges)


def chain(n: int, k: Float | float, rest: Float | float, c: float = 0.0) -> Springs:
    """Springs between consecutive vertices of n; k [N/m] and rest [m], one or (n - 1,)."""
    first = np.arange(n - 1, dtype=np.int32)
    one = np.ones(n - 1)
    return Springs.from_pairs(np.stack([first, first + 1], axis=1), one * k, one * rest, one * c)


def relative(measured: float, expected: float, allowed: float) -> Measurement:
    """Found, its error as a share of what is expected."""
    return Measurement(measured, expected, abs(measured / expected - 1.0), allowed)


def bisect(low: float, high: float, above: Callable[[float], bool], times: int = 60) -> float:
    """Return the value between low and high from which on `above` holds, to (high - low) / 2^times."""
    for _ in range(times):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if above(middle) else (middle, high)
    return high


def fit_order(
    steps: Float, errors: Float, expected: float, *, least: bool = False, kept: Bool | None = None
) -> Measurement:
    """The slope of log error over log step against the order that is expected, or is the `least` that is.

    It is fitted to the errors that are `kept`, all by default; NaN, which fails, where one of them is 0 or not finite.
    Methods from order 5 on meet rounding soon, and may be further off.
    """
    kept = np.ones(len(errors), bool) if kept is None else kept
    sound = bool(np.isfinite(errors[kept]).all() and (errors[kept] > 0.0).all())
    order = float(np.polyfit(np.log(steps[kept]), np.log(errors[kept]), 1)[0]) if sound else math.nan
    off = expected - order if least else abs(order - expected)
    series = {"dt": tuple(map(float, steps)), "error": tuple(map(float, errors))}
    return Measurement(order, expected, max(0.0, off) if sound else math.nan, 0.1 if expected < 5 else 0.3, series)
