"""The picture of a dyed cloth, from the messages of a run or a recording."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nuno.bus.encodings import BadMessage, decode_arrays
from nuno.plugin_contract.values import ContractError, check_array
from nuno.scene.scene_file import Loaded
from nuno_schemas.colour import parse_hex, to_srgb
from nuno_schemas.dye import Cells
from nuno_schemas.dyeing import Crop, Dyeing
from nuno_schemas.errors import BadInput
from nuno_schemas.pictures import Layers, Photograph, Picture, Window, amount_seen

PICTURE_SIDE, MOST_AUTO = 1000, 16
"""Target of `scale: auto`: pixels of the longer side, and most pixels a cell."""
MOST_PIXELS = 2**26
SKETCH_SIDE, STEPS = 512, np.linspace(0.0, 1.0, 256)
"""Most pixels of a side of a sketch, and the amounts of dye that it tells apart."""
SRGB = np.rint(255.0 * to_srgb(np.arange(4096) / 4095.0)).astype(np.uint8)
"""sRGB bytes of equal steps of linear light."""
ROUNDING = 1e-9
"""Tolerance in cells of a crop's side at a cell's centre."""


class DyePainter:
    """Draws pictures of a scene's dyed cloth from messages.

    look, colours  the scene's picture and its dyes' colours
    side           target pixels of the longer side for `scale: auto`
    most           most pixels of a picture, which reduces a given scale; None: no reduction
    duration       of the scene [s]
    speed          seconds of dyeing in one of the scene
    object         the object whose texture is drawn; None: flat cloth
    """

    def __init__(self, loaded: Loaded, side: int = PICTURE_SIDE, most: int | None = None) -> None:
        """Raises BadInput for a scene without dye."""
        dye, self.chosen = loaded.dyed.said, loaded.dyed.picture
        self.duration, self.object, self.speed = loaded.scene.duration, dye.object, dye.speed
        self.look, self.files = dye.picture, loaded.files
        self.colours = tuple(one.colour for one in dye.dyes)
        self.side, self.most = side, most
        self.size = self.pixel = 0.0
        """Size of a cell, and of a pixel [m]."""
        self.shape = (0, 0)
        """Height and width of the picture [pixels]."""
        self.time = math.nan
        """Time of the dyeing in the last picture [s]."""
        self.prepared: Any = None
        self._shape: tuple[int, ...] = ()

    @property
    def ready(self) -> bool:
        """Whether the cloth has arrived."""
        return self.prepared is not None

    def take_cloth(self, payload: bytes) -> None:
        """Prepare the cloth of a message. Raises BadMessage, and BadInput for a bad picture."""
        self.prepare(*read_layers(payload))

    def prepare(self, layers: Layers, size: float) -> None:
        """Prepare cloth with cells of `size` [m]. Raises BadInput for a crop outside it, or too many pixels."""
        _, ny, nx = layers.fibre.shape
        window = find_window(self.look.crop, (ny, nx), size)
        scale = self._scale(window)
        self.size, self.pixel, self._shape = size, size / scale, layers.fibre.shape
        self.shape = scale * (window.bottom - window.top), scale * (window.right - window.left)
        plugin, config = self.chosen.plugin, self.chosen.config
        self.prepared = plugin.prepare(config, self.files, layers, self.colours, window, scale)

    def draw(self, payload: bytes) -> Picture:
        """Draw a frame's amounts from a message. Raises BadMessage for amounts of another cloth."""
        arrays, text = decode_arrays(payload)
        shape = (len(self.colours), *self._shape)
        if not self.ready or not all(name in arrays and arrays[name].shape == shape for name in ("phi", "fixed")):
            shapes = {name: array.shape for name, array in arrays.items()}
            raise BadMessage(f"amounts of shapes {shapes} for a cloth of {shape}")
        try:
            self.time = float(text.get("time", text.get("t", math.nan)))
        except (TypeError, ValueError, OverflowError) as error:
            raise BadMessage(f"amounts at no time: {error}") from None
        amounts = amount_seen(arrays["phi"], arrays["fixed"], self.look.view)
        return np.asarray(self.chosen.plugin.draw(self.prepared, amounts))

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


