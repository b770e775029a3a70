"""Results of measurements: all samples, their bars, and whether these were met."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from nuno_bench.report.page import Table
from nuno_schemas.errors import BadInput, RunFailed

MOST_REASON = 360
"""Most characters of a reason in a table."""
SAME_TIME = 1.1
"""Medians within a tenth of each other count as the same, as everywhere in the benches."""


@dataclass(frozen=True)
class Result:
    """One measured quantity.

    samples          one value per repeat, in `unit`; empty if the measurement failed
    bar, aim         values that must and should be reached: at least, or at most if `at_most`
    compile_seconds  first call, with compiling or loading, which is not in the samples [s]
    limit            theoretical limit of the hardware, in the same unit
    failure          reason for missing samples
    """

    case: str
    what: str
    unit: str
    samples: tuple[float, ...] = ()
    bar: float | None = None
    aim: float | None = None
    at_most: bool = False
    compile_seconds: float | None = None
    limit: float | None = None
    note: str = ""
    failure: str = ""

    @property
    def median(self) -> float:
        return statistics.median(self.samples)

    @property
    def more_is_better(self) -> bool:
        """Whether more is better: for rates per second, but not for times, ratios and other counts."""
        return self.unit.endswith("/s")

    @property
    def verdict(self) -> str:
        """failed, missed, bar met, aim met, or "" without a bar."""
        if self.failure or not self.samples:
            return "failed"
        if self.bar is None:
            return ""
        if not self._reaches(self.bar):
            return "missed"
        return "aim met" if self.aim is not None and self._reaches(self.aim) else "bar met"

    def _reaches(self, wanted: float) -> bool:
        return self.median <= wanted if self.at_most else self.median >= wanted


HEADINGS = ("case", "what", "median", "min - max", "unit", "bar", "aim", "of limit", "first call", "verdict")


def table(results: Sequence[Result], caption: str = "") -> Table:
    """Return a table with one row per result, under HEADINGS."""
    return Table(HEADINGS, [_row(result) for result in results], caption)


def _row(result: Result) -> list[str]:
    sign = "<= " if result.at_most else ">= "
    wanted = [f"{sign}{number(value)}" if value is not None else "" for value in (result.bar, result.aim)]
    if not result.samples:
        return [result.case, result.what, "-", "", result.unit, *wanted, "", "", "failed"]
    share = f"{result.median / result.limit:.0%}" if result.limit else ""
    first = f"{result.compile_seconds:.2g} s" if result.compile_seconds is not None else ""
    median, spread = number(result.median), spread_of(result.samples)
    return [result.case, result.what, median, spread, result.unit, *wanted, share, first, result.verdict]


def spread_of(samples: Sequence[float]) -> str:
    """Return the smallest and largest sample as text."""
    return f"{number(min(samples))} - {number(max(samples))}" if len(samples) > 1 else "once"


def factor(a: float, b: float) -> float:
    """Return the factor between two errors or times, at least 1."""
    low, high = sorted((a, b))
    return high / low if low > 0.0 else (1.0 if high == 0.0 else float("inf"))


def apart(a: Sequence[float], b: Sequence[float]) -> bool:
    """Return whether two sets of repeats do not overlap, and their medians differ by more than a tenth.

    The spread of a single time is unknown, so the answer is no.
    """
    if min(len(a), len(b)) < 2:
        return False
    overlap = max(a) >= min(b) and max(b) >= min(a)
    return not overlap and factor(statistics.median(a), statistics.median(b)) > SAME_TIME


def number(value: float) -> str:
    """Return three significant digits, without an exponent for numbers of common size."""
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        digits = f"{value:.3g}"
        return digits if "e" not in digits else f"{value:,.0f}"
    return f"{value:.0e}" if abs(value) >= 1e9 else f"{value:.3g}"


def reason_of(error: BadInput | RunFailed) -> str:
    """Return the reason for leaving out a solver, on one line, without the middle of long compiler messages."""
    text = error.problem if isinstance(error, BadInput) else " ".join(str(error).split())
    return text if len(text) <= MOST_REASON else f"{text[: MOST_REASON * 2 // 3]} ... {text[-MOST_REASON // 3 :]}"
