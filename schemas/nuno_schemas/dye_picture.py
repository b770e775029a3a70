"""Pictures of dyed cloth: the data that they show, and the plugins that draw them."""

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
    """Photograph of a cloth, with a whole number of pixels k across each cell.

    light  (k ny, k nx, 3) uint8  sRGB
    warp   (k ny, k nx) bool      whether a pixel shows the warp (true) or the weft
    """

    light: NDArray[np.uint8]
    warp: Bool


@dataclass(frozen=True)
class Layers:
    """The visible properties of a cloth's cells, layer 0 the weft and layer 1 the warp.

    fibre  (2, ny, nx) bool    fibre (true) or gap
    up     (2, ny, nx) bool    whether the yarn is above the other layer's yarn
    v_max                      most dye that a cell holds; the fields below are for pictures only
    yarns  (ny,) and (nx,)     yarn of each row of weft, and of each column of warp; None if yarns are separated by
                               gaps alone
    photograph                 photograph of the cloth, or None
    ground (ny, 3), (nx, 3)    colour of the undyed yarns by row of weft and by column of warp, sRGB in [0, 1]; None
                               if unknown
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
    """Cells shown in a picture: rows top to bottom, columns left to right, bottom and right excluded."""

    top: int
    bottom: int
    left: int
    right: int


def amount_seen(phi: Float, fixed: Float, view: DyeView = "all") -> Float:
    """Return the amount shown in a view: all dye, fixed dye, or mobile dye."""
    return {"all": phi + fixed, "fixed": fixed, "mobile": phi}[view]


class DyePicturePlugin(Plugin, Protocol):
    """Draws dyed cloth."""

    def prepare(
        self, config: Any, files: Files, layers: Layers, dyes: Sequence[DyeColour], window: Window, scale: int
    ) -> Any:
        """Return data shared by all pictures of the window at `scale` pixels per cell. Raises BadInput."""
        ...

    def draw(self, prepared: Any, amounts: Float) -> Picture:
        """Return a picture, shape (scale (bottom - top), scale (right - left), 3), of the whole cloth's amounts
        (dyes, 2, ny, nx).
        """
        ...
