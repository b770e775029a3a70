"""Change of one value in a scene's text, which keeps comments, order and spacing of the rest.

yaml-edit changes the text, and keeps all other bytes; the result is read again, and refused unless it has exactly that
one change. Rejected: ruamel.yaml, whose round trip changes 20 of the 110 scenes and inputs here before any edit (folded
lines, lists over several lines).
"""

from __future__ import annotations

import contextlib
import math
import re
import textwrap
from collections.abc import Iterator, Mapping
from copy import deepcopy
from typing import Any

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from yaml_edit import Document, Node, Sequence, YamlError
from yaml_edit import Mapping as MappingNode

from nuno.scene import yaml_lines
from nuno.scene.scene_file import Loaded
from nuno.scene.validation_errors import models_in
from nuno.scene.yaml_lines import Path, dotted
from nuno_schemas.errors import BadInput
from nuno_schemas.scene import Scene

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


def _collection(node: Node | None) -> MappingNode | Sequence | None:
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


# A scene with comments as a template: each field with its description, and the omitted fields with their defaults.

WIDTH = 110
"""Width of a line; a longer comment is placed above its field."""
APART = 44
"""Column of comments on a field's line, where the field is shorter."""


def comment(loaded: Loaded) -> str:
    """Return the scene as YAML; omitted fields are comments with their defaults."""
    plugins = {chosen.field: type(chosen.config) for chosen in loaded.chosen}
    return "\n".join(_mapping(loaded.data, Scene, (), plugins, "")) + "\n"


def _mapping(
    data: Mapping[str, Any], model: type[BaseModel], path: Path, plugins: Mapping[str, type[BaseModel]], indent: str
) -> Iterator[str]:
    """Yield the lines of a mapping of a model, and of the plugin that it names, if any."""
    fields = dict(model.model_fields)
    if (config := plugins.get(dotted(path))) is not None:
        fields |= {name: field for name, field in config.model_fields.items() if name not in fields}
    for key, value in data.items():
        yield from _field(key, value, fields.get(key), (*path, key), plugins, indent)
    for key, field in fields.items():
        if key not in data and not field.is_required():
            yield from _omitted(key, field, indent)


def _field(
    key: str, value: Any, field: FieldInfo | None, path: Path, plugins: Mapping[str, type[BaseModel]], indent: str
) -> Iterator[str]:
    inside = next(iter(models_in(field.annotation)), None) if field is not None else None
    text = (field.description or "") if field is not None else ""
    items = value if isinstance(value, list) else ()
    if inside is not None and isinstance(value, dict):
        yield from _with_comment(f"{indent}{key}:", text)
        yield from _mapping(value, inside, path, plugins, f"{indent}  ")
    elif inside is not None and items and all(isinstance(item, dict) for item in items):
        yield from _with_comment(f"{indent}{key}:", text)
        for i, item in enumerate(items):
            lines = list(_mapping(item, inside, (*path, i), plugins, f"{indent}    "))
            first = next(n for n, line in enumerate(lines) if not line.lstrip().startswith("#"))
            lines[first] = f"{indent}  - {lines[first].lstrip()}"
            yield from lines
    else:
        yield from _with_comment(f"{indent}{key}: {flow(value)}", text)


def _omitted(key: str, field: FieldInfo, indent: str) -> Iterator[str]:
    default = field.get_default(call_default_factory=True)
    value = "" if default is None else f" {flow(_plain(default))}"
    yield from _with_comment(f"{indent}# {key}:{value}", field.description or "")


def _plain(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_defaults=True)
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value


def _with_comment(line: str, text: str) -> Iterator[str]:
    """Yield a line with its comment, or the comment above it if that is too long."""
    if not text:
        yield line
        return
    whole = f"{line:{APART}} # {text}"
    if len(whole) <= WIDTH:
        yield whole
        return
    indent = line[: len(line) - len(line.lstrip())]
    yield from (f"{indent}# {part}" for part in textwrap.wrap(text, WIDTH - len(indent) - 2, break_on_hyphens=False))
    yield line
