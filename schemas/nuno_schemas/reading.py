"""Files that other programs wrote."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from nuno_schemas.errors import BadInput

Found = TypeVar("Found")


def read_as(path: Path, kind: str, read: Callable[[bytes], Found], largest: int) -> Found:
    """What a reader finds in a file. Raises BadInput for one that is larger than so many bytes, or cannot be read."""
    size = path.stat().st_size
    if size > largest:
        raise BadInput(f"too large for {kind}", str(path), field="file", value=size, limit=f"{largest} bytes")
    try:
        return read(path.read_bytes())
    except BadInput as error:
        raise replace(error, file=str(path)) from None
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError, RecursionError, struct.error) as error:
        remedy = f"is it cut off, or not {kind}? Export it anew from the program that it comes from"
        raise BadInput(f"cannot be read as {kind}: {error}", str(path), field="file", remedy=remedy) from None
