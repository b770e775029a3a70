"""Errors in the words of a call, where the command line has flags."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

from nuno_schemas.errors import BadInput

RENAMED = {"set": "overrides", "root": "roots"}
OTHERS = ("dask", "jobs", "out", "over", "record", "resume", "root", "set", "threads")
"""Flags that are arguments of a call, beside those of `nuno export`; by the same name unless they are RENAMED."""


@cache
def _flag() -> re.Pattern[str]:
    """A flag, with what it is given where that is an example."""
    from nuno.exporting import ExportRequest

    names = "|".join([*ExportRequest.model_fields, *OTHERS])
    return re.compile(rf"(?<![^\s('\"])--({names})\b(?: (DIR|FILE\b|\S+=\S+|[A-Za-z0-9_]+\.[a-z0-9]+))?")


@contextlib.contextmanager
def in_python() -> Iterator[None]:
    """Raise what is refused inside in terms of the call's own arguments."""
    try:
        yield
    except BadInput as error:
        raise _translated(error) from None


def _translated(error: BadInput) -> BadInput:
    texts = {name: getattr(error, name) for name in ("problem", "field", "limit", "remedy")}
    if error.file is not None and error.file.startswith("--"):  # what was given with a flag
        texts["file"] = error.file
    changed: dict[str, Any] = {name: _flag().sub(_argument, text) for name, text in texts.items() if text is not None}
    if error.field is not None:
        changed["field"] = changed["field"].removeprefix("--")
    return replace(error, **changed)


def _argument(found: re.Match[str]) -> str:
    name, given = RENAMED.get(found[1], found[1]), found[2]
    if given is None:
        return name
    if found[1] == "set":
        return f'"{given}"'
    value = given if given == "FILE" else f"[{given}]" if given == "DIR" else f'"{given}"'
    return f"{name}={value}"
