"""Changing one value of a scene's text, so that all else in it stays as it was written: comments, order, spacing.

The text is changed by yaml-edit, which keeps what it does not change byte for byte, and the result is read again:
unless it gives what was there with that one change, it is refused. Weighed: ruamel.yaml, whose round trip changes 20
of the 110 scenes and inputs here before anything is edited (folded lines, lists over several lines).
"""

from __future__ import annotations

import contextlib
import math
import re
from copy import deepcopy
from typing import Any

import yaml
from yaml_edit import Document, Mapping, Node, Sequence, YamlError

from nuno.scene import yaml_lines
from nuno.scene.yaml_lines import Path, dotted
from nuno_schemas.errors import BadInput

REMEDY = "change it in the text itself"


def put(text: str, path: Path, value: Any, file: str, written: str | None = None) -> str:
    """The text with a value at a path, whose last part may be new: a field, or one item more of a list.

    `written` is how the value is to be written, where it is YAML for just that. Raises BadInput.
    """
    before, _ = yaml_lines.parse(text, file)
    expected = _with(before, path, value)
    for shown in (written, flow(value)):
        with contextlib.suppress(BadInput, YamlError):
            if shown and yaml_lines.parse(after := _put(text, path, shown), file)[0] == expected:
                return after
    raise BadInput("this cannot be written into the text and all else left as it is", file, None, dotted(path),
                   remedy=REMEDY)  # fmt: skip


def drop(text: str, path: Path, file: str) -> str:
    """The text without what is at a path. Raises BadInput."""
    before, _ = yaml_lines.parse(text, file)
    expected = deepcopy(before)
    inside: Any = expected
    try:
        for part in path[:-1]:
            inside = inside[part]
        del inside[path[-1]]
    except (KeyError, IndexError, TypeError):
        raise BadInput("this is not in the text", file, None, dotted(path), remedy="load the page again") from None
    with contextlib.suppress(BadInput, YamlError):
        if yaml_lines.parse(after := _drop(text, path, empty="{}" if inside == {} else "[]"), file)[0] == expected:
            return after
    raise BadInput("this cannot be taken out of the text and all else left as it is", file, None, dotted(path),
                   remedy=REMEDY)  # fmt: skip


def _with(data: dict[str, Any], path: Path, value: Any) -> dict[str, Any]:
    """A copy of the data with a value at a path. Raises BadInput where that leads nowhere."""
    found: dict[str, Any] = deepcopy(data)
    inside: Any = found
    for i, part in enumerate(path):
        last = i == len(path) - 1
        below = value if last else [] if isinstance(path[i + 1], int) else {}
        if isinstance(inside, dict) and isinstance(part, str):
            inside[part] = below if last or inside.get(part) is None else inside[part]
        elif isinstance(inside, list) and isinstance(part, int) and 0 <= part <= len(inside):
            inside[part : part + 1] = [below if last or part == len(inside) else inside[part]]
        else:
            raise BadInput("there is no such place in the scene", field=dotted(path), remedy=REMEDY)
        inside = inside[part]
    return found


def _holder(document: Document, path: Path) -> tuple[Any, Path]:
    """The innermost mapping or list on the way to a path, and what is left of the path: more than one part where the
    text has nothing there, or an alias.
    """
    inside: Any = document.as_mapping()
    for k, part in enumerate(path[:-1]):
        below = _collection(inside.get(part))
        if below is None:
            return inside, path[k:]
        inside = below
    return inside, path[-1:]


def _collection(node: Node | None) -> Mapping | Sequence | None:
    return None if node is None else node.as_mapping() if node.is_mapping() else node.as_sequence()


def _put(text: str, path: Path, shown: str) -> str:
    document = Document.parse(text)
    inside, (part, *below) = _holder(document, path)
    there = _collection(inside.get(part))
    if there is not None and not there.is_flow_style():
        document = Document.parse(_without_notes(text, inside, part))
        inside = _holder(document, path)[0]
    if below == [0] and not inside.is_flow_style():  # a list that begins, as scenes have theirs
        below, shown = [], f"  - {shown}"
    for name in reversed(below):
        shown = f"[{shown}]" if isinstance(name, int) else f"{{{flow(name)}: {shown}}}"
    value = Document.parse(shown).root()
    if isinstance(inside, Sequence) and part == len(inside):
        inside.append(value)
    else:
        inside[part] = value
    return str(document)


def _drop(text: str, path: Path, empty: str) -> str:
    """empty: how the mapping or list is written that nothing is left in."""
    inside, (part, *below) = _holder(Document.parse(text), path)
    if below:
        return text
    text = _without_notes(text, inside, part)
    if len(inside) == 1 and len(path) > 1:
        return _put(text, path[:-1], empty)
    document = Document.parse(text)
    del _holder(document, path)[0][part]
    return str(document)


def _without_notes(text: str, inside: Any, part: str | int) -> str:
    """A text without the comments below a part of what is inside of it that stand further in: they are about that."""
    if inside.is_flow_style():
        return text
    raw = text.encode()
    start, end = (inside[part] if isinstance(part, int) else inside.find_entry(part)).byte_range()
    column = start - (raw.rfind(b"\n", 0, start) + 1) + isinstance(part, str)
    end = (raw.find(b"\n", end - 1) + 1) or len(raw)
    return (raw[:end] + re.sub(rb"\A(?: {%d,}#.*(?:\n|\Z))+" % column, b"", raw[end:])).decode()


class _Dumper(yaml.SafeDumper):
    """Writes text that needs quotes in those that scenes have."""

    def choose_scalar_style(self) -> str:
        return str(super().choose_scalar_style()).replace("'", '"')


def flow(value: Any) -> str:
    """Plain values as YAML on one line, as scenes are written: text in quotes only where it could be something else."""
    style: dict[str, Any] = {"default_flow_style": True, "sort_keys": False, "allow_unicode": True, "width": math.inf}
    # In a list: what stands alone ends in a mark of its own.
    text: str = yaml.dump([value], Dumper=_Dumper, **style)
    return text.strip()[1:-1]
