"""Lines kept: as items for a run that goes on, and in a scene's file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nuno import registry
from nuno.cloth import build
from nuno.draw.append import MARK, append_items, read_text, write_whole
from nuno.draw.shown import see_scene
from nuno.scene import scene_file, shipped, yaml_lines
from nuno.scene.scene_file import Loaded
from nuno.seen.sight import Sight
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


def target(loaded: Loaded) -> Path:
    """The file that lines are saved to: the user's own, or one of a new name here in the place of a shipped one."""
    own = loaded.path.resolve()
    if own not in {path.resolve() for path in shipped.scenes().values()}:
        return own
    names = (f"{loaded.path.stem}-drawn{number}.yaml" for number in ("", *(f"-{n}" for n in range(2, 1000))))
    return next(path for name in names if not (path := Path.cwd() / name).exists())


class Trial:
    """The cloth of a scene's objects at the start, on which lines are tried before they are kept."""

    def __init__(self, loaded: Loaded) -> None:
        names = [spec.name for spec in loaded.scene.objects]
        self._fabrics: dict[str, Fabric] = dict(zip(names, build.build_fabrics(loaded), strict=True))
        self._plugin = registry.load("nuno.operations", OPERATION)

    def apply(self, operation: dict[str, Any]) -> None:
        """Try an operation, as a scene has it; nothing is kept. Raises BadInput."""
        fabric = self._fabrics[operation["object"]]
        beside = ("plugin", "object")
        config = self._plugin.Config.model_validate({k: v for k, v in operation.items() if k not in beside})
        self._plugin.apply(config, fabric, build.start_state(fabric), None)


class Keeper:
    """One page's lines in a scene's file: as it was before, with the lines that are there now.

    Saved once more, they take the place of what was saved before, so nothing is in the file twice.
    """

    def __init__(self, loaded: Loaded) -> None:
        self.loaded, self.path = loaded, target(loaded)
        self._before = self._written = ""

    @property
    def saved(self) -> bool:
        """Whether lines of this page are in the file."""
        return bool(self._written)

    def save(self, base: Sight, lines: Mapping[bool, Lines], settings: object) -> dict[str, Any]:
        """Write the file; what the page says of it. Raises BadInput, the file being as it was then.

        Lines are about the triangles of `base`, and given by them (`lines[True]`) where they are the first to change
        the cloth; behind other operations, by places on the cloth as the scene begins (`lines[False]`).
        """
        source = self.path if self._written else self.loaded.path
        text = read_text(source)
        if self._written and text != self._written:
            remedy = "open the page again to go on from what it says now; until then, export the lines"
            raise BadInput("the file was changed after lines were saved to it", str(self.path), remedy=remedy)
        before = (self._before or text).removeprefix(MARK)
        first = not yaml_lines.parse(before, str(source))[0].get(LIST)
        operations = as_operations(lines[first], settings)
        after = append_items(before, LIST, operations, str(source))
        scene = self._check(base, after)
        if first:
            trial = Trial(scene)
            for operation in operations:
                trial.apply(operation)
        whole = (MARK if text.startswith(MARK) else "") + after
        write_whole(self.path, whole)
        self._before, self._written = self._before or text, whole
        return {"file": str(self.path), "text": f"To run it: {self._command()}"}

    def _command(self) -> str:
        loaded = self.loaded
        elsewhere = self.path.parent != loaded.files.folder.resolve()
        roots = f" --root {loaded.files.folder}" if elsewhere and loaded.files.used else ""
        name = self.path.name if self.path.parent == Path.cwd() else str(self.path)
        return f"nuno run {name}{roots}"

    def _check(self, base: Sight, text: str) -> Loaded:
        """A text's scene. Raises BadInput for one that is not good, or of other triangles than were drawn on."""
        name = str(self.loaded.path)
        data, places = yaml_lines.parse(text, name)
        scene = scene_file.load(data, places, name, self.loaded.files)
        if not np.array_equal(see_scene(scene).faces, base.faces):
            problem = "the lines were drawn on other triangles than the file's scene has"
            remedy = "open the scene as it is in the file, without --set; or export the lines"
            raise BadInput(problem, name, remedy=remedy)
        return scene
