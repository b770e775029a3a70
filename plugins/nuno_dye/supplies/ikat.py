"""Ikat: yarns of warp or weft that were bound and dyed before they were woven, by a pattern along and across them.

Their dye is fixed: it is a share of V_d, the capacity of fibre, from the start, and does not spread. Dye that was not
rinsed out is `loose`, a share of V_u, and runs. On the loom each yarn is displaced along itself by up to `shift` from
its place when bound, which is the blur of ikat.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from nuno_dye.quantities import Angle, Length, Metres, Share
from nuno_dye.supplies.resist import read_image, stretch
from nuno_dye.supplies.supply import find_dye
from nuno_schemas.dye import Cells, DyeState
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.parts import Name
from nuno_schemas.plugin import Config, Files

STREAM = 4
"""Stream of random numbers, different from those of the variation between yarns."""
MOST_IKATS = 64


class Bands(Config):
    """Alternating bound and dyed bands along the yarns."""

    pattern: Literal["bands"] = "bands"
    period: Length = Field(description="along the yarns, from one dyed band to the next [m]")
    width: Length = Field(description="of a dyed band, along the yarns [m]")
    angle: Angle = Field(
        default=0.0, ge=-1.5, le=1.5, description="of the bands against the way across the yarns [rad]"
    )


class Diamonds(Config):
    """Dyed lozenges that touch, with bound ones between them."""

    pattern: Literal["diamonds"] = "diamonds"
    along: Length = Field(description="length of a lozenge along the yarns [m]")
    across: Length = Field(description="width of a lozenge across the yarns [m]")


class IkatImage(Config):
    """An image: black is dyed, white was bound."""

    pattern: Literal["image"] = "image"
    file: str = Field(description="a grey PNG of any size beside the scene, drawn out over the cloth")


class Ikat(Config):
    """Yarns dyed before weaving."""

    yarns: Literal["warp", "weft"] = Field(default="warp", description="whose yarns are dyed")
    dye: Annotated[int, Field(ge=0, le=255)] | Name = Field(
        default=0, description="its name, or its place in the list of dyes, from 0"
    )
    pattern: Annotated[Bands | Diamonds | IkatImage, Field(discriminator="pattern")] = Field(
        description="bands, diamonds or image: where yarns are dyed"
    )
    amount: Share = Field(default=0.5, description="share of what fibre can hold of fixed dye")
    loose: Share = Field(default=0.0, description="share of what a cell can hold of mobile dye, which is there too")
    shift: Annotated[Metres, Field(ge=0)] = Field(
        default=0.0, description="how far each yarn is off along itself at most, either way, at random [m]"
    )


Ikats = Annotated[tuple[Ikat, ...], Field(max_length=MOST_IKATS)]


def dye_yarns(
    items: Sequence[Ikat], cells: Cells, state: DyeState, dyes: Sequence[str], files: Files, seed: int
) -> None:
    """Add the yarns' dye to `state`, in cells of the yarns themselves; of several patterns of one dye the largest
    amount counts. Raises BadInput, at `ikat[i]`, for an unknown dye, and an unusable image.
    """
    for index, item in enumerate(items):
        try:
            dye = find_dye(item.dye, dyes)
        except BadInput as error:
            raise error.at(f"ikat[{index}].dye") from None
        layer = 1 if item.yarns == "warp" else 0
        share = find_share(item, cells, files, np.random.default_rng([seed, STREAM, index]))
        share = np.where(cells.fibre[layer], share, 0.0)
        for amounts, most, capacity in (
            (state.fixed, item.amount, cells.fixed_room), (state.phi, item.loose, cells.mobile_room),
        ):  # fmt: skip
            np.maximum(amounts[dye, layer], most * share * capacity[layer], out=amounts[dye, layer])


def find_share(item: Ikat, cells: Cells, files: Files, stream: np.random.Generator) -> Float:
    """Return the share (ny, nx) of a pattern's dye in a layer, in [0, 1], with its yarns shifted. A yarn has the
    pattern's value at its middle over its whole width, like threads that are dyed through.
    """
    layer = 1 if item.yarns == "warp" else 0
    yarn = _yarns(cells, layer)
    place = np.arange(len(yarn)) + 0.5
    middle = np.bincount(yarn, place) / np.maximum(np.bincount(yarn), 1)
    off = stream.uniform(-item.shift, item.shift, len(middle))
    pattern, length = item.pattern, cells.fibre.shape[1 if layer else 2]
    if isinstance(pattern, IkatImage):
        image = stretch(read_image(files.resolve(pattern.file), None, invert=True), cells.fibre.shape[1:])
        lines = _shift((image.T if layer else image)[middle.astype(np.intp)], off / cells.size)
    else:
        along, across = ((np.arange(length) + 0.5) * cells.size - off[:, None]), middle[:, None] * cells.size
        lines = _draw(pattern, along, across)
    return lines[yarn].T if layer else lines[yarn]


def _draw(pattern: Bands | Diamonds, along: Float, across: Float) -> Float:
    """Return 1 where yarns are dyed, at places `along` them and `across` them [m]."""
    if isinstance(pattern, Bands):
        place = along + across * np.tan(pattern.angle)
        return np.asarray(place % pattern.period < pattern.width, np.float64)
    # |p| + |q| <= 1 is a square on its corner, with its middle in the cloth's first corner.
    p, q = (
        2.0 * np.abs(v / side - np.round(v / side)) for v, side in ((along, pattern.along), (across, pattern.across))
    )
    return np.asarray(p + q <= 1.0, np.float64)


def _yarns(cells: Cells, layer: int) -> Int:
    """Return the yarn of each row of weft, or column of warp. Raises BadInput for a cloth without known yarns."""
    if cells.yarns is None:
        raise BadInput("the cloth does not tell its yarns apart", field="ikat")
    return cells.yarns[layer]


def _shift(lines: Float, off: Float) -> Float:
    """Return lines (n, m) displaced by `off` cells each, by linear interpolation, constant beyond their ends."""
    last = lines.shape[1] - 1
    place = np.clip(np.arange(last + 1) - off[:, None], 0.0, last)
    low = place.astype(np.intp)
    line, share = np.arange(len(lines))[:, None], place - low
    return np.asarray((1.0 - share) * lines[line, low] + share * lines[line, np.minimum(low + 1, last)])
