"""What a measurement gives: all its samples, what they are held against, and whether that was met."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from nuno_bench.report.page import Table
from nuno_schemas.errors import BadInput, RunFailed

SAID = 360
"""Most characters of a reason in a table."""
SAME_TIME = 1.1
"""Medians within a tenth of each other count as the same, as everywhere in the benches."""


@dataclass(frozen=True)
class Result:
    """One measured quantity.

    samples          one value per repeat, in `unit`; empty where the measurement failed
    bar, aim         what must and what should be reached: at least, or at most where `at_most`
    compile_seconds  first call, compiling or loading included; it is in no sample [s]
    limit            what the hardware could do at best, in the same unit
    failure          why there are no samples
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
        """Of rates, which are so much a second; of times, ratios and whatever else is counted, less is."""
        return self.unit.endswith("/s")

    @property
    def verdict(self) -> str:
        """failed, missed, bar met, aim met, or "" where nothing is asked."""
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
    """One row of text per result, under HEADINGS."""
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
    """Smallest and largest."""
    return f"{number(min(samples))} - {number(max(samples))}" if len(samples) > 1 else "once"


def factor(a: float, b: float) -> float:
    """By how much two errors or times differ, at least 1."""
    low, high = sorted((a, b))
    return high / low if low > 0.0 else (1.0 if high == 0.0 else float("inf"))


def apart(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether two sets of repeats do not overlap, and their medians differ by more than a tenth.

    Of a time that was taken once the spread is not known, so nothing is said of it.
    """
    if min(len(a), len(b)) < 2:
        return False
    overlap = max(a) >= min(b) and max(b) >= min(a)
    return not overlap and factor(statistics.median(a), statistics.median(b)) > SAME_TIME


def number(value: float) -> str:
    """Three significant digits, without an exponent where a person would not write one."""
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        digits = f"{value:.3g}"
        return digits if "e" not in digits else f"{value:,.0f}"
    return f"{value:.0e}" if abs(value) >= 1e9 else f"{value:.3g}"


def reason_of(error: BadInput | RunFailed) -> str:
    """Why a solver is left out, on one line, without the middle of what a compiler has to say."""
    said = error.problem if isinstance(error, BadInput) else " ".join(str(error).split())
    return said if len(said) <= SAID else f"{said[: SAID * 2 // 3]} ... {said[-SAID // 3 :]}"
