"""The picture of a dyed cloth, from the messages of a run or a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.scene.scene_file import Chosen, Loaded
from nuno.wire.arrays import BadMessage, decode_arrays
from nuno_schemas.dye import Cells
from nuno_schemas.dye_picture import Layers, Photograph, Picture, Window, amount_seen
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.look import Crop, DyeColour
from nuno_schemas.look import DyePicture as Look
from nuno_schemas.plugin import Files

PICTURE_SIDE, MOST_AUTO = 1000, 16
"""What `scale: auto` aims at: pixels of the longer side; and pixels a cell at most."""
MOST_PIXELS = 2**26
ROUNDING = 1e-9
"""Of a cell: a crop's side this near to a cell's middle counts as on it."""


class DyePainter:
    """Draws a cloth and its amounts as they come.

    look, colours  the scene's picture and its dyes' colours
    side           pixels of the longer side that `scale: auto` aims at
    most           pixels of a picture at most, for which a given scale is made smaller; None: as given
    duration       of the scene [s]
    speed          seconds of dyeing in one of the scene
    object         the object whose texture is drawn; None: a cloth by itself
    """

    def __init__(
        self,
        chosen: Chosen,
        look: Look,
        colours: Sequence[DyeColour],
        files: Files,
        side: int = PICTURE_SIDE,
        most: int | None = None,
        duration: float = 0.0,
        object: str | None = None,
        speed: float = 1.0,
    ) -> None:
        self.duration, self.object, self.speed = duration, object, speed
        self.chosen, self.look, self.colours, self.files = chosen, look, tuple(colours), files
        self.side, self.most = side, most
        self.size = self.pixel = 0.0
        """Of a cell, and of a pixel [m]."""
        self.shape = (0, 0)
        """Of the picture [pixels], high and wide."""
        self.time = math.nan
        """Of the dyeing that was drawn last [s]."""
        self.prepared: Any = None
        self._shape: tuple[int, ...] = ()

    @property
    def ready(self) -> bool:
        """Whether the cloth is known."""
        return self.prepared is not None

    def take_cloth(self, payload: bytes) -> None:
        """The cloth, from a message. Raises BadMessage, and BadInput for what cannot be drawn."""
        layers, size = read_layers(payload)
        self.prepare(layers, size)

    def prepare(self, layers: Layers, size: float) -> None:
        """The cloth, of cells of `size` [m]. Raises BadInput for a crop beyond it, or too many pixels."""
        _, ny, nx = layers.fibre.shape
        window, scale = self.frame((ny, nx), size)
        self.size, self.pixel, self._shape = size, size / scale, layers.fibre.shape
        self.shape = scale * (window.bottom - window.top), scale * (window.right - window.left)
        plugin, config = self.chosen.plugin, self.chosen.config
        self.prepared = plugin.prepare(config, self.files, layers, self.colours, window, scale)

    def frame(self, shape: tuple[int, int], size: float) -> tuple[Window, int]:
        """The cells that are shown of (ny, nx) of `size` [m], and pixels a cell. Raises BadInput."""
        window = find_window(self.look.crop, shape, size)
        return window, self._scale(window)

    def draw(self, payload: bytes) -> Picture:
        """A frame's amounts, from a message. Raises BadMessage for such as are not the cloth's."""
        arrays, text = decode_arrays(payload)
        shape = (len(self.colours), *self._shape)
        if not self.ready or not all(name in arrays and arrays[name].shape == shape for name in ("phi", "fixed")):
            found = {name: array.shape for name, array in arrays.items()}
            raise BadMessage(f"amounts of shapes {found} for a cloth of {shape}")
        try:
            self.time = float(text.get("time", text.get("t", math.nan)))
        except (TypeError, ValueError, OverflowError) as error:
            raise BadMessage(f"amounts at no time: {error}") from None
        amounts = amount_seen(arrays["phi"], arrays["fixed"], self.look.view)
        picture: Picture = self.chosen.plugin.draw(self.prepared, amounts)
        return picture

    def _scale(self, window: Window) -> int:
        height, width = window.bottom - window.top, window.right - window.left
        auto = min(MOST_AUTO, max(1, round(self.side / max(height, width))))
        scale = auto if self.look.scale == "auto" else self.look.scale
        if self.most is not None:
            scale = max(1, min(scale, math.isqrt(self.most // (height * width))))
        if scale < 1 or scale * scale * height * width > MOST_PIXELS:
            raise BadInput(
                "a picture cannot have this scale", field="scale", value=scale,
                limit=f"a whole number of pixels a cell, from 1; {MOST_PIXELS} in all, of {width} x {height} cells",
                remedy="a smaller scale, or a crop",
            )  # fmt: skip
        return scale


def painter_of(loaded: Loaded, side: int = PICTURE_SIDE, most: int | None = None) -> DyePainter:
    """The painter of a scene's dye. Raises BadInput where it has none."""
    dye, chosen = loaded.scene.dye, loaded.dye
    if dye is None or chosen is None:
        raise BadInput("the scene has no dye", loaded.file)
    colours, duration = [one.colour for one in dye.dyes], loaded.scene.duration
    return DyePainter(chosen.picture, dye.picture, colours, loaded.files, side, most, duration, dye.object, dye.speed)


