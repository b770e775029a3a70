"""The part of a scene that describes the look of dyed cloth: a dye's colours, and the picture."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_schemas.parts import Choice, Colour, Interval, Metres, Part
from nuno_schemas.units import quantity

Amount = Annotated[float, quantity("", gt=0)]

YARNS = "yarns"
"""The default plugin for pictures of dyed cloth."""
DyeView = Literal["all", "fixed", "mobile"]
"""Dye that is shown: all, fixed by fibre, or mobile."""
Form = Literal["straight", "smooth"]
"""Form of yarns as curves."""
Scale = Annotated[int, Field(strict=True, ge=1, le=256)]


class DyeColour(Part):
    """A dye's colours on cloth; indigo on cotton unless given."""

    light: Colour = Field(
        default="#eef2f7", description="where there is none of it; of the dye's own hue, for hues between are passed"
    )
    mid: Colour = Field(default="#5f86b3", description="at half of the full amount")
    dark: Colour = Field(default="#16264f", description="at the full amount, and beyond")
    full: Amount = Field(default=0.25, description="the amount that is dark, as a share of v_max")


class Crop(Part):
    """A part of the cloth, from its upper left corner, x to the right and y down."""

    low: tuple[Metres, Metres] = Field(description="upper left corner [m]")
    high: tuple[Metres, Metres] = Field(description="lower right corner [m]")

    @model_validator(mode="after")
    def _holds_something(self) -> Crop:
        if not (self.low[0] < self.high[0] and self.low[1] < self.high[1]):
            problem = "there is nothing between the corners; low is the upper left one, y counts down"
            raise PydanticCustomError("empty_crop", problem, {"inside": ("high",)})
        return self


class DyePicture(Choice):
    """The plugin that draws dyed cloth, and its settings; all other fields are the plugin's own."""

    plugin: str = Field(default=YARNS, description="its name; nuno plugins lists what is installed")
    view: DyeView = Field(default="all", description="all dye, what fibre has fixed of it, or what is mobile")
    scale: Scale | Literal["auto"] = Field(
        default="auto", description="pixels a cell; auto: the picture about 1000 pixels wide or high"
    )
    crop: Crop | None = Field(default=None, description="the part that is shown; left out: all of the cloth")
    every: Interval | None = Field(
        default=None, description="at most one picture in this time in the viewer [s]; left out: one a frame"
    )
