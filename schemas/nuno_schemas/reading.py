"""Reading of files from other programs."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from nuno_schemas.errors import BadInput
from nuno_schemas.units import decimal_point

Found = TypeVar("Found")
_COMMA = re.compile(r"(?<![^\s'\"])[+-]?\d*,\d+(?:[eE][+-]?\d+)?(?![^\s'\"])")


def read_as(path: Path, kind: str, read: Callable[[bytes], Found], largest: int) -> Found:
    """Return the result of `read` for a file's bytes. Raises BadInput for an unreadable file, or one of more than
    `largest` bytes.
    """
    size = path.stat().st_size
    if size > largest:
        raise BadInput(f"too large for {kind}", str(path), field="file", value=size, limit=f"{largest} bytes")
    try:
        data = path.read_bytes()
        return read(data)
    except BadInput as error:
        raise replace(error, file=str(path)) from None
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError, RecursionError, struct.error) as error:
        line = None
        if comma := _COMMA.search(str(error)):  # the number is not in a comment
            match = re.search(rb"(?m)^(?!\s*comment).*?(?<!\S)%b(?!\S)" % re.escape(comma[0].encode()), data)
            line = data.count(b"\n", 0, match.end()) + 1 if match else None
        remedy = with_point(str(error)) or f"is it cut off, or not {kind}? Export it anew from where it comes from"
        raise BadInput(f"cannot be read as {kind}: {error}", str(path), line, "file", remedy=remedy) from None


def with_point(words: str) -> str | None:
    """Return a remedy for the first number with a decimal comma in a text, such as an error's; None without one."""
    comma = _COMMA.search(words)
    return f"{decimal_point(comma[0])}: numbers have a decimal point" if comma else None
