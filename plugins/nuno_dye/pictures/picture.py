"""Pictures of dyed yarns: each layer's colour from the dye in it, times the shade of its yarns.

Colour is interpolated between the middles of cells, but only within a yarn of a layer: the adjacent yarn may hold a
very different amount.
"""

from __future__ import annotations

import colorsys
import functools
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from nuno_dye.pictures.texture import Shades, TextureConfig, find_layouts
from nuno_kernels import kernel
from nuno_schemas.colour import parse_hex, to_linear, to_srgb
from nuno_schemas.dye_picture import Layers, Picture, Window
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.look import DyeColour
from nuno_schemas.parts import Colour
from nuno_schemas.plugin import Config, Files

# The colour of cloth from its amounts of dye.
#
# One dye's colour is interpolated linearly in HSV between three colours measured on dyed cloth: undyed, half and full
# (dye paper, section 4.3.1). Several dyes mix subtractively: each transmits a share of the light, per channel of linear
# sRGB, that is its colour at its amount over its colour without dye, and shares multiply,
#
#     light = ground  product over dyes of  colour_k(a_k) / colour_k(0),
#
# which is Beer and Lambert's law for three bands. A single dye on its own ground keeps its measured colours exactly.
# The cloth's texture multiplies the result, in linear light too.


def colour_of(amount: Float, colours: DyeColour, v_max: float = 1.0) -> Float:
    """Return the linear light (..., 3) of amounts (...), interpolated in HSV, the short way around the circle of hues.
    A grey has no hue and gets its neighbour's, so that colour fades without passing through others.
    """
    knots = np.array([_to_hsv(text) for text in (colours.light, colours.mid, colours.dark)])
    grey = knots[:, 1] == 0.0
    if grey[1]:
        knots[1, 0] = knots[2, 0] if grey[0] else knots[0, 0]
    knots[0, 0] = knots[1, 0] if grey[0] else knots[0, 0]
    knots[2, 0] = knots[1, 0] if grey[2] else knots[2, 0]
    for near, far in ((1, 0), (1, 2)):
        knots[far, 0] -= np.round(knots[far, 0] - knots[near, 0])
    share = np.clip(np.asarray(amount) / (colours.full * v_max), 0.0, 1.0)
    h, s, v = (np.interp(share, (0.0, 0.5, 1.0), knots[:, k]) for k in range(3))
    return to_linear(_from_hsv(h, s, v))


def mix(amounts: Float, dyes: Sequence[DyeColour], v_max: float = 1.0, ground: Float | None = None) -> Float:
    """Return the linear light (2, ny, nx, 3) of cells with amounts (dyes, 2, ny, nx).

    `ground` is the undyed cloth's linear light, (3,) or for every cell; the first dye's `light` unless given.
    """
    if len(amounts) != len(dyes):
        raise BadInput("one colour a dye", field="colours", value=len(dyes), limit=f"{len(amounts)} dyes")
    base = to_linear(_to_rgb(dyes[0].light)) if ground is None else ground
    light = np.broadcast_to(base, (*amounts.shape[1:], 3)).copy()
    for amount, dye in zip(amounts, dyes, strict=True):
        undyed = to_linear(_to_rgb(dye.light))
        # In a channel where undyed cloth is black, dye changes nothing.
        light *= np.divide(colour_of(amount, dye, v_max), undyed, out=np.ones_like(light), where=undyed > 0.0)
    return np.minimum(light, 1.0)


def _to_rgb(text: str) -> Float:
    return np.frombuffer(bytes.fromhex(text[1:]), np.uint8) / 255.0


def _to_hsv(text: str) -> tuple[float, float, float]:
    r, g, b = (float(channel) for channel in _to_rgb(text))
    return colorsys.rgb_to_hsv(r, g, b)


