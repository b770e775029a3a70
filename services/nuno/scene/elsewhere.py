"""Where a field belongs that a scene has in a wrong place, such as the colour of an object inside of its model."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import takewhile
from typing import Any

from pydantic import BaseModel

from nuno import registry
from nuno.scene.json_schema import PLACES
from nuno.scene.validation_errors import NO_FIELD, models_in
from nuno_schemas.errors import BadInput
from nuno_schemas.scene import Scene
from nuno_schemas.written import Path, dotted

DEEPEST = 4
"""Fields within fields that are looked through."""
MOST = 2
"""Places that are named: more than these say nothing."""


@contextmanager
def told_where(data: Any) -> Iterator[None]:
    """What is no field where it stands is answered with where the scene has one of that name, if anywhere."""
    try:
        yield
    except BadInput as error:
        place, _, name = (error.field or "").rpartition(".")
        places = belongs(name, place, data) if error.problem == NO_FIELD else []
        if not places:
            raise
        raise replace(error, remedy=f"it is a field of {' or '.join(places)}: move it there") from None


def belongs(name: str, place: str, data: Any) -> list[str]:
    """The parts of a scene nearest to a place, as errors write it, that have a field of this name; [] where many do."""
    found: dict[str, int] = {}
    here = place.split(".") if place else []
    for path, fields in _parts((Scene,), data if isinstance(data, dict) else {}, ()):
        if name in fields and dotted(path) != place:
            there = dotted(path).split(".") if path else []
            shared = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(here, there, strict=False)))
            found[dotted(path) or "the scene itself"] = len(here) + len(there) - 2 * shared
    nearest = [one for one, far in found.items() if far == min(found.values())]
    return nearest if len(nearest) <= MOST else []


def _parts(models: tuple[type[BaseModel], ...], data: dict[str, Any], path: Path) -> Iterator[tuple[Path, set[str]]]:
    """Each mapping that a scene has, or could have, by its place, and the fields that it may have."""
    fields = {name: (model, field) for model in models for name, field in model.model_fields.items()}
    yield path, set(fields)
    if len(path) >= DEEPEST:
        return
    for name, (model, field) in fields.items():
        value, group = data.get(name), PLACES.get((model.__name__, name))
        inside = models_in(field.annotation)[:1]
        items = list(enumerate(value)) if isinstance(value, list) else [(None, value)]
        for number, item in items:
            there = (*path, name) if number is None else (*path, name, number)
            if group and isinstance(item, dict):
                yield from _parts((*inside, *_config(group, item)), item, there)
            elif inside and not group and isinstance(item, dict | None):
                yield from _parts(tuple(inside), item or {}, there)


def _config(group: str, choice: dict[str, Any]) -> list[type[BaseModel]]:
    """Of the plugin that is named; none where there is no such plugin."""
    try:
        return [registry.load(group, str(choice.get("plugin"))).Config]
    except BadInput:
        return []
