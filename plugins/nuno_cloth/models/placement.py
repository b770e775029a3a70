"""The start of a garment: its rotation, pins by name, texture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field

from nuno_cloth.models.grid import Grid
from nuno_cloth.quantities import Angle, Length, Metres, Number, Speed
from nuno_schemas.colour import read_rgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float
from nuno_schemas.plugin import Config, Files
from nuno_schemas.vectors import compose, norm

Point = tuple[Metres, Metres, Metres]
Velocity = tuple[Speed, Speed, Speed]


def _not_zero(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(axis):
        raise ValueError("the axis must not be the zero vector")
    return axis


Direction = Annotated[tuple[Number, Number, Number], AfterValidator(_not_zero)]


class Rotation(Config):
    """A right-handed turn about an axis."""

    axis: Direction = Field(default=(0.0, 1.0, 0.0), description="of any length but zero")
    angle: Angle = Field(description="[rad]")

    def matrix(self) -> Float:
        """Return the rotation matrix (3, 3), by Rodrigues' formula."""
        x, y, z = np.asarray(self.axis) / norm(np.asarray(self.axis))
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.asarray(np.eye(3) + np.sin(self.angle) * cross + (1 - np.cos(self.angle)) * compose(cross, cross))


class Attach(Config):
    """The body and frame that pinned vertices follow."""

    body: str = Field(description="name of a body of the scene")
    frame: str | None = Field(
        default=None,
        description="one of its joints; may be left out of a body that has only one, and of a skin, which each vertex "
        "then follows where it is",
    )


class Over(Config):
    """The body that wears it."""

    body: str = Field(min_length=1, description="name of the body, which has a mesh as collider")
    clearance: Length = Field(default=5e-3, description="how far from the surface it starts at least [m]")


class Wearable:
    """A model of cloth that a body may wear: `over` in its configuration names the body, or is None."""

    def over(self, config: Any) -> str | None:
        """Return the name of the body that wears it, or None."""
        return None if config.over is None else str(config.over.body)


CUT_TO_BARE = "shirt", "skirt"
"""Models of garments that are cut to a bare body; sewn patterns also go over other garments."""
STILL = (0.0, 0.0, 0.0)
VELOCITY = "of all free vertices at the start [m/s]"
TEXTURE = "an image beside the scene, shown on the outside and the inside"

PinName = Literal[
    "top-row",
    "bottom-row",
    "left-edge",
    "right-edge",
    "all-rim",
    "corners",
    "top-corners",
    "top-left",
    "top-right",
    "bottom-left",
    "bottom-right",
]


def pin_grid(grid: Grid, pins: tuple[PinName | int, ...]) -> Bool:
    """Return the pinned vertices (n,). Names are as seen from outside; numbers are row * cols + column."""
    pinned = np.zeros((grid.rows, grid.cols), np.bool_)
    places: dict[str, tuple[object, object]] = {
        "top-row": (0, slice(None)),
        "bottom-row": (-1, slice(None)),
        "left-edge": (slice(None), 0),
        "right-edge": (slice(None), -1),
        "corners": (slice(None, None, max(grid.rows - 1, 1)), slice(None, None, max(grid.cols - 1, 1))),
        "top-corners": (0, slice(None, None, max(grid.cols - 1, 1))),
        "top-left": (0, 0),
        "top-right": (0, -1),
        "bottom-left": (-1, 0),
        "bottom-right": (-1, -1),
    }
    for pin in pins:
        if pin == "all-rim":
            pinned[[0, -1], :] = True
            pinned[:, [0, -1]] = True
        elif isinstance(pin, str):
            pinned[places[pin]] = True  # type: ignore[index]
    for index, pin in enumerate(pins):
        if isinstance(pin, str):
            continue
        if not 0 <= pin < grid.number:
            raise BadInput(
                "no such vertex to pin",
                field=f"pin[{index}]",
                value=pin,
                limit=f"0 to {grid.number - 1}",
                remedy="vertices are numbered row * columns + column",
            )
        pinned.reshape(-1)[pin] = True
    return pinned.reshape(-1)


def require_bare(worn: Sequence[Fabric], name: str, body: str) -> None:
    """Raise BadInput if a body already wears cloth, for a garment that is cut to a bare body."""
    if not worn:
        return
    others = [one.name for one in worn if one.name in CUT_TO_BARE]
    remedy = f"let the {name} come first among the objects"
    if others:
        remedy = f"so is the {others[0]}: sew one from a pattern, model: {{plugin: pattern}}, and let that come last"
    raise BadInput(f"a {name} is put on a bare body, and this one wears cloth already", field="over.body", value=body,
                   remedy=remedy)  # fmt: skip


def find_texture(texture: str | None, files: Files) -> str | None:
    """Return the image's path. Raises BadInput if it is missing, outside of allowed folders, or unreadable."""
    if texture is None:
        return None
    path = files.resolve(texture)
    try:
        read_rgb(path)
    except (OSError, ValueError, SyntaxError) as error:
        remedy = "scale it down" if "pixels" in str(error) else "save it as PNG or JPEG"
        raise BadInput(f"cannot be read as an image: {error}", field="texture", value=texture, remedy=remedy) from None
    return str(path)
