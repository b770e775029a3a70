"""What follows from a sweep: whether the reference can judge it, orders seen, and which solver for which accuracy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

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
CHOICE_HEADINGS = ("error at most", "fastest", "setting", "time [s]", "next ones [s]")


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
