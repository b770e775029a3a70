"""Patterns of tied, clamped and stencilled cloth as images of B: the small generator behind `kind: shibori`.

The cloth is first folded into panels, like an accordion, so that a pattern on a panel is on all panels, mirrored.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from nuno_dye.quantities import Angle, Length, Place
from nuno_dye.supplies.regions import find_middles
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config

Panels = Annotated[int, Field(ge=1, le=256)]


class Rings(Config):
    """A cone of cloth that is pulled up and bound repeatedly."""

    pattern: Literal["rings"] = "rings"
    centre: Place | None = Field(default=None, description="in a panel [m]; its middle unless given")
    spacing: Length = Field(description="from binding to binding [m]")
    width: Length = Field(description="of a binding [m]")


class Stripes(Config):
    """Pleats that are bound in parallel."""

    pattern: Literal["stripes"] = "stripes"
    spacing: Length = Field(description="from binding to binding [m]")
    width: Length = Field(description="of a binding [m]")
    angle: Angle = Field(default=0.0, description="of the stripes against x [rad]")


class Squares(Config):
    """Itajime: the folded cloth clamped between square boards."""

    pattern: Literal["squares"] = "squares"
    side: Length = Field(description="of the boards [m]")
    angle: Angle = Field(default=0.0, description="that the boards are turned by [rad]")


class Seigaiha(Config):
    """Waves: scales of concentric arcs, each row in front of the one above."""

    pattern: Literal["seigaiha"] = "seigaiha"
    radius: Length = Field(description="of a scale [m]")
    arcs: Annotated[int, Field(ge=1, le=64)] = Field(default=3, description="that keep dye out, in a scale")


Pattern = Annotated[Rings | Stripes | Squares | Seigaiha, Field(discriminator="pattern")]


def fold(x: Float, length: float, panels: int) -> Float:
    """Return where places x [m] of a cloth of this length are in its first panel, once it is folded."""
    panel = length / panels
    folded: Float = panel - np.abs(x % (2.0 * panel) - panel)
    return folded


def draw_pattern(
    pattern: Rings | Stripes | Squares | Seigaiha, folds: tuple[int, int], shape: tuple[int, int], size: float
) -> Float:
    """Return 1 where (ny, nx) dye is kept out, 0 elsewhere; `folds` panels across and down. Raises BadInput if bindings
    leave no space between them.
    """
    ny, nx = shape
    x, y = find_middles(shape, size)
    panel = (nx * size / folds[0], ny * size / folds[1])
    u, v = np.broadcast_arrays(fold(x, nx * size, folds[0]), fold(y, ny * size, folds[1]))
    middle = (0.5 * panel[0], 0.5 * panel[1])
    if isinstance(pattern, Seigaiha):
        return _draw_scales(pattern, u, v)
    if isinstance(pattern, Squares):
        p, q = _turn(u - middle[0], v - middle[1], pattern.angle)
        return np.asarray(np.maximum(np.abs(p), np.abs(q)) <= 0.5 * pattern.side, np.float64)
    if pattern.width >= pattern.spacing:
        raise BadInput(
            "bindings leave no room between them", field="width", value=pattern.width,
            limit=f"below the spacing, {pattern.spacing:g} m",
        )  # fmt: skip
    if isinstance(pattern, Rings):
        centre = pattern.centre or middle
        away = np.hypot(u - centre[0], v - centre[1])
    else:
        away = _turn(u, v, pattern.angle)[1]
    # A binding is in the middle of each spacing: a ring's centre is not bound.
    place = away % pattern.spacing - 0.5 * pattern.spacing
    return np.asarray(np.abs(place) <= 0.5 * pattern.width, np.float64)


def _turn(x: Float, y: Float, angle: float) -> tuple[Float, Float]:
    c, s = np.cos(angle), np.sin(angle)
    return c * x + s * y, c * y - s * x


def _draw_scales(pattern: Seigaiha, x: Float, y: Float) -> Float:
    """Return the arcs of the frontmost scale at each place.

    Scales of a row touch; rows are half a radius apart and shifted by a radius, so five rows reach a place. Of
    2 arcs + 1 bands of equal width the even ones, from the rim, let dye in.
    """
    r = pattern.radius
    away = np.zeros_like(x)
    first = np.floor(2.0 * y / r) - 2.0
    for k in range(6):
        row = first + k
        shift = r * (row % 2.0)
        from_middle = (x - shift + r) % (2.0 * r) - r
        distance = np.hypot(from_middle, y - 0.5 * r * row)
        away = np.where(distance <= r, distance, away)
    band = np.minimum(np.floor((1.0 - away / r) * (2 * pattern.arcs + 1)), 2 * pattern.arcs)
    return np.asarray(band % 2.0 == 1.0, np.float64)
