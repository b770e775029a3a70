"""The right place of a misplaced field, such as the colour of an object inside its model."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import takewhile
from typing import Any

from pydantic import BaseModel

from nuno.plugin_contract import registry
from nuno.scene.json_schema import PLACES
from nuno.scene.validation_errors import NO_FIELD, models_in
from nuno_schemas.errors import BadInput
from nuno_schemas.scene import Scene
from nuno_schemas.written import Path, dotted

DEEPEST = 4
"""Most levels of nested fields that are searched."""
MOST = 2
"""Most places that an error names: more would not help."""


@contextmanager
def name_right_place(data: Any) -> Iterator[None]:
    """Add the places that have a field of this name to the error of an unknown field."""
    try:
        yield
    except BadInput as error:
        place, _, name = (error.field or "").rpartition(".")
        places = belongs(name, place, data) if error.problem == NO_FIELD else []
        if not places:
            raise
        raise replace(error, remedy=f"it is a field of {' or '.join(places)}: move it there") from None


def belongs(name: str, place: str, data: Any) -> list[str]:
    """Return the parts of a scene nearest to a place that have a field of this name; [] if there are many."""
    distances: dict[str, int] = {}
    here = place.split(".") if place else []
    for path, fields in _parts((Scene,), data if isinstance(data, dict) else {}, ()):
        if name in fields and dotted(path) != place:
            parts = dotted(path).split(".") if path else []
            shared = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(here, parts, strict=False)))
            distances[dotted(path) or "the scene itself"] = len(here) + len(parts) - 2 * shared
    nearest = [path_text for path_text, distance in distances.items() if distance == min(distances.values())]
    return nearest if len(nearest) <= MOST else []


def _parts(models: tuple[type[BaseModel], ...], data: dict[str, Any], path: Path) -> Iterator[tuple[Path, set[str]]]:
    """Yield the path of each mapping that a scene has, or could have, and its possible fields."""
    fields = {name: (model, field) for model in models for name, field in model.model_fields.items()}
    yield path, set(fields)
    if len(path) >= DEEPEST:
        return
    for name, (model, field) in fields.items():
        value, group = data.get(name), PLACES.get((model.__name__, name))
        models_inside = models_in(field.annotation)[:1]
        items = list(enumerate(value)) if isinstance(value, list) else [(None, value)]
        for number, item in items:
            inner = (*path, name) if number is None else (*path, name, number)
            if group and isinstance(item, dict):
                yield from _parts((*models_inside, *_config(group, item)), item, inner)
            elif models_inside and not group and isinstance(item, dict | None):
                yield from _parts(tuple(models_inside), item or {}, inner)


def _config(group: str, choice: dict[str, Any]) -> list[type[BaseModel]]:
    """Return the configuration class of the named plugin; [] if there is no such plugin."""
    try:
        return [registry.load(group, str(choice.get("plugin"))).Config]
    except BadInput:
        return []
