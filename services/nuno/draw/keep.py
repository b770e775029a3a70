"""Lines kept: as an item for a run that goes on, and in a scene's file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nuno import scene_file, yaml_lines
from nuno.draw.append import append_items, read_text, write_whole
from nuno.draw.shown import see_scene
from nuno.draw.sight import Sight
from nuno.scene_file import Loaded, shipped
from nuno_schemas.errors import BadInput

OPERATION, LIST = "wrinkle", "operations"
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
    if own not in {path.resolve() for folder in ("", *scene_file.FOLDERS) for path in shipped(folder).values()}:
        return own
    names = (f"{loaded.path.stem}-drawn{number}.yaml" for number in ("", *(f"-{n}" for n in range(2, 1000))))
    return next(path for name in names if not (path := Path.cwd() / name).exists())


def save(loaded: Loaded, base: Sight, lines: Lines, settings: object) -> dict[str, Any]:
    """Add lines to a scene's file, all else in which stays as it is; what the page says of it. Raises BadInput.

    The text is read again here: what was changed in it meanwhile stays, too. Lines are about the triangles of `base`;
    where the file's scene has others by now, or is no good scene with the lines, it is not written.
    """
    operations, path = as_operations(lines, settings), target(loaded)
    text = read_text(loaded.path)
    mark = "\ufeff" if text.startswith("\ufeff") else ""
    after = append_items(text[len(mark) :], LIST, operations, str(loaded.path))
    _check(loaded, base, after)
    write_whole(path, mark + after)
    new = path != loaded.path.resolve()
    roots = f" --root {loaded.files.folder}" if new and loaded.files.used else ""
    return {"file": str(path), "text": f"To run it: nuno run {path.name if new else loaded.path}{roots}"}


def _check(loaded: Loaded, base: Sight, text: str) -> None:
    data, places = yaml_lines.parse(text, str(loaded.path))
    scene = scene_file.load(data, places, str(loaded.path), loaded.files)
    if not np.array_equal(see_scene(scene).faces, base.faces):
        raise BadInput(
            "the lines were drawn on other triangles than the file's scene has",
            str(loaded.path),
            remedy="open the scene as it is in the file, without --set; or export the lines",
        )
