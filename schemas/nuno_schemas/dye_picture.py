"""What pictures of dyed cloth are drawn from, and plugins that draw them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.layout import Bounds
from nuno_schemas.look import DyeColour, DyeView
from nuno_schemas.plugin import Files, Plugin

Picture = NDArray[np.uint8]
"""(h, w, 3) sRGB."""


@dataclass(frozen=True)
class Photograph:
    """What a cloth looks like: a whole number of pixels across each cell.

    light  (k ny, k nx, 3) uint8  sRGB
    warp   (k ny, k nx) bool      whether a pixel shows the warp, or the weft
    """

    light: NDArray[np.uint8]
    warp: Bool


@dataclass(frozen=True)
class Layers:
    """What shows of a cloth's cells, layer 0 the weft and layer 1 the warp.

    fibre  (2, ny, nx) bool    fibre or gap
    up     (2, ny, nx) bool    whether the yarn is above the other layer's there
    v_max                      most that a cell holds; what follows is for pictures
    yarns  (ny,) and (nx,)     the yarn in whose pitch a row of weft, or a column of warp, lies; None where only
                               gaps tell yarns apart
    photograph                 of the cloth, where there is one
    ground (ny, 3), (nx, 3)    colour of the undyed yarns by row of weft and by column of warp, sRGB in [0, 1]; None
                               where nothing says
    """

    fibre: Annotated[Bool, 2, "ny", "nx"]
    up: Annotated[Bool, 2, "ny", "nx"]
    v_max: Annotated[float, Bounds(above=0.0)] = field(default=1.0, kw_only=True)
    yarns: tuple[Annotated[Int, "ny", Bounds(0)], Annotated[Int, "nx", Bounds(0)]] | None = field(
        default=None, kw_only=True
    )
    photograph: Photograph | None = field(default=None, kw_only=True)
    ground: tuple[Float, Float] | None = field(default=None, kw_only=True)


class Window(NamedTuple):
    """Cells that a picture shows: rows top to bottom, columns left to right, the last ones not included."""

    top: int
    bottom: int
    left: int
    right: int


def amount_seen(phi: Float, fixed: Float, view: DyeView = "all") -> Float:
    """What a view shows of mobile and fixed amounts: all of it, what fibre has taken, or what it has not."""
    return {"all": phi + fixed, "fixed": fixed, "mobile": phi}[view]


class DyePicturePlugin(Plugin, Protocol):
    """Draws dyed cloth."""

    def prepare(
        self, config: Any, files: Files, layers: Layers, dyes: Sequence[DyeColour], window: Window, scale: int
    ) -> Any:
        """What pictures of the window at `scale` pixels a cell have in common. Raises BadInput."""
        ...

    def draw(self, prepared: Any, amounts: Float) -> Picture:
        """(scale (bottom - top), scale (right - left), 3) picture of amounts (dyes, 2, ny, nx) of the whole cloth."""
        ...
