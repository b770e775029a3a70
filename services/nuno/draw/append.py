"""A scene's file: its text as it is, items added to a list of it, and the file replaced by one that is whole."""

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
"""A byte order mark, which some editors begin a file with."""


def read_text(path: Path) -> str:
    """A file's text as it is, line ends and byte order mark too. Raises BadInput."""
    try:
        return path.read_bytes().decode("utf-8")
    except UnicodeDecodeError:
        raise BadInput("not a text file", str(path), remedy="a scene is YAML in UTF-8") from None
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", str(path)) from None


def append_items(text: str, field: str, items: Sequence[Any], file: str) -> str:
    """A scene's text with `items` at the end of the list `field`, made where there is none. Raises BadInput."""
    there = yaml_lines.parse(text, file)[0].get(field)
    if there is not None and not isinstance(there, list):
        raise BadInput("this is no list that lines can be added to", file, field=field, remedy="write it as a list")
    for number, item in enumerate(items, len(there or ())):
        text = put(text, (field, number), item, file)
    return text


def write_whole(path: Path, text: str) -> None:
    """Replace a file by one that is whole, or leave it as it is. Raises BadInput.

    The text is written beside it, flushed to the disk, and renamed; rights stay, and a link is followed.
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
