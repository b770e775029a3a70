"""Dye that is given to a cloth: drops, brush strokes, baths; at once, or kept up for a time.

Amounts are shares of V_u, what a cell can hold of mobile dye: the dye paper's initial "1.0 V" is a full cell,
amount 1. Supply raises a cell to its share and never takes dye away, so that what is there already, more or less,
makes a cell neither overflow nor dry. A finite bath exchanges dye both ways.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from nuno_dye.quantities import Length, Moment, Place, Positive, Share
from nuno_dye.regions import MOST_POINTS, All, Disc, Region, Stroke, cover
from nuno_schemas.fabric import Bool, Float
from nuno_schemas.plugin import Config


class _Supply(Config):
    """What all kinds share."""

    dye: Annotated[int, Field(ge=0, le=255)] = Field(default=0, description="its place in the list of dyes, from 0")
    amount: Share = Field(default=1.0, description="share of what a cell can hold of mobile dye")
    layers: Literal["both", "weft", "warp"] = Field(default="both", description="which yarns it reaches")
    maintained: bool = Field(default=False, description="kept up from `start` to `stop`; else given once, at `start`")
    start: Moment = Field(default=0.0, description="[s]")
    stop: Moment | None = Field(default=None, description="of what is maintained [s]; to the end unless given")

    @model_validator(mode="after")
    def _check(self) -> _Supply:
        if self.stop is not None and not self.maintained:
            raise ValueError("stop is for what is maintained: add maintained: true, or leave stop out")
        if self.stop is not None and self.stop <= self.start:
            raise ValueError(f"stop {self.stop:g} s must be after start {self.start:g} s")
        return self


class Drop(_Supply):
    """A round drop."""

    kind: Literal["drop"] = "drop"
    place: Place = Field(description="of its middle, x to the right and y down [m]")
    diameter: Length = Field(description="[m]")


class Brush(_Supply):
    """A stroke of a round brush along a line."""

    kind: Literal["stroke"] = "stroke"
    points: Annotated[tuple[Place, ...], Field(min_length=1, max_length=MOST_POINTS)] = Field(
        description="of the line [m]"
    )
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
            raise ValueError("a bath with a liquor ratio is exhausted over time: add maintained: true")
        return self


Supply = Annotated[Drop | Brush | Bath, Field(discriminator="kind")]


def find_cells(supply: Drop | Brush | Bath, shape: tuple[int, int], size: float) -> Bool:
    """(2, ny, nx) the cells it reaches. Raises BadInput where there is none."""
    if isinstance(supply, Drop):
        part = cover(Disc(centre=supply.place, diameter=supply.diameter), shape, size)
    elif isinstance(supply, Brush):
        part = cover(Stroke(points=supply.points, width=supply.width), shape, size)
    else:
        part = cover(supply.region, shape, size)
    reached = np.array([supply.layers != "warp", supply.layers != "weft"])
    return np.asarray(part & reached[:, None, None])


def is_due(supply: Drop | Brush | Bath, t0: float, t1: float) -> bool:
    """Whether it acts in a step from t0 to t1 [s]: given once in the step that its start lies in."""
    if supply.maintained:
        return supply.start < t1 and (supply.stop is None or supply.stop > t0)
    return t0 <= supply.start < t1


class Given(NamedTuple):
    """Amounts afterwards (2, ny, nx), and how much was given in all (taken, below 0)."""

    phi: Float
    given: float


def give(phi: Float, room: Float, cells: Bool, amount: float) -> Given:
    """Raise cells (2, ny, nx) to a share of their room V_u; what holds more is left alone."""
    raised = np.where(cells, np.maximum(phi, amount * room), phi)
    return Given(raised, math.fsum((raised - phi)[cells]))


class Exchange(NamedTuple):
    """Amounts afterwards (2, ny, nx), and what is left in the bath, as a share of what it can hold."""

    phi: Float
    share: float


def exchange(phi: Float, room: Float, cells: Bool, share: float, liquor: float) -> Exchange:
    """Well stirred exchange of immersed cells with a bath of finite volume, down to equal shares.

    With sum V the room of the cells and liquor L, the bath holds share L sum V, and everything together settles at

        s = (L share sum V + sum phi) / ((L + 1) sum V).
    """
    held, total = math.fsum(phi[cells]), math.fsum(room[cells])
    if total == 0.0:
        return Exchange(phi.copy(), share)
    settled = min(1.0, (liquor * share * total + held) / ((liquor + 1.0) * total))
    return Exchange(np.where(cells, settled * room, phi), settled)