def _from_hsv(h: Float, s: Float, v: Float) -> Float:
    """Return sRGB (..., 3): a channel is v less v s times the hue's distance from its third of the circle."""
    place = (np.array([5.0, 3.0, 1.0]) + 6.0 * h[..., None]) % 6.0
    distance = np.clip(np.minimum(place, 4.0 - place), 0.0, 1.0)
    return np.asarray(v[..., None] * (1.0 - s[..., None] * distance))


BLOCK = 2**20
"""Approximate number of pixels whose shade is computed at once."""
SAMPLES = 4
"""The fewest points across a cell over which shade is averaged: twist is finer than a cell."""


PLAIN = TextureConfig(depth=0.0, fibres=0.0, relief=0.0, bend=0.0, shadow=1.0, hole=1.0)


class YarnsPictureConfig(Config):
    """Yarns drawn as twisted cylinders."""

    ground: Colour | None = Field(
        default=None,
        description="colour of the undyed cloth, #rrggbb or a CSS name; left out: of each yarn, where a WIF file says, "
        "or the first dye's light",
    )
    texture: TextureConfig | None = Field(
        default=TextureConfig(), description="how yarns look; null: colours alone, as where a cloth is seen from afar"
    )


class Canvas(NamedTuple):
    """The content of a picture's pixels, for `paint`.

    layer          (h, w) uint8            the layer that is visible at a pixel
    shade          (h, w, 1 or 3) float32  its brightness, overall or by channel
    fibre          (2, ny, nx) bool        fibre or gap
    rows, columns  (ny,), (nx,) int32      yarns of the rows of weft and of the columns of warp
    top, left                              the first visible row and column of cells
    scale                                  pixels a cell
    """

    layer: NDArray[np.uint8]
    shade: NDArray[np.float32]
    fibre: Bool
    rows: Int
    columns: Int
    top: int
    left: int
    scale: int


class Drawing(NamedTuple):
    """The common data of pictures of one window; `window` is a cell wider than the picture."""

    layers: Layers
    dyes: tuple[DyeColour, ...]
    ground: Float | None
    window: Window
    canvas: Canvas


class YarnsPicture:
    """Draws woven yarns."""

    name: ClassVar[str] = "yarns"
    Config: ClassVar[type[BaseModel]] = YarnsPictureConfig

    def prepare(
        self,
        config: YarnsPictureConfig,
        files: Files,
        layers: Layers,
        dyes: Sequence[DyeColour],
        window: Window,
        scale: int,
    ) -> Drawing:
        layer, shade = shade_window(layers, window, scale, config.texture or PLAIN)
        ground = None if config.ground is None else parse_hex(config.ground)
        yarns = find_layouts(layers)
        return begin_drawing(
            layers, dyes, ground, window, scale, layer, shade[..., None], (yarns[0].yarn, yarns[1].yarn)
        )

    def draw(self, prepared: Drawing, amounts: Float) -> Picture:
        return draw(prepared, amounts)


