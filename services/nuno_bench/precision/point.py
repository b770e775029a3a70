"""Measured settings of solvers: their errors as shares of the scene's own scale, and what follows from all of them."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from pydantic import TypeAdapter

from nuno_bench.problem.observe import Series
from nuno_bench.report.result import number
from nuno_schemas.fabric import Float

DONE = "done"
RAN_AWAY = 2.0
"""A run that comes this many times its scale away from the reference has left it, whatever chaos does."""
ABOVE = 3.0
"""Errors are known to a third from this multiple of the floor on."""
TARGETS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
ASYMPTOTIC = 0.1
"""Orders are fitted below this share of the scale: a run that is wholly off has no order."""
FITTED = 4
"""Of the finest resolved points an order is fitted over, at most."""
FLOOR_HEADINGS = ("in", "floor", "errors above it", "verdict")
CHOICE_HEADINGS = ("error at most", "fastest", "setting", "time [s]", "next ones [s]")


@dataclass(frozen=True)
class Error:
    """Shares of the scale: at the last compared frame, root mean square and largest over the frames.

    Of the leading quantity final and l2 are root mean squares over the vertices or cells too, and linf is that of
    the farthest one.
    """

    final: float
    l2: float
    linf: float


@dataclass(frozen=True)
class Point:
    """One setting of one solver, measured.

    outcome  "done", "diverged", "unconverged", "ran away", "refused" (by the solver), "failed" (the solver itself),
             "cut" (out of time)
    seconds  of each repeat, in the solver's own calls [s]
    finer    the step [s], of an adaptive solver the tolerance
    share    of the stability limit that the step is, None where there is no step or nothing limits it
    errors   by quantity, where the run reached its end
    history  by quantity, the error at every compared frame but the first, to four digits
    """

    solver: str
    setting: str
    kind: str
    order: int
    finer: float
    beyond: bool
    outcome: str
    message: str
    seconds: tuple[float, ...]
    totals: Mapping[str, int]
    errors: Mapping[str, Error]
    history: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    share: float | None = None

    @property
    def key(self) -> tuple[str, str]:
        return self.solver, self.setting

    @property
    def median(self) -> float:
        return statistics.median(self.seconds) if self.seconds else float("nan")

    @property
    def done(self) -> bool:
        return self.outcome == DONE

    def error(self, quantity: str) -> float | None:
        """Its l2 error in a quantity, None where there is none."""
        return self.errors[quantity].l2 if quantity in self.errors else None


POINT = TypeAdapter(Point)
"""Reads what dataclasses.asdict made, in which a number that is not finite may be text."""


def measure_errors(run: Series, reference: Series, scales: Mapping[str, float], frames: int) -> dict[str, Error]:
    """Errors by quantity, divided by the reference's `scales`; of the leading one over the first `frames` frames, and
    only where there are some beside the start.

    Nothing where a run did not reach the end: its errors would be those of another stretch of time.
    """
    if len(run.t) < len(reference.t):
        return {}
    over = errors_over_frames(run, reference, scales, frames)
    found = {name: Error(float(e[-1]), float(np.sqrt((e**2).mean())), float(e.max())) for name, e in over.items()}
    leading = reference.leading
    if leading in found:
        farthest = np.linalg.norm(run.x[1:frames] - reference.x[1:frames], axis=2).max() / scales[leading]
        found[leading] = replace(found[leading], linf=float(farthest))
    return found


def errors_over_frames(run: Series, reference: Series, scales: Mapping[str, float], frames: int) -> dict[str, Float]:
    """The error at every compared frame but the first, by quantity; of the leading one its root mean square."""
    found: dict[str, Float] = {}
    if frames > 1:
        found[reference.leading] = _apart(run, reference)[1:frames] / scales[reference.leading]
    for name, values in reference.values.items():
        found[name] = np.linalg.norm(run.values[name][1:] - values[1:], axis=1) / scales[name]
    return found


def ran_away(run: Series, reference: Series, size: float) -> float | None:
    """When a run was first RAN_AWAY times `size` from the reference [s], or None."""
    frames = np.flatnonzero(~(_apart(run, reference) <= RAN_AWAY * size))
    return float(run.t[frames[0]]) if frames.size else None


def _apart(run: Series, reference: Series) -> Float:
    """Root mean square distance at each of the run's frames (f,)."""
    apart: Float = np.sqrt(((run.x - reference.x[: len(run.t)]) ** 2).sum(axis=2).mean(axis=1))
    return apart


class Judgement(NamedTuple):
    """Whether the reference can tell the errors of a quantity, in words under FLOOR_HEADINGS.

    resolved counts points above ABOVE times the floor, of all. The verdict is judged, where all errors are known; in
    part, where some are too near the floor; failed, where all are.
    """

    quantity: str
    floor: str
    resolved: str
    verdict: str


def judge(points: Sequence[Point], floors: Mapping[str, Error]) -> list[Judgement]:
    """One judgement per quantity."""
    judged = []
    for name, floor in floors.items():
        errors = [error for point in points if (error := point.error(name)) is not None]
        known, total = sum(error > ABOVE * floor.l2 for error in errors), len(errors)
        verdict = "no point" if not total else "judged" if known == total else "in part" if known else "failed"
        judged.append(Judgement(name, f"{floor.l2:.1e}", f"{known} of {total}", verdict))
    return judged


def fit_order(points: Sequence[Point], quantity: str, floor: float) -> float | None:
    """Slope of the error over the step, or over the tolerance, by logarithms of the finest resolved points.

    None with fewer than three of them.
    """
    found = sorted(
        (point.finer, error)
        for point in points
        if (error := point.error(quantity)) is not None and ABOVE * floor < error < ASYMPTOTIC and not point.beyond
    )[:FITTED]
    if len(found) < 3:
        return None
    steps, errors = np.log(np.array(found)).T
    return float(np.polyfit(steps, errors, 1)[0])


def by_solver(points: Sequence[Point]) -> dict[str, list[Point]]:
    """Points of each solver from coarse to fine, solvers in the order of their first point."""
    found: dict[str, list[Point]] = {}
    for point in points:
        found.setdefault(point.solver, []).append(point)
    return {name: sorted(own, key=lambda point: -point.finer) for name, own in found.items()}


def choice_rows(points: Sequence[Point], quantity: str, floor: float) -> list[list[str]]:
    """Which solver is fastest within each target that the floor allows to judge, under CHOICE_HEADINGS.

    A point that is fastest for several targets stands at the tightest of them. What is stable only by luck is no
    choice.
    """
    rows: list[list[str]] = []
    known = [(p, e) for p in points if (e := p.error(quantity)) is not None and p.seconds and not p.beyond]
    tighter: tuple[str, str] | None = None
    for target in sorted(target for target in TARGETS if target >= ABOVE * floor):
        best: dict[str, Point] = {}
        for point in sorted((p for p, error in known if error <= target), key=lambda p: p.median):
            best.setdefault(point.solver, point)
        ranked = list(best.values())
        if ranked and (first := ranked[0]).key != tighter:
            rest = ", ".join(f"{point.solver} {number(point.median)}" for point in ranked[1:3])
            rows.append([f"{target:g}", first.solver, first.setting, number(first.median), rest])
            tighter = first.key
    return rows[::-1]
