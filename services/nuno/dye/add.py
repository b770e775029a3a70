"""Supplies and resists that are added to a dyeing while it goes on."""

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
"""What errors call the item's text."""
MARGIN = 4.0 * np.finfo(np.float64).eps
"""Relative: rounding of V_u as it is computed from B."""


def parse(item: str) -> tuple[str, dict[str, Any]]:
    """`supply: {kind: drop, ...}` -> supply and its fields. Raises BadInput."""
    value = yaml_lines.parse_value(item)
    if not isinstance(value, dict) or len(value) != 1:
        remedy = "for example supply: {kind: drop, place: [5 mm, 5 mm], diameter: 1 mm}"
        raise BadInput("add takes one supply or one resist", NAME, value=item, remedy=remedy)
    place, fields = next(iter(value.items()))
    if place not in PLACES:
        raise BadInput("this cannot be added to a run", NAME, field=place, remedy=nearest(place, PLACES))
    return place, fields


def extend(loaded: Loaded, item: str) -> tuple[Loaded, str]:
    """The scene with one item more, and the item's field, `dye.cloth.supply[2]`.

    Errors of the scene that comes out call it NAME: they are the item's. Raises BadInput.
    """
    place, fields = parse(item)
    data = deepcopy(loaded.data)
    items = data["dye"]["cloth"].setdefault(place, [])
    items.append(fields)
    where: yaml_lines.Path = ("dye", "cloth", place, len(items) - 1)
    lines = dict.fromkeys([*loaded.lines, *yaml_lines.places(fields, where)], UNNUMBERED)
    files = RecordedFiles(loaded.files.folder, loaded.files.roots, loaded.files.used)
    return scene_file.load(data, lines, NAME, files), yaml_lines.dotted(where)


class RecordedFiles(SceneFiles):
    """The files that a run has used, which its recording carries."""

    def resolve(self, name: str) -> Path:
        """Raises BadInput for any other: what it made could not be replayed."""
        if name not in self.used:
            known = (
                f"images that the scene names ({', '.join(self.used)})" if self.used else "no image: the scene has none"
            )
            raise BadInput(
                "the file is not in the run's recording, which could not be replayed", value=name,
                remedy=f"an added resist may use {known}; or a shape, a paste, a binding",
            )  # fmt: skip
        return self.used[name]


def as_run(changed: Loaded, before: Loaded) -> Loaded:
    """The extended scene under the name of the one that runs."""
    kept = {name: getattr(before, name) for name in ("file", "lines", "files", "overrides", "path")}
    return replace(changed, **kept)


def resist_around(phi: Float, cells: Cells, before: Float, after: Float) -> Float:
    """(2, ny, nx) B where a resist comes over cells that hold dye: it takes only the room that is left.

    `before` and `after` are B of the scene without and with it, phi (dyes, 2, ny, nx). With phi <= V_max P (1 - B)

        B <= 1 - phi / (V_max P),

    and B, which may have found less room than `before` says, is never lowered.
    """
    room, most = cells.v_max * cells.porosity, phi.max(axis=0)
    left = np.ones_like(room)
    np.divide(most, room, out=left, where=most > 0.0)
    np.subtract(1.0, left * (1.0 + MARGIN) + MARGIN, out=left, where=most > 0.0)
    covered: Float = np.where(after > before, np.maximum(cells.resist, np.clip(left, 0.0, after)), cells.resist)
    return covered
