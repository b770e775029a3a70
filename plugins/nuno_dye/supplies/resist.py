"""Resists, which keep dye out of cloth: B in [0, 1], the share of a cell's capacity for mobile dye that they take.

B comes from an image, as in the dye paper; from shapes; from lines of paste or binding; from shibori patterns; and from
clamps and stitches on folded cloth. Several multiply the capacity that each leaves: 1 - B = (1 - B_1)(1 - B_2)...
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_dye.quantities import Length, Metres, Share
from nuno_dye.supplies.regions import Polyline, Region, Stroke, cover, find_distance, find_middles
from nuno_dye.supplies.shibori import Clamps, Folds, Panels, Pattern, Stitches, draw_packet, draw_pattern
from nuno_schemas.dye import Cells
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config, Files

MOST_RESISTS = 256


class _Resist(Config):
    strength: Share = Field(default=1.0, description="B where it is strongest; 1 lets no dye in")
    bleed: Annotated[Metres, Field(ge=0)] = Field(
        default=0.0,
        description="how far its edges run, as paste does before it sets: the standard deviation of the blur [m]; from "
        "about one cell on edges have no stairs",
    )


class ImageResist(_Resist):
    """A stencil: white keeps dye out."""

    kind: Literal["image"] = "image"
    file: str = Field(
        description="a grey PNG beside the scene, a pixel for each cell, white being the most that its bits can say; "
        "transparent keeps nothing out"
    )
    invert: bool = Field(default=False, description="black keeps dye out")
    fit: Literal["exact", "stretch"] = Field(
        default="exact",
        description="stretch: an image of any size is drawn out over the cloth, by means over its cells, or linearly "
        "between pixels that are larger than cells",
    )


class ShapeResist(_Resist):
    """A disc, rectangle, polygon or stroke."""

    kind: Literal["shape"] = "shape"
    region: Region = Field(description="where dye is kept out")


class Paste(_Resist):
    """A line of paste, even over its width."""

    kind: Literal["paste"] = "paste"
    points: Polyline = Field(description="of the line, x to the right and y down [m]")
    width: Length = Field(description="[m]")


class Binding(_Resist):
    """A thread tied around the cloth, which presses most along its middle.

    The share of capacity that it takes follows the pressure under a cylinder, sqrt(1 - (d / a)^2) at a distance d from
    the middle, a being half of the width (Hertz 1882).
    """

    kind: Literal["binding"] = "binding"
    points: Polyline = Field(description="of the thread, x to the right and y down [m]")
    width: Length = Field(description="over which it presses [m]")


class Shibori(_Resist):
    """A tied or clamped cloth, or waves."""

    kind: Literal["shibori"] = "shibori"
    pattern: Pattern = Field(description="rings, stripes, squares or seigaiha")
    fold: tuple[Panels, Panels] = Field(default=(1, 1), description="panels across and down that it is folded into")


class Folded(_Resist):
    """A cloth that is folded into a packet, which is clamped and stitched; unfolded, each fold mirrors it."""

    kind: Literal["folded"] = "folded"
    folds: Folds = Field(default=(), description="pleats and triangles, one after the other")
    clamps: Clamps = Field(default=(), description="shapes that are pressed onto the packet, in its places")
    stitches: Stitches = Field(default=(), description="running stitches through the packet, drawn tight")

    @model_validator(mode="after")
    def _require_pressure(self) -> Folded:
        if not (self.clamps or self.stitches):
            raise PydanticCustomError("nothing_pressed", "folds alone keep no dye out: add clamps or stitches", {})
        return self


AnyResist = ImageResist | ShapeResist | Paste | Binding | Shibori | Folded
Resist = Annotated[AnyResist, Field(discriminator="kind")]
Resists = Annotated[tuple[Resist, ...], Field(max_length=MOST_RESISTS)]


def find_resist(resist: AnyResist, shape: tuple[int, int], size: float, files: Files) -> Float:
    """Return B (ny, nx) of one resist. Raises BadInput for an image that does not fit, and a resist on no cell."""
    if isinstance(resist, ImageResist):
        stretched = resist.fit == "stretch"
        values = read_image(files.resolve(resist.file), None if stretched else shape, resist.invert)
        values = stretch(values, shape) if stretched else values
    elif isinstance(resist, ShapeResist):
        values = cover(resist.region, shape, size).astype(np.float64)
    elif isinstance(resist, Folded):
        values = draw_packet(resist.folds, resist.clamps, resist.stitches, shape, size)
    elif isinstance(resist, Shibori):
        values = draw_pattern(resist.pattern, resist.fold, shape, size)
    else:
        values = cover(Stroke(points=resist.points, width=resist.width), shape, size).astype(np.float64)
        if isinstance(resist, Binding):
            half = 0.5 * resist.width
            distance = np.minimum(find_distance(resist.points, half, *find_middles(shape, size)), half)
            values = np.sqrt(1.0 - (distance / half) ** 2)
    if resist.bleed > 0.0:
        from scipy.ndimage import gaussian_filter  # its import takes a while, and is not always needed

        # What diffuses in cloth that is sealed at its rims: an edge becomes 1/2 erfc(x / (sqrt(2) bleed)).
        values = np.clip(gaussian_filter(values, resist.bleed / size, mode="reflect"), 0.0, 1.0)
    return resist.strength * values


def find_resists(items: Sequence[Resist], shape: tuple[int, int], size: float, files: Files) -> tuple[Float, ...]:
    """Return B (ny, nx) of each resist. Raises BadInput, at `resist[i]` or in its file."""
    values = []
    side = min(shape) * size
    for index, item in enumerate(items):
        if item.bleed > side:
            raise BadInput(
                "edges run farther than the cloth reaches", field=f"resist[{index}].bleed", value=f"{item.bleed:g} m",
                limit=f"the cloth's shorter side, {side:g} m", remedy="paste bleeds by tenths of a millimetre",
            )  # fmt: skip
        try:
            values.append(find_resist(item, shape, size, files))
        except BadInput as error:
            if isinstance(item, ImageResist):
                raise
            if isinstance(item, Folded):
                raise error.at(f"resist[{index}].{error.field}") from None
            field = {"shape": "region", "paste": "points", "binding": "points", "shibori": "pattern"}[item.kind]
            raise error.at(f"resist[{index}].{field}") from None
    return tuple(values)


def put_on(parts: Sequence[Float], cells: Cells) -> None:
    """Add resists (ny, nx) to those of both layers of cells."""
    for part in parts:
        np.copyto(cells.resist, combine([cells.resist, np.broadcast_to(part, cells.resist.shape)]))


def combine(parts: Sequence[Float]) -> Float:
    """Return B of several resists together, of one shape, at least one."""
    room = np.ones_like(parts[0])
    for part in parts:
        room = room * (1.0 - part)
    return 1.0 - room


def read_image(
    path: Path, shape: tuple[int, int] | None, invert: bool = False, of: tuple[str, str] = ("cloth's", "cells")
) -> Float:
    """Read a grey PNG (ny, nx) of any bit depth, as shares of the white of that depth, times opacity. One with opacity
    or in colours that are all grey is read to 8 bits of each channel.

    `of` names the owner and the unit of `shape`; without a shape an image of any size is read.

    Raises BadInput for a file that is not PNG, for one in colour, and for another size than `shape`.
    """
    from PIL import Image, ImageOps, UnidentifiedImageError

    try:
        with path.open("rb") as stream, Image.open(stream, formats=["PNG"]) as image:
            size = (image.height, image.width)
            if shape is None or shape in (size, size[::-1]):
                turned = ImageOps.exif_transpose(image)
                size = (turned.height, turned.width)
                values, opacity = _read_pixels(turned)
    except UnidentifiedImageError:
        raise BadInput("cannot be read as PNG", file=str(path), remedy="save it as a grey PNG") from None
    except Exception as error:  # a decoder may raise anything on a broken file
        raise BadInput(f"cannot be read as PNG: {error}", file=str(path)) from None
    if shape is not None and size != shape:
        raise BadInput(
            f"the image has not the {of[0]} size", file=str(path), value=f"{size[1]} x {size[0]} pixels",
            limit=f"{shape[1]} x {shape[0]} {of[1]}", remedy=f"scale the image, or change the {of[0]} {of[1]}",
        )  # fmt: skip
    if values.ndim == 3:
        if (values != values[..., :1]).any():
            raise BadInput("the image is in colour", file=str(path), limit="grey", remedy="convert it to grey")
        values = values[..., 0]
    return (1.0 - values if invert else values) * opacity


def stretch(values: Float, shape: tuple[int, int]) -> Float:
    """Return an image stretched over cells (ny, nx), each the mean over its area, so that the whole image's mean is
    kept.

    Along an axis with more pixels than cells, pixels are constant; with fewer, values are linear from a pixel's middle
    to the next one's, so that edges are not staircases.
    """
    return np.clip(_draw_out(_draw_out(values, shape[0]).T, shape[1]).T, 0.0, 1.0)


def _draw_out(values: Float, cells: int) -> Float:
    """Return means (cells, k) of pixels (m, k), as differences of their exact integral."""
    m = len(values)
    if cells == m:
        return values
    # Bounds of each row of values; the half pixels at the rims have the outermost pixel's.
    nodes = np.arange(m + 1.0) if cells < m else np.clip(np.arange(m + 2) - 0.5, 0.0, m)
    first = values if cells < m else np.concatenate([values[:1], values])
    slope = np.zeros_like(values) if cells < m else np.diff(values, axis=0, prepend=values[:1], append=values[-1:])
    length = np.diff(nodes)[:, None]
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(length * (first + 0.5 * length * slope), axis=0)])
    edges = np.minimum(np.arange(cells + 1) * (m / cells), m)
    low = np.minimum(np.searchsorted(nodes, edges, side="right"), len(nodes) - 1) - 1
    into = (edges - nodes[low])[:, None]
    return np.asarray(np.diff(total[low] + into * (first[low] + 0.5 * into * slope[low]), axis=0) * (cells / m))


def _read_pixels(image: Any) -> tuple[Float, Float | float]:
    """Return values (ny, nx) or (ny, nx, 3) and opacity, in [0, 1]."""
    if image.mode == "1" or image.mode.startswith("I"):
        most = 255.0 if image.mode == "1" else 65535.0
        values = np.asarray(image.convert("L") if image.mode == "1" else image, np.float64)
        # Such a file may declare one value transparent, which Pillow does not convert.
        clear = image.info.get("transparency")
        return values / most, 1.0 if clear is None else (values != clear).astype(np.float64)
    mode = "LA" if image.mode in ("L", "LA") else "RGBA"
    pixels = np.asarray(image.convert(mode), np.float64) / 255.0
    return (pixels[..., 0] if mode == "LA" else pixels[..., :3]), pixels[..., -1]
