"""Errors in terms of a call's arguments, in place of the command line's flags."""

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
"""Flags that are arguments of a call, besides those of `nuno export`, with the same name unless RENAMED."""


@cache
def _flag() -> re.Pattern[str]:
    """Return the pattern of a flag, with its value in an example."""
    from nuno.api.export import ExportRequest

    names = "|".join([*ExportRequest.model_fields, *OTHERS])
    return re.compile(rf"(?<![^\s('\"])--({names})\b(?: (DIR|FILE\b|\S+=\S+|[A-Za-z0-9_]+\.[a-z0-9]+))?")


@contextlib.contextmanager
def in_python() -> Iterator[None]:
    """Raise BadInput from inside in terms of the call's own arguments."""
    try:
        yield
    except BadInput as error:
        raise _translated(error) from None


def _translated(error: BadInput) -> BadInput:
    texts = {name: getattr(error, name) for name in ("problem", "field", "limit", "remedy")}
    if error.file is not None and error.file.startswith("--"):  # a flag's value
        texts["file"] = error.file
    changed: dict[str, Any] = {name: _flag().sub(_argument, text) for name, text in texts.items() if text is not None}
    if error.field is not None:
        changed["field"] = changed["field"].removeprefix("--")
    return replace(error, **changed)


def _argument(match: re.Match[str]) -> str:
    name, value_text = RENAMED.get(match[1], match[1]), match[2]
    if value_text is None:
        return name
    if match[1] == "set":
        return f'"{value_text}"'
    value = value_text if value_text == "FILE" else f"[{value_text}]" if value_text == "DIR" else f'"{value_text}"'
    return f"{name}={value}"
