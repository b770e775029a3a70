"""Lines kept: as items for a run that goes on, and in a scene's text."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nuno import registry
from nuno.cloth import build
from nuno.draw.append import append_items
from nuno.live_view.snapshot import Sight
from nuno.live_view.sources import see_objects
from nuno.scene import yaml_lines
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric

LIST, OPERATION = "operations", "wrinkle"
Lines = Mapping[str, list[dict[str, Any]]]
"""Lines as a scene has them, by the object that they are on."""


class Settings(BaseModel):
    """What the page says of all lines."""

    model_config = ConfigDict(extra="forbid", strict=True)
    passes: int = Field(default=8, ge=0, le=1000)
    hierarchical: bool = False
    keep: bool = False


def as_operations(lines: Lines, settings: object) -> list[dict[str, Any]]:
    """An operation for each object. Raises BadInput."""
    try:
        chosen = Settings.model_validate(settings or {})
    except ValidationError:
        raise BadInput("these are no settings of lines", field="settings", remedy="load the page again") from None
    smoothing: dict[str, Any] = {"passes": chosen.passes} | ({"hierarchical": True} if chosen.hierarchical else {})
    more: dict[str, Any] = {"smoothing": smoothing} | ({"keep": True} if chosen.keep else {})
    return [{"plugin": OPERATION, "object": name, **more, "lines": own} for name, own in lines.items()]


def as_items(lines: Lines, settings: object) -> list[str]:
    """What a run is asked to add, one for each object. Raises BadInput."""
    found = []
    for operation in as_operations(lines, settings):
        plugin = operation.pop("plugin")
        found.append(f"{plugin}: {json.dumps(operation)}")
    return found


class Trial:
    """The cloth of a scene's objects at the start, on which lines are tried before they are kept."""

    def __init__(self, loaded: Loaded, fabrics: Sequence[Fabric]) -> None:
        names = [spec.name for spec in loaded.scene.objects]
        self._fabrics = dict(zip(names, fabrics, strict=True))
        self._plugin = registry.load("nuno.operations", OPERATION)

    def apply(self, operation: dict[str, Any]) -> None:
        """Try an operation, as a scene has it; nothing is kept. Raises BadInput."""
        fabric = self._fabrics[operation["object"]]
        beside = ("plugin", "object")
        config = self._plugin.Config.model_validate({k: v for k, v in operation.items() if k not in beside})
        self._plugin.apply(config, fabric, build.start_state(fabric), None)


def with_lines(
    text: str, file: str, base: Sight, lines: Mapping[bool, Lines], settings: object, load: Callable[[str], Loaded]
) -> str:
    """A scene's text with lines in it, and all else as it was written. Raises BadInput.

    Lines are about the triangles of `base`, and given by them (`lines[True]`) where they are the first to change
    the cloth; behind other operations, by places on the cloth as the scene begins (`lines[False]`).
    """
    first = not yaml_lines.parse(text, file)[0].get(LIST)
    operations = as_operations(lines[first], settings)
    after = append_items(text, LIST, operations, file)
    loaded = load(after)
    sight, _, fabrics = see_objects(loaded)
    if not np.array_equal(sight.faces, base.faces):
        problem, remedy = "the lines were drawn on other triangles than the text's scene has", "draw them again"
        raise BadInput(problem, file, remedy=remedy)
    if first:
        trial = Trial(loaded, fabrics)
        for operation in operations:
            trial.apply(operation)
    return after
