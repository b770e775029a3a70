"""Shade of woven yarns: the visible layer at a pixel, and its brightness.

A yarn is a cylinder of twisted fibre. A fibre on it is a helix: over an angle theta around the yarn it advances by
theta / 2 pi of a turn's length along it. Seen from above, at v in [-1, 1] across the yarn,

    theta = arcsin v = arctan(v / sqrt(1 - v^2)),

the arctangent twist profile (Adabala et al. 2003, whom the dye paper follows): lines that are steep in the middle and
flatten towards the rims. Single fibres are noise across such lines, different for each yarn. Where a yarn dives under
the next one it turns away from the light, at its rims first.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nuno_dye.cloths.coarse import Layout
from nuno_dye.quantities import Positive, Share
from nuno_schemas.dye_picture import Layers, Window
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.plugin import Config

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
    shade: Float = strands * (1.0 - config.relief * (1.0 - up)) * (1.0 - config.bend * dive)
    return shade


def draw_noise(x: Float, stream: Int | int) -> Float:
    """Return noise in [0, 1] over x: a random number at every whole x (of each stream), joined by cubics without slope
    there. Its 16 bits are mixed from the two whole numbers (multiplication by odd constants, folded), not from a
    generator's state, so that any part of a picture equals that of the whole.
    """
    low = np.floor(x)
    u = x - low
    first = low.astype(np.int64)
    share = u * u * (3.0 - 2.0 * u)
    noise: Float = (1.0 - share) * _hash(first, stream) + share * _hash(first + 1, stream)
    return noise


def _hash(number: NDArray[np.int64], stream: Int | int) -> Float:
    mixed: NDArray[np.int64] = (number * 0x9E3779B1 + np.asarray(stream, np.int64) * 0x85EBCA77) & 0xFFFFFFFF
    mixed = ((mixed ^ (mixed >> 15)) * 0x2C1B3C6D) & 0xFFFFFFFF
    mixed = ((mixed ^ (mixed >> 12)) * 0x297A2D39) & 0xFFFFFFFF
    value: Float = ((mixed ^ (mixed >> 15)) & 0xFFFF) / 65535.0
    return value
