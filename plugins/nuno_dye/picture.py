"""Pictures of dyed yarns: each layer's colour from the dye in it, times the shade of its yarns."""

from __future__ import annotations

import colorsys
import functools
from collections.abc import Sequence
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from nuno_dye.cloths.cloth import Layout
from nuno_dye.quantities import Positive, Share
from nuno_kernels import kernel
from nuno_schemas.colour import parse_hex, to_linear, to_srgb
from nuno_schemas.dyeing import DyeColour
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.parts import Colour
from nuno_schemas.pictures import Layers, Picture, Window
from nuno_schemas.plugin import Config, Files

# Shade of woven yarns: the visible layer at a pixel, and its brightness.
#
# A yarn is a cylinder of twisted fibre. A fibre on it is a helix: over an angle theta around the yarn it advances by
# theta / 2 pi of a turn's length along it. Seen from above, at v in [-1, 1] across the yarn,
#
#     theta = arcsin v = arctan(v / sqrt(1 - v^2)),
#
# the arctangent twist profile (Adabala et al. 2003, whom the dye paper follows): lines that are steep in the middle and
# flatten towards the rims. Single fibres are noise across such lines, different for each yarn. Where a yarn dives under
# the next one it turns away from the light, at its rims first.

FIBRES = (5, 13)
"""Fibres of a ply, coarse and fine."""
ROUND = 0.25
"""Distance by which a yarn's rim is nearer to its turn than its middle, in widths: ends of floats look round."""


class TextureConfig(Config):
    """The appearance of yarns."""

    turn: Positive = Field(default=2.0, description="length of a turn of the twist, in widths of the yarn")
    plies: Annotated[int, Field(ge=1, le=64)] = Field(default=3, description="lines around a yarn")
    depth: Share = Field(default=0.25, description="how dark the grooves between plies are")
    fibres: Share = Field(default=0.25, description="how dark the lines between single fibres are")
    relief: Share = Field(default=0.5, description="how dark a yarn's rims are")
    bend: Share = Field(default=0.4, description="how dark a yarn is where it dives under another")
    shadow: Share = Field(default=0.45, description="brightness of yarns that show between those above")
    hole: Share = Field(default=0.08, description="brightness where no yarn is")


def find_layouts(layers: Layers) -> tuple[Layout, Layout]:
    """Return layouts of weft and warp: by their yarns, else by runs of fibre along the first column and row."""
    fibre = layers.fibre[0, :, 0], layers.fibre[1, 0]
    if layers.yarns is not None:
        weft, warp = (Layout(yarn, is_fibre) for yarn, is_fibre in zip(layers.yarns, fibre, strict=True))
        return weft, warp
    layouts = []
    for across in fibre:
        starts = across & ~np.concatenate([[False], across[:-1]])
        layouts.append(Layout(np.maximum(np.cumsum(starts) - 1, 0).astype(np.int32), across))
    return layouts[0], layouts[1]


class Across(NamedTuple):
    """Pixels across a layer's yarns: v in [-1, 1], the yarn's width [cells], and its number."""

    v: Float
    width: Float
    yarn: Int


def look_across(layout: Layout, scale: int) -> Across:
    """Return the places of `scale` pixels a cell in their yarns; v is clamped at a yarn's rim."""
    place, number = np.arange(len(layout.yarn)), int(layout.yarn.max()) + 1
    first, last = np.full(number, len(place)), np.full(number, -1)
    np.minimum.at(first, layout.yarn[layout.fibre], place[layout.fibre])
    np.maximum.at(last, layout.yarn[layout.fibre], place[layout.fibre])
    width = np.maximum(last + 1.0 - first, 1.0)
    yarn = np.repeat(layout.yarn, scale)
    x = (np.arange(len(yarn)) + 0.5) / scale
    return Across(np.clip((2.0 * x - first[yarn] - last[yarn] - 1.0) / width[yarn], -1.0, 1.0), width[yarn], yarn)


def find_floats(up: Bool, axis: int) -> tuple[Int, Int]:
    """Return the first cell of each cell's run of equal `up` (ny, nx) along an axis, and the one after its last."""
    n = up.shape[axis]
    turned = up if axis == 0 else up.T
    place = np.arange(n, dtype=np.int32)[:, None]
    change = np.ones((n + 1, turned.shape[1]), np.bool_)
    change[1:-1] = turned[1:] != turned[:-1]
    first = np.maximum.accumulate(np.where(change[:-1], place, 0), axis=0)
    after = np.minimum.accumulate(np.where(change[1:], place + 1, n)[::-1], axis=0)[::-1]
    return (first, after) if axis == 0 else (first.T, after.T)


