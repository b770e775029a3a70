"""Overrides of a scene's fields: `--set a.b.0.c=value`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import yaml

from nuno.scene import yaml_lines
from nuno.scene.validation_errors import OVERRIDDEN
from nuno.scene.yaml_lines import dotted
from nuno_schemas.errors import BadInput
from nuno_schemas.scene import Scene

PRESETS = ("fabric", "dyes")
"""Fields whose value may be a preset's name, short for {preset: NAME}."""
SETTABLE = ("gravity", "damping", "forces")
"""Fields that `nuno control RUN set` may change while a run goes on."""
DIGITS = 9
"""Most digits of an index into a list."""


def parts_of(key: str) -> list[str]:
    """Split `a.b[0].c` into a, b, 0, c."""
    return key.replace("[", ".").replace("]", "").split(".")


def number_or_name(part: str) -> int | str:
    """Return a part of a key as an index or a field's name. Python may refuse to read longer numbers."""
    return int(part) if part.isdecimal() and len(part) <= DIGITS else part


def item_at(data: Any, path: yaml_lines.Path) -> Any:
    """Return the value at a path, None if there is none; an item of a list has its number or its name."""
    for part in path:
        try:
            data = data[_number(data, str(part)) if isinstance(data, list) else part]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def as_override(key: str, value: object) -> str:
    """Return `key=value` that is read as exactly that value: YAML would read Python's 1e-05 as a text. Raises
    yaml.YAMLError for a value that YAML cannot represent.
    """
    # In a list: a scalar alone ends with a document marker.
    return f"{key}={yaml.safe_dump([value], default_flow_style=True, width=math.inf).strip()[1:-1]}"


def overridden(lines: Mapping[yaml_lines.Path, int], place: yaml_lines.Path) -> dict[yaml_lines.Path, int]:
    """Return the lines of a scene after an override at `place`."""
    kept = {path: n for path, n in lines.items() if path[: len(place)] != place}
    return {place[:i]: OVERRIDDEN for i in range(1, len(place) + 1)} | kept


def apply_override(data: dict[str, Any], item: str) -> yaml_lines.Path:
    """Set `a.b.0.c=value` in place; return its path. Raises BadInput for an impossible path."""
    key, equals, text = item.partition("=")
    parts = parts_of(key)
    if not equals or not all(parts):
        remedy = "for example --set solver.dt=1ms"
        raise BadInput("an override is written key=value", "--set", value=item, remedy=remedy)
    try:
        value = yaml_lines.parse_value(text)
    except BadInput as error:
        raise BadInput(error.problem, "--set", None, key, text, error.limit, error.remedy) from None
    here: Any = data
    place: list[str | int] = []
    for i, part in enumerate(parts):
        number = _number(here, part) if isinstance(here, list) else None
        if number is not None:
            place.append(number)
        elif isinstance(here, dict):
            place.append(part)
        else:
            remedy = f"{dotted(tuple(place))} holds {_describe(here)}" + ("; name what is there" if here else "")
            raise BadInput("no such field", "--set", field=key, value=part, remedy=remedy)
        if i < len(parts) - 1:
            inner = here.setdefault(part, {} if i else _new_part(part)) if isinstance(here, dict) else here[place[-1]]
            if isinstance(inner, str) and next(name for name in reversed(place) if isinstance(name, str)) in PRESETS:
                inner = here[place[-1]] = {"preset": inner}
            here = inner
    here[place[-1]] = value
    return tuple(place)


def _new_part(field: str) -> list[Any] | dict[str, Any]:
    """Return the container for a part of an omitted field: its default, if that is a list."""
    field_info = Scene.model_fields.get(field)
    default = field_info.get_default(call_default_factory=True) if field_info is not None else None
    return list(default) if isinstance(default, (list, tuple)) else {}


def _number(parts: list[Any], part: str) -> int | None:
    """Return the index of a list's item by its number or its unique name; None for neither."""
    if part.isdecimal():
        number = number_or_name(part)
        return number if isinstance(number, int) and number < len(parts) else None
    names = _names(parts)
    return names.index(part) if names.count(part) == 1 else None


def _names(parts: list[Any]) -> list[str | None]:
    """Return the names of a list's items; a force has its plugin's name, and a preset its own."""
    return [_name(one) for one in parts]


def _name(part: Any) -> str | None:
    if not isinstance(part, dict):
        return part if isinstance(part, str) else None
    return part.get("name", part.get("plugin", part.get("preset")))


def _describe(value: Any) -> str:
    if isinstance(value, list):
        names = "".join(f", {name}" for name in _names(value) if name is not None)
        return f"a list of {len(value)}, counted from 0{names}" if value else "an empty list; give all of it"
    return f"the value {value!r:.60}"
