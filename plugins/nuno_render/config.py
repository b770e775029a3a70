"""The configuration of a picture, of meshes or of yarns."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from nuno_schemas.parts import Colour
from nuno_schemas.plugin import Config
from nuno_schemas.units import Plausible, quantity

# The configuration of a picture.


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


class PathsConfig(PictureConfig):
    """Settings of the renderer `paths`."""

    samples: int = Field(default=64, ge=1, le=65536, description="paths per pixel; noise shrinks with its root")
    seed: int = Field(default=0, ge=0, lt=2**31, description="of the paths")
    denoise: bool = Field(default=True, description="whether Open Image Denoise, if it is installed, takes noise away")
    light_size: float = Field(
        default=0.2, ge=0.0, le=0.5, description="tangent of the key light's angular radius: how soft shadows are"
    )
    caption: str = Field(default="", max_length=200, description="written in the lower left corner")
    legend: Legend | None = Field(default=None, description="a colour bar in the lower right corner")


# The configuration of pictures of yarns.

Thickness = Annotated[float, quantity("m", Plausible(1e-6, 0.02, ("um", "mm")), gt=0)]

PALETTE: tuple[Colour, ...] = ("#3a2a24", "#74503c", "#8c5f48", "#3b5b8c", "#5d8a4f", "#7d5ba6")
SKIN = "#e0b096"


class CastConfig(PictureConfig):
    """The fields of all pictures of yarns."""

    samples: int = Field(default=16, ge=1, le=4096, description="rays per pixel; grain shrinks with its root")
    seed: int = Field(default=0, ge=0, lt=2**31, description="of the places of the samples")
    light_size: float = Field(
        default=0.12, ge=0.0, le=0.5, description="tangent of the key light's angular radius: how soft shadows are"
    )
    skin: Colour = Field(default=SKIN, description="of bodies that bring no colour of their own, sRGB")
    caption: str | None = Field(
        default=None, max_length=200, description="in the lower left corner; left out: the scene's name and the time"
    )


class YarnsConfig(CastConfig):
    """Settings of the pictures `yarns`."""

    radius: Thickness | tuple[Thickness, ...] | None = Field(
        default=None,
        description="of every yarn, or of each kind in their order [m]; left out: what each yarn has of its own",
    )
    colour: Colour | None = Field(default=None, description="of all yarns, sRGB; left out: of each kind its own")
    colours: tuple[Colour, ...] = Field(
        default=PALETTE, min_length=1, max_length=100, description="of the kinds in their order, over again if more"
    )
    translucency: float | None = Field(
        default=None,
        ge=0.0,
        lt=1.0,
        description="share of light that a yarn lets through at each crossing; left out: "
        "that of a clear fibre of its colour",
    )
    roughness: float = Field(
        default=0.2, ge=0.05, le=1.0, description="of the fibres' surface, 0 to 1: larger makes highlights wider"
    )


class LinesConfig(CastConfig):
    """Settings of the pictures `lines`."""

    width: float = Field(default=1.0, gt=0.0, le=64.0, description="of a line at the camera's target [pixels]")
    colour: Colour = Field(default="#2b2320", description="of the lines, sRGB")
    shadows: bool = Field(default=True, description="whether bodies cast them; lines cast none")


class MapConfig(CastConfig):
    """Settings of the pictures `map`."""

    low: float | None = Field(
        default=None, allow_inf_nan=False, description="value of the dark end; left out: the least that is seen"
    )
    high: float | None = Field(
        default=None,
        allow_inf_nan=False,
        description="value of the bright end; left out: what 19 of 20 places that are seen are below",
    )
    radius: Thickness | None = Field(
        default=None,
        description="how near points count at a place of the surface [m]; left out: five times the mean link",
    )
    samples: int = Field(default=4, ge=1, le=64, description="rays per pixel")


class DensityConfig(MapConfig):
    """Settings of the pictures `density`."""

    radius: Thickness = Field(
        default=0.04,
        description="how near points count at a place of the surface [m]: with 40 mm the largest number of "
        "150 x 150 points on the leg is about the knit paper's 800",
    )


def grid_of(samples: int) -> tuple[int, int]:
    """Return columns and rows of at least so many samples a pixel, as square as possible."""
    columns = math.isqrt(samples)
    return columns, -(-samples // columns)
