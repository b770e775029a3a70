"""What follows from a sweep: whether the reference can judge it, orders seen, and which solver for which accuracy."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nuno_bench.precision.errors import Error
from nuno_bench.precision.point import Point
from nuno_bench.report.result import number

ABOVE = 3.0
"""Errors are known to a third from this multiple of the floor on."""
TARGETS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
ASYMPTOTIC = 0.1
"""Orders are fitted below this share of the scale: a run that is wholly off has no order."""
FITTED = 4
"""Of the finest resolved points an order is fitted over, at most."""


FLOOR_HEADINGS = ("in", "floor", "errors above it", "verdict")


@dataclass(frozen=True)
class Judgement:
    """Whether the reference can tell the errors of a quantity: points above ABOVE times the floor, and all."""

    quantity: str
    floor: float
    resolved: int
    total: int

    @property
    def verdict(self) -> str:
        if self.total == 0:
            return "no point"
        return "judged" if self.resolved == self.total else "in part" if self.resolved else "failed"

    def row(self) -> list[str]:
        """Its line under FLOOR_HEADINGS."""
        return [self.quantity, f"{self.floor:.1e}", f"{self.resolved} of {self.total}", self.verdict]

    def describe(self) -> str:
        said = f"{self.quantity}: the reference disagrees with itself by {self.floor:.1e}"
        if self.verdict == "failed":
            return f"{said}, as much as all errors it should judge: nothing is known of them"
        return f"{said}; {self.resolved} of {self.total} errors are at least {ABOVE:g} times that"


def judge(points: Sequence[Point], floors: Mapping[str, Error]) -> list[Judgement]:
    """One judgement per quantity."""
    judged = []
    for name, floor in floors.items():
        errors = [error for point in points if (error := point.error(name)) is not None]
        judged.append(Judgement(name, floor.l2, sum(error > ABOVE * floor.l2 for error in errors), len(errors)))
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


def solvers_of(points: Sequence[Point]) -> list[str]:
    """Solvers in the order of their first point."""
    return list(dict.fromkeys(point.solver for point in points))


ORDER_HEADINGS = ("solver", "kind", "nominal order", "seen", "first call [s]", "points", "not done")


def order_rows(
    points: Sequence[Point],
    quantity: str,
    floor: float,
    first_calls: Mapping[str, float],
    unfitted: Collection[tuple[str, str]] = (),
) -> list[list[str]]:
    """A line per solver, under ORDER_HEADINGS; no order is fitted to points with keys in `unfitted`."""
    rows = []
    for name in solvers_of(points):
        own = [point for point in points if point.solver == name]
        slope = fit_order([point for point in own if point.key not in unfitted], quantity, floor)
        adaptive = own[0].kind == "adaptive"
        seen = "" if slope is None else f"{slope:.2f}" + (" of the tolerance" if adaptive else "")
        failed = sum(not point.done for point in own)
        first = number(first_calls[name]) if name in first_calls else ""
        nominal = str(own[0].order or "not stated")
        rows.append([name, own[0].kind, nominal, seen, first, str(len(own)), str(failed) if failed else ""])
    return rows


def fastest(points: Sequence[Point], quantity: str, target: float) -> list[Point]:
    """Each solver's fastest point within a target, fastest first; what is stable only by luck is no choice."""
    best: dict[str, Point] = {}
    for point in points:
        error = point.error(quantity)
        if error is None or not error <= target or point.beyond or not point.seconds:
            continue
        if point.solver not in best or point.median < best[point.solver].median:
            best[point.solver] = point
    return sorted(best.values(), key=lambda point: point.median)


CHOICE_HEADINGS = ("error at most", "fastest", "setting", "time [s]", "next ones [s]")


def choice_rows(points: Sequence[Point], quantity: str, floor: float) -> list[list[str]]:
    """Which solver is fastest within each target that the floor allows to judge, under CHOICE_HEADINGS.

    A point that is fastest for several targets stands at the tightest of them.
    """
    rows: list[list[str]] = []
    tighter: tuple[str, str] | None = None
    for target in sorted(target for target in TARGETS if target >= ABOVE * floor):
        best = fastest(points, quantity, target)
        if best and best[0].key != tighter:
            rest = ", ".join(f"{point.solver} {number(point.median)}" for point in best[1:3])
            rows.append([f"{target:g}", best[0].solver, best[0].setting, number(best[0].median), rest])
            tighter = best[0].key
    return rows[::-1]
