"""Change of one value in a scene's text, which keeps comments, order and spacing of the rest.

yaml-edit changes the text, and keeps all other bytes; the result is read again, and refused unless it has exactly that
one change. Rejected: ruamel.yaml, whose round trip changes 20 of the 110 scenes and inputs here before any edit (folded
lines, lists over several lines).
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
    """Return the text with a value at a path, whose last part may be new: a field, or one more item of a list.

    `written` is the preferred YAML of the value, used if it is equal. Raises BadInput.
    """
    before, _ = yaml_lines.parse(text, file)
    expected = _set_copy(before, path, value)
    for shown in (written, flow(value)):
        with contextlib.suppress(BadInput, YamlError):
            if shown and yaml_lines.parse(after := _put(text, path, shown), file)[0] == expected:
                return after
    raise BadInput("this cannot be written into the text and all else left as it is", file, None, dotted(path),
                   remedy=REMEDY)  # fmt: skip


def drop(text: str, path: Path, file: str) -> str:
    """Return the text without the value at a path. Raises BadInput."""
    before, _ = yaml_lines.parse(text, file)
    expected = deepcopy(before)
    container: Any = expected
    try:
        for part in path[:-1]:
            container = container[part]
        del container[path[-1]]
    except (KeyError, IndexError, TypeError):
        raise BadInput("this is not in the text", file, None, dotted(path), remedy="load the page again") from None
    with contextlib.suppress(BadInput, YamlError):
        if yaml_lines.parse(after := _drop(text, path, empty="{}" if container == {} else "[]"), file)[0] == expected:
            return after
    raise BadInput("this cannot be taken out of the text and all else left as it is", file, None, dotted(path),
                   remedy=REMEDY)  # fmt: skip


def _set_copy(data: dict[str, Any], path: Path, value: Any) -> dict[str, Any]:
    """Return a copy of the data with a value at a path. Raises BadInput for a path that does not exist."""
    result: dict[str, Any] = deepcopy(data)
    container: Any = result
    for i, part in enumerate(path):
        last = i == len(path) - 1
        inner = value if last else [] if isinstance(path[i + 1], int) else {}
        if isinstance(container, dict) and isinstance(part, str):
            container[part] = inner if last or container.get(part) is None else container[part]
        elif isinstance(container, list) and isinstance(part, int) and 0 <= part <= len(container):
            container[part : part + 1] = [inner if last or part == len(container) else container[part]]
        else:
            raise BadInput("there is no such place in the scene", field=dotted(path), remedy=REMEDY)
        container = container[part]
    return result


def _container(document: Document, path: Path) -> tuple[Any, Path]:
    """Return the innermost container on a path, and the rest of the path: more than one part where the text has nothing
    there, or an alias.
    """
    container: Any = document.as_mapping()
    for k, part in enumerate(path[:-1]):
        inner = _collection(container.get(part))
        if inner is None:
            return container, path[k:]
        container = inner
    return container, path[-1:]


def _collection(node: Node | None) -> Mapping | Sequence | None:
    return None if node is None else node.as_mapping() if node.is_mapping() else node.as_sequence()


def _put(text: str, path: Path, shown: str) -> str:
    document = Document.parse(text)
    container, (part, *rest) = _container(document, path)
    child = _collection(container.get(part))
    if child is not None and not child.is_flow_style():
        document = Document.parse(_without_notes(text, container, part))
        container = _container(document, path)[0]
    if rest == [0] and not container.is_flow_style():  # a new list, in the style of scenes
        rest, shown = [], f"  - {shown}"
    for name in reversed(rest):
        shown = f"[{shown}]" if isinstance(name, int) else f"{{{flow(name)}: {shown}}}"
    value = Document.parse(shown).root()
    if isinstance(container, Sequence) and part == len(container):
        container.append(value)
    else:
        container[part] = value
    return str(document)


def _drop(text: str, path: Path, empty: str) -> str:
    """Return the text without the value at a path; `empty` replaces a container that becomes empty."""
    container, (part, *rest) = _container(Document.parse(text), path)
    if rest:
        return text
    text = _without_notes(text, container, part)
    if len(container) == 1 and len(path) > 1:
        return _put(text, path[:-1], empty)
    document = Document.parse(text)
    del _container(document, path)[0][part]
    return str(document)


def _without_notes(text: str, inside: Any, part: str | int) -> str:
    """Return the text without the comments below a part that are indented deeper: they belong to it."""
    if inside.is_flow_style():
        return text
    raw = text.encode()
    start, end = (inside[part] if isinstance(part, int) else inside.find_entry(part)).byte_range()
    column = start - (raw.rfind(b"\n", 0, start) + 1) + isinstance(part, str)
    end = (raw.find(b"\n", end - 1) + 1) or len(raw)
    return (raw[:end] + re.sub(rb"\A(?: {%d,}#.*(?:\n|\Z))+" % column, b"", raw[end:])).decode()


class _Dumper(yaml.SafeDumper):
    """Writes quoted text with double quotes, as scenes do."""

    def choose_scalar_style(self) -> str:
        return str(super().choose_scalar_style()).replace("'", '"')


def flow(value: Any) -> str:
    """Return plain values as YAML on one line, in the style of scenes: text is quoted only if it is ambiguous."""
    style: dict[str, Any] = {"default_flow_style": True, "sort_keys": False, "allow_unicode": True, "width": math.inf}
    # In a list: a scalar alone ends with a document marker.
    text: str = yaml.dump([value], Dumper=_Dumper, **style)
    return text.strip()[1:-1]
