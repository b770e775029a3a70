"""Supplies and resists that are added to a dyeing during its run."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nuno.scene import scene_file, yaml_lines
from nuno.scene.files import SceneFiles
from nuno.scene.scene_file import Loaded
from nuno.scene.validation_errors import UNNUMBERED
from nuno_schemas.dye import Cells
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Float

PLACES = ("supply", "resist")
"""Lists of `dye.cloth` that take another item."""
NAME = "add"
"""Name of an added item's text in errors."""
MARGIN = 4.0 * np.finfo(np.float64).eps
"""Relative rounding error of V_u computed from B."""


def parse(item: str) -> tuple[str, dict[str, Any]]:
    """Split `supply: {kind: drop, ...}` into supply and its fields. Raises BadInput."""
    value = yaml_lines.parse_value(item)
    if not isinstance(value, dict) or len(value) != 1:
        remedy = "for example supply: {kind: drop, place: [5 mm, 5 mm], diameter: 1 mm}"
        raise BadInput("add takes one supply or one resist", NAME, value=item, remedy=remedy)
    place, fields = next(iter(value.items()))
    if place not in PLACES:
        raise BadInput("this cannot be added to a run", NAME, field=place, remedy=nearest(place, PLACES))
    return place, fields


def extend(loaded: Loaded, item: str) -> tuple[Loaded, str]:
    """Return the scene with one more item, and the item's field, `dye.cloth.supply[2]`.

    Errors of the new scene are errors of the item, and have NAME as file. Raises BadInput.
    """
    place, fields = parse(item)
    data = deepcopy(loaded.data)
    items = data["dye"]["cloth"].setdefault(place, [])
    items.append(fields)
    path: yaml_lines.Path = ("dye", "cloth", place, len(items) - 1)
    lines = dict.fromkeys([*loaded.lines, *yaml_lines.places(fields, path)], UNNUMBERED)
    files = RecordedFiles(loaded.files.folder, loaded.files.roots, loaded.files.used)
    return scene_file.load(data, lines, NAME, files), yaml_lines.dotted(path)


class RecordedFiles(SceneFiles):
    """The files that a run has used, which its recording includes."""

    def resolve(self, name: str) -> Path:
        """Return a used file. Raises BadInput for others, with which the recording could not be replayed."""
        if name not in self.used:
            allowed = (
                f"images that the scene names ({', '.join(self.used)})" if self.used else "no image: the scene has none"
            )
            raise BadInput(
                "the file is not in the run's recording, which could not be replayed", value=name,
                remedy=f"an added resist may use {allowed}; or a shape, a paste, a binding",
            )  # fmt: skip
        return self.used[name]


def as_run(changed: Loaded, running: Loaded) -> Loaded:
    """Return the extended scene with name, lines and files of the running one."""
    kept = {name: getattr(running, name) for name in ("file", "lines", "files", "overrides", "path")}
    return replace(changed, **kept)


def resist_around(phi: Float, cells: Cells, before: Float, after: Float) -> Float:
    """Return B (2, ny, nx) after a resist is added to dyed cells: it takes only the free room.

    `before` and `after` are B of the scene without and with it, phi (dyes, 2, ny, nx). With phi <= V_max P (1 - B)

        B <= 1 - phi / (V_max P),

    and B, which may have found less room than `before` allows, is never lowered.
    """
    room, most = cells.v_max * cells.porosity, phi.max(axis=0)
    free = np.ones_like(room)
    np.divide(most, room, out=free, where=most > 0.0)
    np.subtract(1.0, free * (1.0 + MARGIN) + MARGIN, out=free, where=most > 0.0)
    covered: Float = np.where(after > before, np.maximum(cells.resist, np.clip(free, 0.0, after)), cells.resist)
    return covered
