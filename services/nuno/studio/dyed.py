"""The dyed cloth of scenes at the start, laid flat for painting in the page."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno.dye.run import build_cloth
from nuno.dye.supply import Supplies
from nuno.exports.cloth import as_png
from nuno.scene.scene_file import Loaded
from nuno.studio import scenes
from nuno.studio.cloth import Start
from nuno.studio.pages.guard import Refused
from nuno.studio.pages.server import NOT_FOUND, whole
from nuno.studio.pages.worker import Workshop
from nuno_schemas.dye import Cells, DyeState, Supply
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.pictures import Picture, Window, amount_seen

SIDE, MOST_SCALE = 1000, 8
"""Approximate pixels of a picture's longer side, and the most pixels per cell."""
MOST = 4
"""Pictures that are kept: each page shows the newest that it requested."""
PASTE = np.array([201.0, 150.0, 62.0])
"""sRGB of paste that takes all of a cell's capacity."""
SHOWN = 0.8
"""Opacity of paste."""


class Dyed:
    """Draws pictures of scenes' cloth when a page asks for them, without a run."""

    def __init__(self, workshop: Workshop) -> None:
        self._numbers = itertools.count(1)
        self._kept: dict[int, bytes] = {}
        self._workshop = workshop

    def see(self, page: str, *text: Any) -> dict[str, Any]:
        """Draw a scene's cloth, and return the picture's number, the size of a cell [m], the number of cells, and the
        dyes. `text` are the arguments of `scenes.load`. Raises BadInput.
        """
        picture, facts = self._workshop.make(page, _draw, *text)
        number = next(self._numbers)
        self._kept[number] = picture
        for old in sorted(self._kept)[:-MOST]:
            self._kept.pop(old, None)
        return {"number": number} | facts

    def tell(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return a picture by its number. Raises Refused."""
        picture = self._kept.get(whole(query, "number"))
        if picture is None:
            raise Refused(NOT_FOUND, "this picture is no longer kept")
        return "image/png", picture


class Flat:
    """Draws cloths one after the other; the next is often the same with one more stroke."""

    def __init__(self) -> None:
        self._painter: _Painter | None = None

    def draw(self, loaded: Loaded) -> tuple[bytes, dict[str, Any]]:
        """Return the picture as PNG, and properties of the cloth for the page. Raises BadInput."""
        cells, phi, fixed = at_start(loaded)
        _, ny, nx = cells.fibre.shape
        dyes = [{"name": one.name, "colour": one.colour.dark} for one in loaded.dyed.said.dyes]
        facts = {"cell": cells.size, "cells": [nx, ny], "dyes": dyes, "object": loaded.dyed.said.object}
        return as_png(self._draw(loaded, cells, phi, fixed)), facts

    def _draw(self, loaded: Loaded, cells: Cells, phi: Float, fixed: Float) -> Picture:
        """Draw all of the cloth, with paste over it."""
        _, ny, nx = cells.fibre.shape
        scale = min(MOST_SCALE, max(1, round(SIDE / max(ny, nx))))
        colours = tuple(one.colour for one in loaded.dyed.said.dyes)
        plugin, config = loaded.dyed.picture.plugin, loaded.dyed.picture.config
        painter, settings = self._painter, (plugin.name, config, colours)
        if painter is None or not painter.draws(settings, cells):
            prepared = plugin.prepare(config, loaded.files, cells, colours, Window(0, ny, 0, nx), scale)
            painter = self._painter = _Painter(settings, cells, prepared)
        cloth: Picture = plugin.draw(painter.prepared, amount_seen(phi, fixed))
        opacity = SHOWN * cells.resist.mean(axis=0).repeat(scale, 0).repeat(scale, 1)[:, :, None]
        picture: Picture = np.rint((1.0 - opacity) * cloth + opacity * PASTE).astype(np.uint8)
        return picture


_FLAT = Flat()
"""The one of a workshop's process."""


def _draw(*text: Any) -> tuple[bytes, dict[str, Any]]:
    return _FLAT.draw(scenes.load(*text))


def cloth_of(loaded: Loaded) -> tuple[Cells, DyeState, tuple[Supply, ...]]:
    """Build the cells, their amounts, and the supplies of dye. Raises BadInput for a scene without dye."""
    if loaded.scene.dye is None:
        raise BadInput(
            "only cloth to dye is painted", field="dye", remedy="begin from dye/drops, or add dye to the scene"
        )
    return build_cloth(loaded)


def worn(start: Start) -> list[list[float] | None]:
    """Return x and y [m] on the flat cloth of the three corners of each triangle of a start; None for undyed cloth.

    Raises BadInput for a scene whose dyed cloth is not an object.
    """
    cells, _, _ = cloth_of(start.loaded)
    piece = next((one for one in start.sight.pieces if one.name == start.loaded.dyed.said.object), None)
    fabric = start.fabric
    laid = fabric.laid_out
    if piece is None or laid is None:
        raise BadInput("no object of this scene is dyed", field="dye.object", remedy="paint on the flat cloth")
    _, ny, nx = cells.fibre.shape
    # Cells cover the texture: u points right and v up, positions on the flat cloth right and down.
    corners = (laid.points[laid.faces] * [1.0, -1.0] + [0.0, 1.0]) * [nx * cells.size, ny * cells.size]
    dyed = (fabric.faces[:, 0] >= piece.start) & (fabric.faces[:, 0] < piece.stop)
    return [row if hit else None for row, hit in zip(corners.reshape(-1, 6).tolist(), dyed.tolist(), strict=True)]


def at_start(loaded: Loaded) -> tuple[Cells, Float, Float]:
    """Return cells, and mobile and fixed amounts (dyes, 2, ny, nx) at the start of a run. Raises BadInput."""
    cells, state, supplies = cloth_of(loaded)
    dt = loaded.dyed.said.speed / loaded.scene.frame_rate  # a frame: later supplies have not begun
    Supplies(supplies, cells.mobile_room, dt, len(state.phi)).begin(state.phi, 0)
    return cells, state.phi, state.fixed


class _Painter(NamedTuple):
    """Prepared data of a cloth's pictures, which take most of their time and do not depend on strokes."""

    settings: tuple[Any, ...]
    cells: Cells
    prepared: Any

    def draws(self, settings: tuple[Any, ...], cells: Cells) -> bool:
        before, now = _visible(self.cells), _visible(cells)
        alike = len(before) == len(now) and all(map(np.array_equal, before, now))
        return self.settings == settings and self.cells.v_max == cells.v_max and alike


def _visible(cells: Cells) -> list[NDArray[Any]]:
    """Return the arrays that determine the look of a cloth without dye."""
    photograph = (cells.photograph.light, cells.photograph.warp) if cells.photograph is not None else ()
    return [cells.fibre, cells.up, *(cells.yarns or ()), *(cells.ground or ()), *photograph]
