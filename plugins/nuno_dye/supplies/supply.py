"""Supplies of dye to a cloth: drops, brush strokes, baths; at once, or maintained for a time.

Amounts are shares of V_u, the capacity of a cell for mobile dye: the dye paper's initial "1.0 V" is a full cell, amount
1. A supply raises a cell to its share and never takes dye away, so that cells with dye neither overflow nor dry. A
finite bath exchanges dye both ways, and a rinse takes mobile dye away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_dye.quantities import Length, Moment, Place, Positive, Share
from nuno_dye.supplies.regions import All, Disc, Polyline, Region, Stroke, cover
from nuno_schemas.dye import Supply
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Bool
from nuno_schemas.parts import Name
from nuno_schemas.plugin import Config
from nuno_schemas.units import quantity

MOST_SUPPLIES = 256
Layer = Literal["both", "weft", "warp"]


class _Supply(Config):
    """The fields of all kinds of supply."""

    dye: Annotated[int, Field(ge=0, le=255)] | Name = Field(
        default=0, description="its name, or its place in the list of dyes, from 0"
    )
    amount: Share = Field(default=1.0, description="share of what a cell can hold of mobile dye")
    layers: Layer = Field(default="both", description="which yarns it reaches")
    maintained: bool = Field(default=False, description="kept up from `start` to `stop`; else given once, at `start`")
    start: Moment = Field(default=0.0, description="[s]")
    stop: Moment | None = Field(default=None, description="of what is maintained [s]; to the end unless given")

    @model_validator(mode="after")
    def _check(self) -> _Supply:
        if self.stop is not None and not self.maintained:
            problem = "stop is for what is maintained; add maintained: true, or leave stop out"
            raise PydanticCustomError("stop_of_nothing", problem, {"inside": ("stop",)})
        if self.stop is not None and self.stop <= self.start:
            times = {"stop": f"{self.stop:g}", "start": f"{self.start:g}", "inside": ("stop",)}
            raise PydanticCustomError("stop_before_start", "stop {stop} s must be after start {start} s", times)
        return self


class Drop(_Supply):
    """A round drop."""

    kind: Literal["drop"] = "drop"
    place: Place = Field(description="of its middle, x to the right and y down [m]")
    diameter: Length = Field(description="[m]")


class Brush(_Supply):
    """A stroke of a round brush along a line."""

    kind: Literal["stroke"] = "stroke"
    points: Polyline = Field(description="of the line [m]")
    width: Length = Field(description="of the brush [m]")


class Bath(_Supply):
    """Immersion of the cloth or a part of it."""

    kind: Literal["bath"] = "bath"
    region: Region = Field(default=All(), description="what is immersed")
    liquor: Positive | None = Field(
        default=None, description="the bath's volume over that of the immersed cells' room; endless unless given"
    )

    @model_validator(mode="after")
    def _check_liquor(self) -> Bath:
        if self.liquor is not None and not self.maintained:
            problem = "a bath with a liquor ratio is exhausted over time; add maintained: true"
            raise PydanticCustomError("liquor_at_once", problem, {"inside": ("liquor",)})
        return self


class Rinse(Config):
    """Clean water, which takes mobile dye away at once; fixed dye stays."""

    kind: Literal["rinse"] = "rinse"
    dye: Annotated[int, Field(ge=0, le=255)] | Name | None = Field(
        default=None, description="its name, or its place in the list of dyes, from 0; all unless given"
    )
    region: Region = Field(default=All(), description="what is rinsed")
    layers: Layer = Field(default="both", description="which yarns it reaches")
    start: Moment = Field(default=0.0, description="[s]")
    share: Annotated[float, quantity("", gt=0, le=1)] = Field(
        default=1.0, description="of the mobile dye, that it takes away"
    )


AnySupply = Annotated[Drop | Brush | Bath | Rinse, Field(discriminator="kind")]
Supplies = Annotated[tuple[AnySupply, ...], Field(max_length=MOST_SUPPLIES)]


def find_cells(supply: AnySupply, shape: tuple[int, int], size: float) -> Bool:
    """Return the cells (2, ny, nx) that a supply reaches. Raises BadInput if it reaches none."""
    if isinstance(supply, Drop):
        part = cover(Disc(centre=supply.place, diameter=supply.diameter), shape, size)
    elif isinstance(supply, Brush):
        part = cover(Stroke(points=supply.points, width=supply.width), shape, size)
    else:
        part = cover(supply.region, shape, size)
    reached = np.array([supply.layers != "warp", supply.layers != "weft"])
    return np.asarray(part & reached[:, None, None])


def prepare_supplies(
    items: Sequence[AnySupply], shape: tuple[int, int], size: float, dyes: Sequence[str]
) -> tuple[Supply, ...]:
    """Return the supplies of `dyes`, by name, to a cloth of (ny, nx) cells with side `size` [m]. Raises BadInput, at
    `supply[i]`, if it reaches no cell or its dye is not in the scene.
    """
    return tuple(_prepare(item, f"supply[{index}]", shape, size, dyes) for index, item in enumerate(items))


def find_dye(dye: int | str, dyes: Sequence[str]) -> int:
    """Return the index of a dye among the scene's, given by index or name. Raises BadInput."""
    if dye in dyes:
        return dyes.index(str(dye))
    if isinstance(dye, int) and dye < len(dyes):
        return dye
    listed = ", ".join(f"{place} {name}" for place, name in enumerate(dyes))
    remedy = nearest(dye, dyes) if isinstance(dye, str) else "write the dye's name, or its place in the list of dyes"
    raise BadInput("no such dye", field="dye", value=dye, limit=listed, remedy=remedy)


def _prepare(item: AnySupply, place: str, shape: tuple[int, int], size: float, dyes: Sequence[str]) -> Supply:
    field = "dye"
    try:
        dye = None if item.dye is None else find_dye(item.dye, dyes)
        field = {"drop": "place", "stroke": "points", "bath": "region", "rinse": "region"}[item.kind]
        cells = find_cells(item, shape, size)
    except BadInput as error:
        raise error.at(f"{place}.{field}") from None
    if isinstance(item, Rinse):
        return Supply(item.kind, dye, cells, 0.0, item.start, rinsed=item.share)
    until = math.inf if item.stop is None else item.stop
    liquor = item.liquor if isinstance(item, Bath) else None
    return Supply(item.kind, dye, cells, item.amount, item.start, until if item.maintained else None, liquor)
