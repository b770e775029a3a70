"""What a user may choose about a picture."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from nuno_schemas.colour import parse_hex
from nuno_schemas.plugin import Config
from nuno_schemas.units import quantity


def _colour(text: str) -> str:
    parse_hex(text)
    return text


def _direction(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if not (all(map(math.isfinite, value)) and any(value)):
        raise ValueError("a direction has finite components, not all zero")
    return value


Colour = Annotated[str, AfterValidator(_colour)]
Direction = Annotated[tuple[float, float, float], AfterValidator(_direction)]


class Legend(BaseModel):
    """A colour bar for cloth coloured by `nuno_schemas.colour.colours`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    label: str = Field(max_length=60)
    low: float = Field(allow_inf_nan=False)
    high: float = Field(allow_inf_nan=False)
    format: Literal["g", "percent"] = "g"


class RasterConfig(Config):
    """Settings of the renderer `raster`."""

    samples: Literal[1, 4, 8, 16] = 8
    """Samples per pixel for edges."""
    background: tuple[Colour, Colour] = ("#dfe3e6", "#f4f1ec")
    """sRGB at the picture's top and bottom."""
    ground: Literal["auto", "none"] | quantity("m") = "auto"  # type: ignore[valid-type]
    """Height of the floor along `up`; auto is the lowest vertex drawn. For an animation give
    the height, so that it does not follow the cloth."""
    ground_colour: Colour = "#ebe6de"
    up: Direction = (0.0, 0.0, 1.0)
    light: Literal["auto"] | Direction = "auto"
    """Direction toward the key light; auto stands to the left of the camera, 50 degrees high."""
    light_size: float = Field(0.06, ge=0.0, le=0.5)
    """Tangent of the key light's angular radius: how soft shadows become with distance."""
    shadows: bool = True
    occlusion: bool = True
    """Whether nearby cloth and bodies hide the sky (folds, the inside of a skirt)."""
    sheen: float = Field(0.18, ge=0.0, le=1.0)
    """Strength of the velvet-like rim of cloth."""
    caption: str = Field("", max_length=200)
    legend: Legend | None = None
