"""Drawn lines as items for a run, and in a scene's text."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nuno.plugin_contract import registry
from nuno.scene import yaml_lines
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno.studio.draw.append import append_items
from nuno.studio.live_view.snapshot import Sight
from nuno.studio.live_view.sources import see_objects
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric

LIST, OPERATION = "operations", "wrinkle"
Lines = Mapping[str, list[dict[str, Any]]]
"""Lines in the form of a scene, by object."""


class Settings(BaseModel):
    """Settings of the page for all lines."""

    model_config = ConfigDict(extra="forbid", strict=True)
    passes: int = Field(default=8, ge=0, le=1000)
    hierarchical: bool = False
    keep: bool = False


def as_operations(lines: Lines, settings: object) -> list[dict[str, Any]]:
    """Return an operation for each object. Raises BadInput."""
    try:
        chosen = Settings.model_validate(settings or {})
    except ValidationError:
        raise BadInput("these are no settings of lines", field="settings", remedy="load the page again") from None
    smoothing: dict[str, Any] = {"passes": chosen.passes} | ({"hierarchical": True} if chosen.hierarchical else {})
    more: dict[str, Any] = {"smoothing": smoothing} | ({"keep": True} if chosen.keep else {})
    return [{"plugin": OPERATION, "object": name, **more, "lines": rows} for name, rows in lines.items()]


def as_items(lines: Lines, settings: object) -> list[str]:
    """Return the items to add to a run, one for each object. Raises BadInput."""
    items = []
    for operation in as_operations(lines, settings):
        plugin = operation.pop("plugin")
        items.append(f"{plugin}: {json.dumps(operation)}")
    return items


class Trial:
    """The cloth of a scene's objects at the start, for checks of lines before they are kept."""

    def __init__(self, loaded: Loaded, fabrics: Sequence[Fabric]) -> None:
        names = [spec.name for spec in loaded.scene.objects]
        self._fabrics = dict(zip(names, fabrics, strict=True))
        self._plugin = registry.load("nuno.operations", OPERATION)

    def apply(self, operation: dict[str, Any]) -> None:
        """Apply an operation of a scene and discard the result. Raises BadInput."""
        fabric = self._fabrics[operation["object"]]
        others = ("plugin", "object")
        config = self._plugin.Config.model_validate({k: v for k, v in operation.items() if k not in others})
        self._plugin.apply(config, fabric, cloth.start_state(fabric), None)


def with_lines(
    text: str, file: str, base: Sight, lines: Mapping[bool, Lines], settings: object, load: Callable[[str], Loaded]
) -> str:
    """Return a scene's text with lines added to it, and everything else unchanged. Raises BadInput.

    Lines that are the first operation are given by triangles of `base` (`lines[True]`); after other operations, by
    positions on the cloth at the start (`lines[False]`).
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
