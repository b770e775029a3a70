"""Fields of a scene that the user replaces: `--set a.b.0.c=value`."""

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
"""Fields whose value may be a preset's name, which is short for {preset: NAME}."""
DIGITS = 9
"""Of a place in a list, at most."""


def parts_of(key: str) -> list[str]:
    """`a.b[0].c` -> a, b, 0, c."""
    return key.replace("[", ".").replace("]", "").split(".")


def number_or_name(part: str) -> int | str:
    """A part of a key: which of a list, or the name of a field. Longer numbers Python may refuse to read."""
    return int(part) if part.isdecimal() and len(part) <= DIGITS else part


def item_at(data: Any, path: yaml_lines.Path) -> Any:
    """What stands at a path, None where nothing does; a part of a list goes by its number or its name."""
    for part in path:
        try:
            data = data[_number(data, str(part)) if isinstance(data, list) else part]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def as_override(key: str, value: object) -> str:
    """`key=value` that is read as just that value: of numbers written otherwise, YAML takes 1e-05 for a text. Raises
    yaml.YAMLError for what YAML cannot say.
    """
    # In a list: what stands alone ends in a mark of its own.
    return f"{key}={yaml.safe_dump([value], default_flow_style=True, width=math.inf).strip()[1:-1]}"


def overridden(lines: Mapping[yaml_lines.Path, int], place: yaml_lines.Path) -> dict[yaml_lines.Path, int]:
    """Lines of a scene, one place of which the user has replaced."""
    kept = {path: n for path, n in lines.items() if path[: len(place)] != place}
    return {place[:i]: OVERRIDDEN for i in range(1, len(place) + 1)} | kept


def apply_override(data: dict[str, Any], item: str) -> yaml_lines.Path:
    """Set `a.b.0.c=value` in place; where that is. Raises BadInput for a path that cannot be there."""
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
            remedy = f"{dotted(tuple(place))} holds {_kind(here)}" + ("; name what is there" if here else "")
            raise BadInput("no such field", "--set", field=key, value=part, remedy=remedy)
        if i < len(parts) - 1:
            inner = here.setdefault(part, {} if i else _left_out(part)) if isinstance(here, dict) else here[place[-1]]
            if isinstance(inner, str) and next(name for name in reversed(place) if isinstance(name, str)) in PRESETS:
                inner = here[place[-1]] = {"preset": inner}
            here = inner
    here[place[-1]] = value
    return tuple(place)


def _left_out(field: str) -> list[Any] | dict[str, Any]:
    """What part of a field is put into where the scene leaves the field out: its default, if that is a list."""
    known = Scene.model_fields.get(field)
    default = known.get_default(call_default_factory=True) if known is not None else None
    return list(default) if isinstance(default, (list, tuple)) else {}


def _number(parts: list[Any], part: str) -> int | None:
    """Which of a list's parts is meant, by its number or by a name that only one has; None for neither."""
    if part.isdecimal():
        number = number_or_name(part)
        return number if isinstance(number, int) and number < len(parts) else None
    names = _names(parts)
    return names.index(part) if names.count(part) == 1 else None


def _names(parts: list[Any]) -> list[str | None]:
    """Of a list's parts; a part that has no name, as a force or a preset, goes by its plugin's or by the preset's."""
    return [_name(one) for one in parts]


def _name(part: Any) -> str | None:
    if not isinstance(part, dict):
        return part if isinstance(part, str) else None
    return part.get("name", part.get("plugin", part.get("preset")))


def _kind(value: Any) -> str:
    if isinstance(value, list):
        names = "".join(f", {name}" for name in _names(value) if name is not None)
        return f"a list of {len(value)}, counted from 0{names}" if value else "an empty list; give all of it"
    return f"the value {value!r:.60}"
