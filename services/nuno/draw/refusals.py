"""Refusals as the page shows them: beside the line that they are about."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from nuno_schemas.errors import BadInput

_SAID = re.compile(r"^  (value|limit|remedy): +", re.MULTILINE)
_LINE = re.compile(r"lines\[(\d+)\]")


def describe(error: BadInput) -> dict[str, Any]:
    """What the page is told of an error."""
    value = None if error.value is None else str(error.value)[:200]
    return {
        "problem": error.problem,
        "field": error.field or "",
        "value": value,
        "limit": error.limit,
        "remedy": error.remedy,
    }


def said_by_run(error: BadInput, which: Sequence[int]) -> BadInput:
    """A refusal that came over the bus as text, taken apart again; `which` of the page's lines were sent."""
    parts = _SAID.split(error.problem)
    found = dict(zip(parts[1::2], (part.strip() for part in parts[2::2]), strict=True))
    head = parts[0].strip()
    place = re.search(r"(\S*lines\[\d+\]\S*): ", head)
    problem, field = (head[place.end() :], about(place[1], which)) if place else (head, None)
    value = found.get("value", "").strip("'\"") or None
    return replace(
        error, problem=problem, field=field, value=value, limit=found.get("limit"), remedy=found.get("remedy")
    )


def about(field: str, which: Sequence[int]) -> str:
    """The field of one of the page's lines, of which those of the numbers `which` were looked at."""
    line = _LINE.search(field)
    if line is None or int(line[1]) >= len(which):
        return field
    return f"lines[{which[int(line[1])]}]{field[line.end() :]}"
