"""The dyed cloth of scenes as it begins, laid flat: what the page paints on."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno.dye.run import build_cloth
from nuno.dye.supply import Supplies
from nuno.exports.paint import as_png
from nuno.pages.guard import Refused
from nuno.pages.server import NOT_FOUND, whole
from nuno.pages.worker import Workshop
from nuno.scene.scene_file import Loaded
from nuno.studio import scenes
from nuno.studio.cloth import Start
from nuno_schemas.dye import Cells, DyeState, Supply
from nuno_schemas.dye_picture import Picture, Window, amount_seen
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

SIDE, MOST_SCALE = 1000, 8
"""Pixels of a picture's longer side, about, and of a cell at most."""
MOST = 4
"""Pictures that are kept for pages: each shows the newest that it has asked for."""
PASTE = np.array([201.0, 150.0, 62.0])
"""sRGB of what keeps dye out, where it takes all of a cell's room."""
SHOWN = 0.8
"""How much of what lies below paste it hides."""


class Dyed:
    """Pictures of scenes' cloth, drawn when a page asks for them, without a run."""

    def __init__(self, workshop: Workshop) -> None:
        self._numbers = itertools.count(1)
        self._kept: dict[int, bytes] = {}
        self._workshop = workshop

    def see(self, page: str, *text: Any) -> dict[str, Any]:
        """Build a scene's cloth: the number of its picture, its size [m], its cells, and the dyes. Raises BadInput.

        text: what `scenes.load` makes the scene of.
        """
        picture, facts = self._workshop.make(page, _draw, *text)
        number = next(self._numbers)
        self._kept[number] = picture
        for old in sorted(self._kept)[:-MOST]:
            self._kept.pop(old, None)
        return {"number": number} | facts

    def tell(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """One of the pictures. Raises Refused."""
        found = self._kept.get(whole(query, "number"))
        if found is None:
            raise Refused(NOT_FOUND, "this picture is no longer kept")
        return "image/png", found


class Flat:
    """Draws cloth one after the other, of which the next is often the same with another stroke."""

    def __init__(self) -> None:
        self._painter: _Painter | None = None

    def draw(self, loaded: Loaded) -> tuple[bytes, dict[str, Any]]:
        """PNG, and what else the page is told. Raises BadInput."""
        cells, phi, fixed = at_start(loaded)
        _, ny, nx = cells.fibre.shape
        dyes = [{"name": one.name, "colour": one.colour.dark} for one in loaded.dyed.said.dyes]
        facts = {"cell": cells.size, "cells": [nx, ny], "dyes": dyes, "object": loaded.dyed.said.object}
        return as_png(self._draw(loaded, cells, phi, fixed)), facts

    def _draw(self, loaded: Loaded, cells: Cells, phi: Float, fixed: Float) -> Picture:
        """All of the cloth, with what keeps dye out over it."""
        _, ny, nx = cells.fibre.shape
        scale = min(MOST_SCALE, max(1, round(SIDE / max(ny, nx))))
        colours = tuple(one.colour for one in loaded.dyed.said.dyes)
        plugin, config = loaded.dyed.picture.plugin, loaded.dyed.picture.config
        painter, of = self._painter, (plugin.name, config, colours)
        if painter is None or not painter.draws(of, cells):
            prepared = plugin.prepare(config, loaded.files, cells, colours, Window(0, ny, 0, nx), scale)
            painter = self._painter = _Painter(of, cells, prepared)
        below: Picture = plugin.draw(painter.prepared, amount_seen(phi, fixed))
        over = SHOWN * cells.resist.mean(axis=0).repeat(scale, 0).repeat(scale, 1)[:, :, None]
        picture: Picture = np.rint((1.0 - over) * below + over * PASTE).astype(np.uint8)
        return picture


_FLAT = Flat()
"""Of a workshop's process."""


def _draw(*text: Any) -> tuple[bytes, dict[str, Any]]:
    return _FLAT.draw(scenes.load(*text))


def cloth_of(loaded: Loaded) -> tuple[Cells, DyeState, tuple[Supply, ...]]:
    """Cells, what they hold, and what gives dye to them. Raises BadInput for a scene without dye."""
    if loaded.scene.dye is None:
        raise BadInput(
            "only cloth to dye is painted", field="dye", remedy="begin from dye/drops, or add dye to the scene"
        )
    return build_cloth(loaded)


def worn(start: Start) -> list[list[float] | None]:
    """Of each triangle of a start, x and y [m] of its three corners on the flat cloth; None of cloth that is not dyed.

    Raises BadInput for a scene whose dyed cloth is no object.
    """
    cells, _, _ = cloth_of(start.loaded)
    piece = next((one for one in start.sight.pieces if one.name == start.loaded.dyed.said.object), None)
    fabric = start.fabric
    laid = fabric.laid_out
    if piece is None or laid is None:
        raise BadInput("no object of this scene is dyed", field="dye.object", remedy="paint on the flat cloth")
    _, ny, nx = cells.fibre.shape
    # Cells cover the texture: u to the right and v up, places to the right and down.
    places = (laid.points[laid.faces] * [1.0, -1.0] + [0.0, 1.0]) * [nx * cells.size, ny * cells.size]
    dyed = (fabric.faces[:, 0] >= piece.start) & (fabric.faces[:, 0] < piece.stop)
    return [row if own else None for row, own in zip(places.reshape(-1, 6).tolist(), dyed.tolist(), strict=True)]


def at_start(loaded: Loaded) -> tuple[Cells, Float, Float]:
    """Cells, and the mobile and fixed amounts (dyes, 2, ny, nx) that a run begins with. Raises BadInput."""
    cells, state, given = cloth_of(loaded)
    dt = loaded.dyed.said.speed / loaded.scene.frame_rate  # a frame: what begins later is not there yet
    Supplies(given, cells.mobile_room, dt, len(state.phi)).begin(state.phi, 0)
    return cells, state.phi, state.fixed


class _Painter(NamedTuple):
    """What pictures of one cloth have in common, which takes most of their time: a stroke changes none of it."""

    of: tuple[Any, ...]
    cells: Cells
    prepared: Any

    def draws(self, of: tuple[Any, ...], cells: Cells) -> bool:
        before, now = _looks(self.cells), _looks(cells)
        alike = len(before) == len(now) and all(map(np.array_equal, before, now))
        return self.of == of and self.cells.v_max == cells.v_max and alike


def _looks(cells: Cells) -> list[NDArray[Any]]:
    """What of a cloth without dye is seen."""
    photograph = (cells.photograph.light, cells.photograph.warp) if cells.photograph is not None else ()
    return [cells.fibre, cells.up, *(cells.yarns or ()), *(cells.ground or ()), *photograph]
