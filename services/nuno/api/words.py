"""Errors in the words of a call, where the command line has flags."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from nuno_schemas.errors import BadInput

WORDS = (
    (r"--set (\S+)", r'"\1"'),
    (r"--root DIR", "roots=[DIR]"),
    (r"--record FILE", "record=FILE"),
    (r"--set\b", "overrides"),
    (r"--over\b", "over"),
    (r"--root\b", "roots"),
    (r"--([a-z]+) ([A-Za-z0-9_.]+\.[a-z0-9]+)", r'\1="\2"'),
    (r"--([a-z]+)\b", r"\1"),
)
"""Flags of the command line, and what they are as arguments."""


@contextlib.contextmanager
def in_python() -> Iterator[None]:
    """Raise what is refused inside in terms of the call's own arguments."""
    try:
        yield
    except BadInput as error:
        raise _translated(error) from None


def _translated(error: BadInput) -> BadInput:
    changed: dict[str, Any] = {}
    for name in ("problem", "file", "field", "limit", "remedy"):
        text = getattr(error, name)
        for flag, argument in WORDS:
            text = re.sub(flag, argument, text) if text is not None else None
        changed[name] = text
    return replace(error, **changed)
