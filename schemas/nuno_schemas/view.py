"""The part of a scene that describes its pictures."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from nuno_schemas.parts import Choice, Interval, Metres, Part
from nuno_schemas.units import quantity

Angle = Annotated[float, quantity("rad")]
Distance = Annotated[float, quantity("m", gt=0)]

Vector = tuple[Metres, Metres, Metres]
Pixels = Annotated[int, Field(ge=16, le=8192)]


class View(Part):
    """Camera and colours of pictures; omitted fields are fitted to the scene."""

    azimuth: Angle = Field(default=0.6, description="[rad] round the vertical, 0 looks along -z")
    elevation: Angle = Field(default=0.2, description="[rad] of the eye above the horizon")
    target: Vector | None = Field(default=None, description="what is looked at: x, y, z [m]; fitted unless given")
    distance: Distance | None = Field(default=None, description="of the eye from the target [m]; fitted unless given")
    close: bool = Field(default=False, description="whether pictures are fitted to the cloth alone, whatever it is on")
    size: tuple[Pixels, Pixels] = Field(default=(960, 720), description="width and height in pixels")
    colour: Literal["cloth", "stretch"] = Field(
        default="cloth",
        description="how cloth of triangles is painted that has neither a colour nor a texture: each object in a "
        "colour by its place in the scene, or by stretch",
    )
    links: Literal["stretch", "yarn", "tension"] = Field(
        default="stretch",
        description="what colours the links of a net in the viewer: stretch, the yarn they are of, or its tension",
    )
    yarns: Choice | None = Field(
        default=None, description="how `nuno export --style` and `pictures` draw yarns: a plugin and its fields"
    )
    pictures: Interval | Literal["end"] | None = Field(
        default=None,
        description="yarns drawn by rays while the scene runs, shown and recorded: at this interval [s], beside those "
        "of the first and the last frame, or at the end alone; left out: none",
    )
