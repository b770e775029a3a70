"""A scene's file: reading its exact text, adding items to its lists, and replacing it atomically."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nuno.process import check_unprotected
from nuno.recording.writer import part_of
from nuno.scene import yaml_lines
from nuno.scene.edit import put
from nuno_schemas.errors import BadInput

MARK = "\ufeff"
"""A byte order mark, which some editors write at the start of a file."""


def read_text(path: Path) -> str:
    """Return a file's exact text, with line ends and byte order mark. Raises BadInput."""
    try:
        return path.read_bytes().decode("utf-8")
    except UnicodeDecodeError:
        raise BadInput("not a text file", str(path), remedy="a scene is YAML in UTF-8") from None
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", str(path)) from None


def append_items(text: str, field: str, items: Sequence[Any], file: str) -> str:
    """Return a scene's text with `items` at the end of the list `field`, which may be missing. Raises BadInput."""
    present = yaml_lines.parse(text, file)[0].get(field)
    if present is not None and not isinstance(present, list):
        raise BadInput("this is no list that lines can be added to", file, field=field, remedy="write it as a list")
    for number, item in enumerate(items, len(present or ())):
        text = put(text, (field, number), item, file)
    return text


def write_whole(path: Path, text: str) -> None:
    """Replace a file's text completely, or leave it unchanged. Raises BadInput.

    The text is written to a file next to it, flushed to the disk, and renamed; permissions are kept, links followed.
    """
    path = path.resolve()
    check_unprotected(path)
    part = part_of(path)
    try:
        with part.open("w", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if path.exists():
            shutil.copymode(path, part)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        remedy = "choose a folder that can be written, or export the lines"
        raise BadInput(f"cannot be written: {error.strerror}", str(path), remedy=remedy) from None
