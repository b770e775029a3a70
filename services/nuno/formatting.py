"""Numbers as people read them, and as JSON can say them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any

TIMES = ((86400.0, "d"), (3600.0, "h"), (60.0, "min"), (1.0, "s"))
LONG = 1000.0
"""Times up to this [s] are told in seconds."""


def time_of(seconds: float) -> tuple[float, str]:
    """The largest unit of time that is not longer, and its name; at least a second."""
    return next((unit for unit in TIMES if abs(seconds) >= unit[0]), TIMES[-1])


def duration(seconds: float) -> str:
    """A time in seconds, and a long one in minutes, hours or days."""
    unit, name = time_of(seconds) if abs(seconds) > LONG else TIMES[-1]
    return f"{seconds / unit:.3g} {name}"


def roughly(seconds: float) -> str:
    """A time that is not known better, in its own unit: about 8 min."""
    unit, name = time_of(seconds)
    return f"about {seconds / unit:.2g} {name}"


def factor(times: float) -> str:
    """How many times as fast, without digits that nobody reads."""
    return f"{times:.2f}x" if times < 100.0 else f"{times:,.0f}x"


def many(number: float, noun: str) -> str:
    """So many of a thing, whose name takes an s where there is more than one."""
    return f"{number:,.0f} {noun}{'' if number == 1 else 's'}"


def megabytes(size: float) -> str:
    """Bytes in MB, and of many in GB."""
    return f"{size / 1e6:.3g} MB" if size < 9.995e8 else f"{size / 1e9:.3g} GB"


def counted(counts: Mapping[str, int]) -> str:
    """How many of each topic."""
    return ", ".join(f"{number:,} of {topic}" for topic, number in counts.items())


def plain(text: str) -> str:
    """A text with what a terminal would obey, or could not show, written out."""
    shown = (c if c.isprintable() or c == "\n" else c.encode("unicode_escape", "surrogatepass").decode() for c in text)
    return "".join(shown)


def for_json(value: Any) -> Any:
    """What JSON can say of a value: arrays and dataclasses as lists and objects; infinity and NaN as text."""
    if is_dataclass(value) and not isinstance(value, type):
        value = vars(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: for_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [for_json(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
