"""Shibori as images of B: cloth that is tied, clamped, stencilled, or folded into a packet and stitched."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_dye.quantities import Angle, Length, Place
from nuno_dye.supplies.regions import Polyline, Region, contains, find_middles
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float
from nuno_schemas.plugin import Config

# Folded shibori: cloth that is folded into a packet, clamped and stitched, and unfolded again.
#
# A fold maps each place of the cloth to one of the packet without stretching it: place by place it is a product of
# reflections in the lines along which the cloth is folded. A resist is drawn once, on the packet, and applies to all
# cloth at its place there. Every layer is assumed to be pressed alike: dye reaches the packet's inner layers like the
# outer ones.
#
# Places are in half cells: middles of cells are whole numbers, which pleats of whole cells mirror exactly.

DIGITS = 15
"""Digits of sines, which make those of right angles whole."""
WHOLE = 9
"""Digits of a pleat's width in half cells, which make that of whole cells, given in metres, whole."""


class Pleats(Config):
    """An accordion, from the packet's start in its direction."""

    fold: Literal["pleats"] = "pleats"
    number: Annotated[int, Field(ge=1, le=256)] | None = Field(
        default=None, description="of pleats that the packet is folded into; or their width"
    )
    width: Length | None = Field(default=None, description="of a pleat [m]; or their number")
    angle: Angle = Field(default=0.0, description="of the way from pleat to pleat against x, which is across [rad]")

    @model_validator(mode="after")
    def _one_of_both(self) -> Pleats:
        if (self.number is None) == (self.width is None):
            raise PydanticCustomError("number_or_width", "pleats have either a number or a width", {})
        return self


class Triangles(Config):
    """A strip folded up in triangles, like a flag, once the cloth is pleated to their height.

    The packet is a triangle with its corners, relative to the start of the previous packet, in (0, 0), (0, side) and
    (sqrt(3)/2 side, side/2) if it is equilateral, and in (0, 0), (side, 0) and (side, side) if it is right.
    """

    fold: Literal["triangles"] = "triangles"
    side: Length = Field(description="of an equilateral triangle, or a leg of a right one [m]")
    kind: Literal["equilateral", "right"] = Field(default="equilateral", description="right: half of a square")


class Stitch(Config):
    """A running stitch that is drawn tight."""

    points: Polyline = Field(description="of its line on the packet [m]")
    width: Length = Field(description="over which a stitch presses [m]")
    length: Length = Field(description="of a stitch, and of the way to the next one [m]")


Folds = Annotated[tuple[Annotated[Pleats | Triangles, Field(discriminator="fold")], ...], Field(max_length=16)]
Clamps = Annotated[tuple[Region, ...], Field(max_length=64)]
Stitches = Annotated[tuple[Stitch, ...], Field(max_length=64)]


def draw_packet(
    folds: Folds, clamps: Sequence[Region], stitches: Sequence[Stitch], shape: tuple[int, int], size: float
) -> Float:
    """Return 1 where (ny, nx) a cloth of cells with side `size` [m] is clamped or stitched while folded, 0 elsewhere.
    Raises BadInput for clamps and stitches outside of the packet, and folds finer than a cell.
    """
    u, v = fold_cells(folds, shape, size)
    pressed = np.zeros(shape, np.bool_)
    for what, items in (("clamps", clamps), ("stitches", stitches)):
        for index, item in enumerate(items):
            covered = _find_stitch(item, u, v) if isinstance(item, Stitch) else contains(item, u, v)
            if not covered.any():
                raise BadInput(
                    "beside the packet", field=f"{what}[{index}]", value=item.model_dump(),
                    limit=f"folded, the cloth lies between ({u.min():.4g}, {v.min():.4g}) m and "
                    f"({u.max():.4g}, {v.max():.4g}) m",
                    remedy="places count on the packet, from the upper left corner, x to the right and y down",
                )  # fmt: skip
            pressed |= covered
    return pressed.astype(np.float64)


def fold_cells(folds: Folds, shape: tuple[int, int], size: float) -> tuple[Float, Float]:
    """Return x, y (ny, nx) [m] of cells' middles on the packet. Raises BadInput, at `folds[i]`, for folds too fine."""
    ny, nx = shape
    u, v = np.meshgrid(2.0 * np.arange(nx) + 1.0, 2.0 * np.arange(ny) + 1.0)
    half = 0.5 * size
    box = np.array([[0.0, 2.0 * nx], [0.0, 2.0 * ny]])
    for index, one in enumerate(folds):
        u, v, box, finest = _pleat(one, u, v, box, half) if isinstance(one, Pleats) else _fold_up(one, u, v, box, half)
        if finest < 2.0:
            raise BadInput(
                "folded finer than a cell", field=f"folds[{index}]", value=f"{finest * half:.3g} m", limit=f"{size:g} m"
            )
    return half * u, half * v


