"""The configuration of a picture."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from nuno_schemas.parts import Colour
from nuno_schemas.plugin import Config
from nuno_schemas.units import quantity


def _direction(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if not (all(map(math.isfinite, value)) and any(value)):
        raise ValueError("a direction has finite components, not all zero")
    return value


Height = Annotated[float, quantity("m")]

Direction = Annotated[tuple[float, float, float], AfterValidator(_direction)]


class Legend(BaseModel):
    """A colour bar for cloth coloured by `nuno_schemas.colour.colours`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    label: str = Field(max_length=60, description="what the colours show")
    low: float = Field(allow_inf_nan=False, description="value of the dark end")
    high: float = Field(allow_inf_nan=False, description="value of the bright end")
    format: Literal["g", "percent"] = Field(default="g", description="how the two values are written")


class PictureConfig(Config):
    """Light and surroundings of a picture."""

    background: tuple[Colour, Colour] = Field(
        default=("#dfe3e6", "#f4f1ec"), description="sRGB at the picture's top and bottom"
    )
    ground: Literal["auto", "none"] | Height = Field(
        default="auto",
        description="height of the floor along `up` [m]; auto is the lowest point drawn. For an animation give the "
        "height, so that it does not follow the cloth",
    )
    ground_colour: Colour = Field(default="#ebe6de", description="of the floor, sRGB")
    up: Direction = Field(default=(0.0, 0.0, 1.0), description="direction away from the floor, of any length")
    light: Literal["auto"] | Direction = Field(
        default="auto", description="direction toward the key light; auto: left of the camera, 50 degrees high"
    )
    light_size: float = Field(
        default=0.06, ge=0.0, le=0.5, description="tangent of the key light's angular radius: how soft shadows are"
    )
    shadows: bool = Field(default=True, description="whether the key light casts them")
    occlusion: bool = Field(default=True, description="whether what is near hides the sky: folds, yarns, bodies")


class RasterConfig(PictureConfig):
    """Settings of the renderer `raster`."""

    samples: Literal[1, 4, 8, 16] = Field(default=8, description="samples per pixel, for smooth edges")
    sheen: float = Field(default=0.18, ge=0.0, le=1.0, description="strength of the velvet-like rim of cloth")
    caption: str = Field(default="", max_length=200, description="written in the lower left corner")
    legend: Legend | None = Field(default=None, description="a colour bar in the lower right corner")