class DyeSketch:
    """Draws plain pictures of a scene's dyed cloth from messages, fast: both layers together, a pixel a cell, at most
    SKETCH_SIDE a side. The light that each dye lets through is interpolated between its colours, and multiplied.
    """

    ready = False
    """Whether the cloth has arrived."""

    def __init__(self, dye: Dyeing) -> None:
        self.object, self._view, self._full = dye.object, dye.picture.view, 1.0
        self._dyes = [one.colour for one in dye.dyes]

    def take_cloth(self, payload: bytes) -> None:
        """Prepare the cloth of a message. Raises BadMessage, and KeyError, TypeError or ValueError for another."""
        self._full, self.ready = float(decode_arrays(payload)[1]["v_max"]), True

    def draw(self, payload: bytes) -> Picture:
        """Draw a frame's amounts from a message. Raises BadMessage, and KeyError or ValueError for other arrays."""
        arrays, _ = decode_arrays(payload)
        seen = amount_seen(arrays["phi"], arrays["fixed"], self._view).mean(axis=1)
        step, light = -(-max(seen.shape[1:]) // SKETCH_SIDE), np.ones(3)
        for amount, dye in zip(np.nan_to_num(seen[:, ::step, ::step]), self._dyes, strict=True):
            ends = np.stack([parse_hex(colour) for colour in (dye.light, dye.mid, dye.dark)])
            table = np.stack([np.interp(STEPS, (0.0, 0.5, 1.0), ends[:, k]) for k in range(3)], axis=1)
            table /= 1.0 if light.ndim == 1 else np.maximum(ends[0], 1e-6)
            light = light * table[np.clip(255.0 * amount / (dye.full * self._full), 0.0, 255.0).astype(np.uint8)]
        return np.asarray(SRGB[np.minimum(4095.0 * light, 4095.0).astype(np.uint16)])


def check_picture(loaded: Loaded, cells: Cells) -> None:
    """Raise BadInput, before a run, for a picture that could not be drawn after it."""
    painter = DyePainter(loaded)
    look = painter.look
    with loaded.errors_at("dye.picture"):
        if painter.object is not None and look.crop is not None:
            problem, remedy = "an object shows all of the cloth that dyes it", "leave crop out"
            raise BadInput(problem, field="crop", value=look.crop.model_dump(), remedy=remedy)
        painter._scale(find_window(look.crop, cells.fibre.shape[1:], cells.size))
        # The files that a plugin may need are the same for one cell as for all.
        plugin, config = painter.chosen.plugin, painter.chosen.config
        plugin.prepare(config, loaded.files, cells, painter.colours, Window(0, 1, 0, 1), 1)


def read_layers(payload: bytes) -> tuple[Layers, float]:
    """Read a cloth's layers and the side of its cells [m] from its message. Raises BadMessage."""
    arrays, text = decode_arrays(payload)
    try:
        fibre, up = arrays["fibre"].astype(bool), arrays["up"].astype(bool)
        check_array("fibre", fibre, np.bool_, (2, None, None))
        check_array("up", up, np.bool_, fibre.shape)
        size, v_max = float(text["cell_size"]), float(text["v_max"])
        if not (fibre.size and 0.0 < size < math.inf and 0.0 < v_max < math.inf):
            raise ContractError(f"{fibre.size} cells of {size} m that hold {v_max}")
        yarns, ground = (
            (arrays[f"weft_{name}"], arrays[f"warp_{name}"]) if f"weft_{name}" in arrays else None
            for name in ("yarn", "colour")
        )
        _, ny, nx = fibre.shape
        for which, side in enumerate((ny, nx)):
            if yarns is not None:
                check_array("yarns", (rows := yarns[which]), np.int32, (side,))
                if rows.min() < 0 or rows.max() > side:
                    raise ContractError(f"yarns go from {rows.min()} to {rows.max()}, of {side} cells side by side")
            if ground is not None:
                check_array("colours", ground[which], ground[which].dtype.type, (side, 3))
                if not ((ground[which] >= 0.0) & (ground[which] <= 1.0)).all():
                    raise ContractError("colours leave 0 to 1")
        photograph = None
        if "photograph" in arrays:
            photograph = Photograph(arrays["photograph"], arrays["photograph_warp"].astype(bool))
            pixels = max(1, len(photograph.light) // ny)  # a whole number of them to a cell
            check_array("photograph", photograph.light, np.uint8, (pixels * ny, pixels * nx, 3))
            check_array("its warp", photograph.warp, np.bool_, (pixels * ny, pixels * nx))
        return Layers(fibre, up, v_max=v_max, yarns=yarns, photograph=photograph, ground=ground), size
    except (KeyError, TypeError, ValueError, ArithmeticError, ContractError) as error:
        raise BadMessage(f"not a cloth: {error}") from None


def find_window(crop: Crop | None, shape: tuple[int, int], size: float) -> Window:
    """Return the cells, of (ny, nx) with side `size` [m], whose centres are in a crop. Raises BadInput without any."""
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