def shade_window(
    layers: Layers, window: Window, scale: int, texture: TextureConfig
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return layer and shade (h, w) of a window's pixels, averaged over at least SAMPLES points across a cell."""
    finer = -(-SAMPLES // scale)
    textures = Shades(layers, scale * finer, texture)
    height, width = scale * (window.bottom - window.top), scale * (window.right - window.left)
    layer, shade = np.empty((height, width), np.uint8), np.empty((height, width), np.float32)
    rows = max(1, BLOCK // (scale * finer * finer * width))
    for low in range(window.top, window.bottom, rows):
        high = min(window.bottom, low + rows)
        visible, bright = textures.find(Window(low, high, window.left, window.right))
        part = slice(scale * (low - window.top), scale * (high - window.top))
        layer[part] = visible[::finer, ::finer]
        shade[part] = bright.reshape(-1, finer, width, finer).mean(axis=(1, 3))
    return layer, shade


def begin_drawing(
    layers: Layers, dyes: Sequence[DyeColour], ground: Float | None, window: Window, scale: int,
    layer: NDArray[np.uint8], shade: NDArray[np.float32], yarns: tuple[Int, Int],
) -> Drawing:  # fmt: skip
    """Return the common data of pictures, with another cell on each side of the window if the cloth has one."""
    _, ny, nx = layers.fibre.shape
    wide = Window(
        max(window.top - 1, 0), min(window.bottom + 1, ny), max(window.left - 1, 0), min(window.right + 1, nx)
    )
    rows, columns = yarns[0][wide.top : wide.bottom], yarns[1][wide.left : wide.right]
    fibre = np.ascontiguousarray(layers.fibre[:, wide.top : wide.bottom, wide.left : wide.right])
    if ground is None and layers.ground is not None:
        weft, warp = (to_linear(colours) for colours in layers.ground)
        both = weft[wide.top : wide.bottom, None], warp[None, wide.left : wide.right]
        ground = np.stack([np.broadcast_to(colours, (*fibre.shape[1:], 3)) for colours in both])
    indices = np.ascontiguousarray(rows, np.int32), np.ascontiguousarray(columns, np.int32)
    canvas = Canvas(layer, shade, fibre, *indices, window.top - wide.top, window.left - wide.left, scale)
    return Drawing(layers, tuple(dyes), ground, wide, canvas)


def draw(drawing: Drawing, amounts: Float) -> Picture:
    """Return the sRGB picture (h, w, 3) of amounts (dyes, 2, ny, nx) of the whole cloth."""
    top, bottom, left, right = drawing.window
    # NaN, after a run that diverged, is drawn undyed.
    local = np.nan_to_num(np.asarray(amounts[..., top:bottom, left:right], np.float64))
    light = mix(local, drawing.dyes, drawing.layers.v_max, drawing.ground)
    picture = np.empty((*drawing.canvas.layer.shape, 3), np.uint8)
    paint(np.ascontiguousarray(light, np.float32), drawing.canvas, _srgb_bytes(), picture)
    return picture


@functools.cache
def _srgb_bytes() -> NDArray[np.uint8]:
    """Return sRGB bytes (65536,) of equal steps of linear light; even near black a step is a twentieth of a byte."""
    return np.rint(255.0 * to_srgb(np.arange(65536) / 65535.0)).astype(np.uint8)


@kernel
def paint(light: NDArray[np.float32], canvas: Canvas, table: NDArray[np.uint8], out: Picture) -> None:
    """Write pixels of `out` (h, w, 3) from light (2, ny, nx, 3) at the middles of cells, times shade. A pixel is
    interpolated from the four nearest middles of its layer that are in its own yarn (or gap).
    """
    layer, shade, fibre, rows, columns, top, left, scale = canvas
    _, ny, nx, _ = light.shape
    last = shade.shape[2] - 1
    middle = min(1, last)
    for j in range(out.shape[0]):
        y = top + j // scale
        down = (j % scale + 0.5) / scale - 0.5
        next_y = min(max(y + (1 if down > 0.0 else -1), 0), ny - 1)
        for i in range(out.shape[1]):
            x = left + i // scale
            across = (i % scale + 0.5) / scale - 0.5
            next_x = min(max(x + (1 if across > 0.0 else -1), 0), nx - 1)
            shown, is_fibre = layer[j, i], fibre[layer[j, i], y, x]
            weight = red = green = blue = 0.0
            for v in (y, next_y):
                b = 1.0 - abs(down) if v == y else abs(down)
                for u in (x, next_x):
                    joined = rows[v] == rows[y] if shown == 0 else columns[u] == columns[x]
                    if joined and fibre[shown, v, u] == is_fibre:
                        w = b * (1.0 - abs(across) if u == x else abs(across))
                        weight += w
                        red += w * light[shown, v, u, 0]
                        green += w * light[shown, v, u, 1]
                        blue += w * light[shown, v, u, 2]
            full = 65535.0 / weight
            out[j, i, 0] = table[int(full * shade[j, i, 0] * red + 0.5)]
            out[j, i, 1] = table[int(full * shade[j, i, middle] * green + 0.5)]
            out[j, i, 2] = table[int(full * shade[j, i, last] * blue + 0.5)]