def _pleat(one: Pleats, u: Float, v: Float, box: Float, half: float) -> tuple[Float, Float, Float, float]:
    """Return places, their bounds (2, 2) and the width of a pleat, in half cells, after pleating."""
    c, s = (round(float(value), DIGITS) for value in (np.cos(one.angle), np.sin(one.angle)))
    along, across = c * u + s * v, c * v - s * u
    corners = np.add.outer(c * box[0], s * box[1])
    low, high = float(corners.min()), float(corners.max())
    width = (high - low) / one.number if one.number is not None else round((one.width or 0.0) / half, WHOLE)
    folded = low + _accordion(along - low, width)
    u, v = c * folded - s * across, s * folded + c * across
    if 0.0 in (c, s):
        axis = 0 if s == 0.0 else 1
        first = low if c + s > 0.0 else -low - width
        box = box.copy()
        box[axis] = first, first + min(width, high - low)
    else:
        reach = abs(c) + abs(s)
        box = np.array([[w.min() - reach, w.max() + reach] for w in (u, v)])
    return u, v, box, width


def _accordion(x: Float, width: float) -> Float:
    """Return places mirrored onto the first pleat."""
    return np.asarray(width - np.abs(x % (2.0 * width) - width))


def _fold_up(one: Triangles, u: Float, v: Float, box: Float, half: float) -> tuple[Float, Float, Float, float]:
    """Return the same after folding into triangles.

    The fold lines of an equilateral triangle of height h are parallel to its sides, h apart. Let a place be (p - q) h
    away from the first side, (q - r) h from the second and (1 - p + r) h from the third. Reflections in the first two
    swap p and q, q and r; in the third, p and r, and add 1 to the one and -1 to the other. So they reach all
    permutations of p, q and r, with whole numbers of sum 0 added; the packet is where p >= q >= r >= p - 1. Adding a
    number to all three changes nothing: of whole parts only the sum counts, modulo 3, and each 1 of it goes to the
    smallest.
    """
    side, (x, y) = one.side / half, (u - box[0, 0], v - box[1, 0])
    if one.kind == "right":
        x, y = _accordion(x, side), _accordion(y, side)
        x, y, height = np.maximum(x, y), np.minimum(x, y), side
    else:
        height = 0.5 * np.sqrt(3.0) * side
        q = (0.5 * np.sqrt(3.0) * y - 0.5 * x) / height
        p = q + x / height
        whole = (np.floor(p) + np.floor(q)) % 3.0
        high, low = np.maximum(p % 1.0, q % 1.0), np.minimum(p % 1.0, q % 1.0)
        a = np.choose(whole.astype(np.intp), [high - low, 1.0 - high, low])
        b = np.choose(whole.astype(np.intp), [low, high - low, 1.0 - high])
        x = height * a
        y = (2.0 * height * b + x) / np.sqrt(3.0)
    left, top = box[:, 0]
    return x + left, y + top, np.array([[left, left + height], [top, top + side]]), height


def _find_stitch(one: Stitch, x: Float, y: Float) -> Bool:
    """Return where its stitches press, at places [m]."""
    pressed: Bool = np.zeros(x.shape, np.bool_)
    start = 0.0
    for (ax, ay), (bx, by) in zip(one.points, one.points[1:], strict=False):
        length = float(np.hypot(bx - ax, by - ay))
        if length == 0.0:
            continue
        c, s = (bx - ax) / length, (by - ay) / length
        along, away = c * (x - ax) + s * (y - ay), c * (y - ay) - s * (x - ax)
        on = (start + along) % (2.0 * one.length) < one.length
        pressed |= on & (along >= 0.0) & (along <= length) & (np.abs(away) <= 0.5 * one.width)
        start += length
    return pressed


# Patterns of tied, clamped and stencilled cloth as images of B: the small generator behind `kind: shibori`.
#
# The cloth is first folded into panels, like an accordion, so that a pattern on a panel is on all panels, mirrored.

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
    return _accordion(x, length / panels)


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