class Shades:
    """Visible layers and shades of any part of a cloth, at `scale` pixels a cell."""

    def __init__(self, layers: Layers, scale: int, config: TextureConfig) -> None:
        self.layers, self.scale, self.config = layers, scale, config
        down, across = find_layouts(layers)
        self.weft, self.warp = look_across(down, scale), look_across(across, scale)
        self.floats = find_floats(layers.up[0], 1), find_floats(layers.up[1], 0)

    def find(self, window: Window) -> tuple[NDArray[np.uint8], Float]:
        """Return the visible layer, and its shade in [0, 1], for cells of a window: both (scale height, scale width).
        The upper of two yarns is visible; in a gap of its layer the lower one, in shadow; else a hole.
        """
        c, fibre = self.config, self.layers.fibre
        row = np.arange(self.scale * window.top, self.scale * window.bottom)
        column = np.arange(self.scale * window.left, self.scale * window.right)
        at = np.ix_(row // self.scale, column // self.scale)
        upper = self.layers.up[1][at].astype(np.uint8)
        is_fibre = fibre[0][at], fibre[1][at]
        upper_fibre = np.where(upper == 1, is_fibre[1], is_fibre[0])
        lower_fibre = np.where(upper == 1, is_fibre[0], is_fibre[1])
        layer = np.where(upper_fibre | ~lower_fibre, upper, 1 - upper)
        x, y = (column + 0.5)[None] / self.scale, (row + 0.5)[:, None] / self.scale
        v, width = self.weft.v[row, None], self.weft.width[row, None]
        weft = shade_yarn(v, x / width, self._near(0, x, at) / width, c, 2 * self.weft.yarn[row, None])
        v, width = self.warp.v[None, column], self.warp.width[None, column]
        warp = shade_yarn(v, y / width, self._near(1, y, at) / width, c, 2 * self.warp.yarn[None, column] + 1)
        shade = np.where(layer == 1, warp, weft)
        return layer, shade * np.where(upper_fibre, 1.0, np.where(lower_fibre, c.shadow, c.hole))

    def _near(self, layer: int, along: Float, at: tuple[NDArray[np.intp], ...]) -> Float:
        """Return the distance of pixels from the turns of their yarns [cells]."""
        first, after = self.floats[layer]
        return np.asarray(np.minimum(along - first[at], after[at] - along))


def shade_yarn(v: Float, along: Float, near: Float, config: TextureConfig, yarn: Int | int = 0) -> Float:
    """Return the brightness at v across a yarn and `along` it, at the distance `near` from its turn, both in widths of
    the yarn. `yarn` is its number: yarns have different fibres.
    """
    up = np.sqrt(1.0 - v * v)
    turns = along / config.turn - np.arctan2(v, up) / (2.0 * np.pi)
    line = config.plies * turns
    groove = 0.5 - 0.5 * np.cos(2.0 * np.pi * line)
    strands = 1.0 - config.depth * groove
    if config.fibres:
        strands = strands * (1.0 - config.fibres * sum(draw_noise(k * line, yarn) for k in FIBRES) / len(FIBRES))
    dive = np.square(1.0 - np.clip(2.0 * (near - ROUND * v * v), 0.0, 1.0))
    return np.asarray(strands * (1.0 - config.relief * (1.0 - up)) * (1.0 - config.bend * dive))


def draw_noise(x: Float, stream: Int | int) -> Float:
    """Return noise in [0, 1] over x: a random number at every whole x (of each stream), joined by cubics without slope
    there. Its 16 bits are mixed from the two whole numbers (multiplication by odd constants, folded), not from a
    generator's state, so that any part of a picture equals that of the whole.
    """
    low = np.floor(x)
    u = x - low
    first = low.astype(np.int64)
    share = u * u * (3.0 - 2.0 * u)
    return np.asarray((1.0 - share) * _hash(first, stream) + share * _hash(first + 1, stream))


def _hash(number: NDArray[np.int64], stream: Int | int) -> Float:
    mixed: NDArray[np.int64] = (number * 0x9E3779B1 + np.asarray(stream, np.int64) * 0x85EBCA77) & 0xFFFFFFFF
    mixed = ((mixed ^ (mixed >> 15)) * 0x2C1B3C6D) & 0xFFFFFFFF
    mixed = ((mixed ^ (mixed >> 12)) * 0x297A2D39) & 0xFFFFFFFF
    return np.asarray(((mixed ^ (mixed >> 15)) & 0xFFFF) / 65535.0)


# Pictures of dyed yarns: each layer's colour from the dye in it, times the shade of its yarns.
#
# Colour is interpolated between the middles of cells, but only within a yarn of a layer: the adjacent yarn may hold a
# very different amount.

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
    srgb = [bytes.fromhex(text[1:]) for text in (colours.light, colours.mid, colours.dark)]
    knots = np.array([colorsys.rgb_to_hsv(*(channel / 255.0 for channel in rgb)) for rgb in srgb])
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
    base = parse_hex(dyes[0].light) if ground is None else ground
    light = np.broadcast_to(base, (*amounts.shape[1:], 3)).copy()
    for amount, dye in zip(amounts, dyes, strict=True):
        undyed = parse_hex(dye.light)
        # In a channel where undyed cloth is black, dye changes nothing.
        light *= np.divide(colour_of(amount, dye, v_max), undyed, out=np.ones_like(light), where=undyed > 0.0)
    return np.minimum(light, 1.0)


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