def check_picture(loaded: Loaded, cells: Cells) -> None:
    """Raises BadInput, before a run, for a picture that could not be drawn after it."""
    painter, (ny, nx) = painter_of(loaded), cells.fibre.shape[1:]
    layers = Layers(cells.fibre, cells.up, cells.v_max, cells.yarns, cells.photograph, cells.ground)
    try:
        if painter.object is not None and painter.look.crop is not None:
            problem, remedy = "an object shows all of the cloth that dyes it", "leave crop out"
            raise BadInput(problem, field="crop", value=painter.look.crop.model_dump(), remedy=remedy)
        painter.frame((ny, nx), cells.size)
        # The files that a plugin may need are read for one cell as for all.
        plugin, config = painter.chosen.plugin, painter.chosen.config
        plugin.prepare(config, loaded.files, layers, painter.colours, Window(0, 1, 0, 1), 1)
    except BadInput as error:
        raise loaded.at("dye.picture", error) from None


def read_layers(payload: bytes) -> tuple[Layers, float]:
    """A cloth's layers and the side of its cells [m], from its message. Raises BadMessage."""
    arrays, text = decode_arrays(payload)
    try:
        fibre, up = arrays["fibre"].astype(bool), arrays["up"].astype(bool)
        size, v_max = float(text["cell_size"]), float(text["v_max"])
        if fibre.ndim != 3 or len(fibre) != 2 or up.shape != fibre.shape or not fibre.size:
            raise BadMessage(f"cells of shapes {fibre.shape} and {up.shape}")
        if not (0.0 < size < math.inf and 0.0 < v_max < math.inf):
            raise BadMessage(f"cells of {size} m that hold {v_max}")
        yarns = (arrays["weft_yarn"], arrays["warp_yarn"]) if "weft_yarn" in arrays else None
        for yarn, cells in zip(yarns or (), fibre.shape[1:], strict=False):
            if yarn.shape != (cells,) or yarn.dtype.kind != "i" or not (yarn.min() >= 0 and yarn.max() <= cells):
                raise BadMessage(f"yarns of shape {yarn.shape} for {cells} cells side by side")
        return Layers(fibre, up, v_max, yarns, _photograph(arrays, fibre.shape), _ground(arrays, fibre.shape)), size
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadMessage(f"not a cloth: {error}") from None


def _ground(arrays: Mapping[str, NDArray[Any]], shape: tuple[int, ...]) -> tuple[Float, Float] | None:
    """Colours of a cloth's yarns in a message. Raises BadMessage for what are none."""
    if "weft_colour" not in arrays:
        return None
    weft, warp = arrays["weft_colour"], arrays["warp_colour"]
    for colours, cells in zip((weft, warp), shape[1:], strict=True):
        if colours.shape != (cells, 3) or not ((colours >= 0.0) & (colours <= 1.0)).all():
            raise BadMessage(f"colours of shape {colours.shape} for {cells} cells side by side")
    return weft, warp


def _photograph(arrays: Mapping[str, NDArray[Any]], shape: tuple[int, ...]) -> Photograph | None:
    """The cloth's photograph in a message. Raises BadMessage for one that is not a whole number of pixels a cell."""
    if "photograph" not in arrays:
        return None
    light, warp = arrays["photograph"], arrays["photograph_warp"].astype(bool)
    _, ny, nx = shape
    pixels = light.shape[0] // ny
    whole = (pixels * ny, pixels * nx)
    if light.dtype != np.uint8 or not pixels or light.shape != (*whole, 3) or warp.shape != whole:
        raise BadMessage(f"a photograph of shape {light.shape}, warp of {warp.shape}, for cells of {shape}")
    return Photograph(light, warp)


def find_window(crop: Crop | None, shape: tuple[int, int], size: float) -> Window:
    """The cells whose middles lie in a crop, of (ny, nx) cells of `size` [m]. Raises BadInput for none of them."""
    ny, nx = shape
    if crop is None:
        return Window(0, ny, 0, nx)
    first = np.ceil(np.array(crop.low) / size - 0.5 - ROUNDING)
    last = np.floor(np.array(crop.high) / size - 0.5 + ROUNDING) + 1
    (left, top), (right, bottom) = np.maximum(first, 0), np.minimum(last, (nx, ny))
    if not (left < right and top < bottom):
        raise BadInput(
            "the crop holds no cell", field="crop", value=crop.model_dump(),
            limit=f"the cloth is {nx * size:g} m x {ny * size:g} m, in cells of {size:g} m",
            remedy="places count from the upper left corner, x to the right and y down",
        )  # fmt: skip
    return Window(int(top), int(bottom), int(left), int(right))
