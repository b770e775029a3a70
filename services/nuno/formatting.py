"""Formatting of numbers for texts and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any

TIMES = ((86400.0, "d"), (3600.0, "h"), (60.0, "min"), (1.0, "s"))
LONG = 1000.0
"""Longest time that is written in seconds [s]."""


def time_of(seconds: float) -> tuple[float, str]:
    """Return the largest unit of time that is not longer, and its name; at least a second."""
    return next((unit for unit in TIMES if abs(seconds) >= unit[0]), TIMES[-1])


def duration(seconds: float) -> str:
    """Format a time in seconds, and a long one in minutes, hours or days."""
    unit, name = time_of(seconds) if abs(seconds) > LONG else TIMES[-1]
    return f"{seconds / unit:.3g} {name}"


def roughly(seconds: float) -> str:
    """Format an approximate time, in a fitting unit: about 8 min."""
    unit, name = time_of(seconds)
    return f"about {seconds / unit:.2g} {name}"


def factor(times: float) -> str:
    """Format a factor with few digits."""
    return f"{times:.2f}x" if times < 100.0 else f"{times:,.0f}x"


def many(number: float, noun: str) -> str:
    """Format a number of things; the noun gets an s for the plural."""
    return f"{number:,.0f} {noun}{'' if number == 1 else 's'}"


def data_size(size: float) -> str:
    """Format a number of bytes in kB, MB or GB."""
    unit, name = next((unit for unit in ((1e3, "kB"), (1e6, "MB")) if size < 999.5 * unit[0]), (1e9, "GB"))
    return f"{size / unit:.3g} {name}"


def counted(counts: Mapping[str, int]) -> str:
    """Format the numbers of messages by topic."""
    return ", ".join(f"{number:,} of {topic}" for topic, number in counts.items())


def plain(text: str) -> str:
    """Escape control characters and others that a terminal cannot show."""
    shown = (c if c.isprintable() or c == "\n" else c.encode("unicode_escape", "surrogatepass").decode() for c in text)
    return "".join(shown)


def for_json(value: Any) -> Any:
    """Convert a value for JSON: arrays and dataclasses to lists and objects, infinity and NaN to text."""
    if is_dataclass(value) and not isinstance(value, type):
        value = vars(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: for_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [for_json(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
