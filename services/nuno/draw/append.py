"""Adding to a list of a scene's text, so that all else in it stays as it was written: comments, order, spacing.

A YAML library that writes a file anew keeps comments only in part and reflows the rest. Here the text is left alone:
what is added goes in at the end of the list, in the list's own style and indentation, and the result is read again.
Unless that gives what was there and the new items, and nothing else, it is refused, and no file is written.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from nuno.scene import yaml_lines
from nuno_schemas.errors import BadInput


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
        raise BadInput("this is no list that lines can be added to", file, field=field, remedy="write a list: [...]")
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    assert isinstance(node, yaml.MappingNode)
    value = next((child for key, child in node.value if key.value == field), None)
    if value is None:
        after = _new_field(text, node, field, items)
    elif isinstance(value, yaml.SequenceNode) and not value.flow_style:
        after = _insert(text, _end_of(text, value), _block(items, value.start_mark.column))
    else:
        after = _in_brackets(text, value, field, items)
    expected = before | {field: [*(there or []), *items]}
    with contextlib.suppress(BadInput):
        if yaml_lines.parse(after, file)[0] == expected:
            return after
    remedy = f"write {field} as a list of lines that begin with a dash, or save under another name"
    raise BadInput("lines cannot be added to this text and all else left as it is", file, field=field, remedy=remedy)


def _new_field(text: str, node: yaml.MappingNode, field: str, items: Sequence[Any]) -> str:
    if node.flow_style:  # a whole scene in braces
        end = node.end_mark.index - 1
        comma = "" if text[:end].rstrip().endswith((",", "{")) else ","
        return text[:end] + f"{comma} {field}: {_flow(list(items))}" + text[end:]
    return _insert(text, _end_of(text, node), f"{field}:\n" + _block(items, 2))


def _in_brackets(text: str, value: yaml.Node, field: str, items: Sequence[Any]) -> str:
    """Into [...], or in the place of an empty value."""
    if not isinstance(value, yaml.SequenceNode):
        return text[: value.start_mark.index] + f" {_flow(list(items))}" + text[value.end_mark.index :]
    end = value.end_mark.index - 1
    inside = text[value.start_mark.index + 1 : end].rstrip()
    comma = "" if not value.value or inside.endswith(",") else ", "
    return text[:end] + comma + _flow(list(items))[1:-1] + text[end:]


def _end_of(text: str, node: yaml.Node) -> int:
    """Where the last line of what a node holds ends: what follows it, comments too, is not its own."""
    last: yaml.Node = node
    while isinstance(last, yaml.CollectionNode) and not last.flow_style and last.value:
        child = last.value[-1]
        last = child[1] if isinstance(child, tuple) else child
    end = text.find("\n", _last_mark(text, last))
    return len(text) if end < 0 else end + 1


def _last_mark(text: str, node: yaml.Node) -> int:
    """The last character of a node that is no blank; a block of text ends at the line after its own."""
    end = node.end_mark.index
    if isinstance(node, yaml.ScalarNode) and node.style in ("|", ">"):
        end = len(text[:end].rstrip())
    return max(end, node.start_mark.index)


def _insert(text: str, at: int, lines: str) -> str:
    head = text[:at]
    return head + ("" if head.endswith("\n") or not head else "\n") + lines + text[at:]


def _block(items: Sequence[Any], indent: int) -> str:
    return "".join(f"{' ' * indent}- {_flow(item)}\n" for item in items)


def _flow(value: Any) -> str:
    """Plain values as YAML on one line, as scenes are written: text in quotes only where it could be something else."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(child)}" for key, child in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, str) and re.fullmatch(r"[\w][\w .-]*", value) and yaml_lines.parse_value(value) == value:
        return value
    return json.dumps(value)


def write_whole(path: Path, text: str) -> None:
    """Replace a file by one that is whole, or leave it as it is. Raises BadInput.

    The text is written beside it, flushed to the disk, and renamed; rights stay, and a link is followed.
    """
    path = path.resolve()
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(name, path.stat().st_mode & 0o777 if path.exists() else 0o644)
            os.replace(name, path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        remedy = "choose a folder that can be written, or export the lines"
        raise BadInput(f"cannot be written: {error.strerror}", str(path), remedy=remedy) from None
