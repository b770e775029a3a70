"""A scene with comments as a template: each field with its description, and the omitted fields with their defaults."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from nuno.scene.scene_file import Loaded
from nuno.scene.validation_errors import models_in
from nuno.scene.yaml_lines import Path, dotted
from nuno_schemas.scene import Scene

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
        yield from _with_comment(f"{indent}{key}: {_flow(value)}", text)


def _omitted(key: str, field: FieldInfo, indent: str) -> Iterator[str]:
    default = field.get_default(call_default_factory=True)
    value = "" if default is None else f" {_flow(_plain(default))}"
    yield from _with_comment(f"{indent}# {key}:{value}", field.description or "")


def _plain(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_defaults=True)
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value


def _flow(value: Any) -> str:
    return yaml.safe_dump([value], default_flow_style=True, sort_keys=False, width=math.inf).strip()[1:-1]


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
