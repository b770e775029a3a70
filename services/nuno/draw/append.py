"""Adding to a list of a scene's text, so that all else in it stays as it was written: comments, order, spacing.

A YAML library that writes a file anew keeps comments only in part and reflows the rest. Here the text is left alone:
what is added goes in at the end of a list of lines that begin with a dash, in its own indentation, or as a new list at
the end. The result is read again: unless it gives what was there and the new items, and nothing else, it is refused,
and no file is written.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from nuno.recording.writer import part_of
from nuno.scene import yaml_lines
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
    before, _ = yaml_lines.parse(text, file)
    there = before.get(field)
    if there is not None and not isinstance(there, list):
        raise BadInput(
            "this is no list that lines can be added to",
            file,
            field=field,
            remedy="write a list of lines that begin with a dash",
        )
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    assert isinstance(node, yaml.MappingNode)
    value = next((child for key, child in node.value if key.value == field), None)
    rows = "".join(f"{' ' * (value.start_mark.column if value else 2)}- {flow(item)}\n" for item in items)
    at = end_of(text, value or node)
    newline = "" if text[:at].endswith("\n") or not at else "\n"
    after = text[:at] + newline + ("" if value else f"{field}:\n") + rows + text[at:]
    expected = before | {field: [*(there or []), *items]}
    with contextlib.suppress(BadInput):
        if yaml_lines.parse(after, file)[0] == expected:
            return after
    remedy = f"write {field} as a list of lines that begin with a dash, or save under another name"
    raise BadInput("lines cannot be added to this text and all else left as it is", file, field=field, remedy=remedy)


def end_of(text: str, node: yaml.Node) -> int:
    """Where the last line of what a node holds ends: what follows it, comments too, is not its own."""
    last: yaml.Node = node
    while isinstance(last, yaml.CollectionNode) and not last.flow_style and last.value:
        child = last.value[-1]
        last = child[1] if isinstance(child, tuple) else child
    end = text.find("\n", last_mark(text, last))
    return len(text) if end < 0 else end + 1


def last_mark(text: str, node: yaml.Node) -> int:
    """The last character of a node that is no blank; a block of text ends at the line after its own."""
    end = node.end_mark.index
    if isinstance(node, yaml.ScalarNode) and node.style in ("|", ">"):
        end = len(text[:end].rstrip())
    return max(end, node.start_mark.index)


def flow(value: Any) -> str:
    """Plain values as YAML on one line, as scenes are written: text in quotes only where it could be something else."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {flow(child)}" for key, child in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(flow, value)) + "]"
    if isinstance(value, str) and re.fullmatch(r"[\w][\w .-]*", value) and yaml_lines.parse_value(value) == value:
        return value
    if isinstance(value, float):  # 2e-05, as JSON has it, is a text in YAML 1.1
        return str(yaml.representer.SafeRepresenter().represent_float(value).value)
    return json.dumps(value)


def write_whole(path: Path, text: str) -> None:
    """Replace a file by one that is whole, or leave it as it is. Raises BadInput.

    The text is written beside it, flushed to the disk, and renamed; rights stay, and a link is followed.
    """
    path = path.resolve()
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
