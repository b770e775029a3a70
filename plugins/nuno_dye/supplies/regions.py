"""Parts of a cloth: discs, rectangles, polygons, strokes along polylines, or all of it.

Places are [m] to the right and down from the cloth's upper left corner. A cell is in a part if its middle is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from nuno_dye.quantities import Length, Place
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float
from nuno_schemas.plugin import Config

MOST_POINTS = 10_000
Polyline = Annotated[tuple[Place, ...], Field(min_length=1, max_length=MOST_POINTS)]


class All(Config):
    """The whole cloth."""

    shape: Literal["all"] = "all"


class Disc(Config):
    """A round part."""

    shape: Literal["disc"] = "disc"
    centre: Place = Field(description="x to the right, y down [m]")
    diameter: Length = Field(description="[m]")


class Rectangle(Config):
    """A rectangle between two corners."""

    shape: Literal["rectangle"] = "rectangle"
    low: Place = Field(description="upper left corner [m]")
    high: Place = Field(description="lower right corner [m]")


class Polygon(Config):
    """The inside of a closed line, which may cross itself, by the even-odd rule."""

    shape: Literal["polygon"] = "polygon"
    points: Annotated[tuple[Place, ...], Field(min_length=3, max_length=MOST_POINTS)] = Field(
        description="corners [m]; the last is joined to the first"
    )


class Stroke(Config):
    """The area that a round brush covers along a line."""

    shape: Literal["stroke"] = "stroke"
    points: Polyline = Field(description="of the line [m]")
    width: Length = Field(description="of the brush [m]")


Region = Annotated[All | Disc | Rectangle | Polygon | Stroke, Field(discriminator="shape")]


def find_middles(shape: tuple[int, int], size: float) -> tuple[Float, Float]:
    """Return middles of cells, x (1, nx) and y (ny, 1) [m], for a cloth of (ny, nx) cells with side `size` [m]."""
    ny, nx = shape
    x: Float = (np.arange(nx, dtype=np.float64)[None] + 0.5) * size
    y: Float = (np.arange(ny, dtype=np.float64)[:, None] + 0.5) * size
    return x, y


def cover(region: All | Disc | Rectangle | Polygon | Stroke, shape: tuple[int, int], size: float) -> Bool:
    """Return the cells (ny, nx) of a part. Raises BadInput if it contains the middle of no cell."""
    x, y = find_middles(shape, size)
    if isinstance(region, Polygon):
        inside = _fill(region.points, x, y)
    elif isinstance(region, Stroke):
        inside = np.isfinite(find_distance(region.points, 0.5 * region.width, x, y))
    else:
        inside = np.broadcast_to(contains(region, x, y), shape)
    if not inside.any():
        width, height = shape[1] * size, shape[0] * size
        raise BadInput(
            "the part holds no cell", field=region.shape, value=region.model_dump(exclude={"shape"}),
            limit=f"the cloth is {width:g} m x {height:g} m, in cells of {size:g} m",
            remedy="places count from the upper left corner, x to the right and y down",
        )  # fmt: skip
    return np.asarray(inside, np.bool_)


def contains(region: All | Disc | Rectangle | Polygon | Stroke, x: Float, y: Float) -> Bool:
    """Return which places (ny, nx) [m] are in a part; unlike those of `cover` they need not form a grid."""
    inside = np.ones(np.broadcast_shapes(x.shape, y.shape), np.bool_)
    if isinstance(region, Disc):
        inside = np.hypot(x - region.centre[0], y - region.centre[1]) <= 0.5 * region.diameter
    elif isinstance(region, Rectangle):
        (left, top), (right, bottom) = region.low, region.high
        inside = (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
    elif isinstance(region, Polygon):
        inside[:] = False
        for (ax, ay), (bx, by) in _sides(region.points):
            if ay != by:
                inside ^= ((ay > y) != (by > y)) & (ax + (y - ay) / (by - ay) * (bx - ax) < x)
    elif isinstance(region, Stroke):
        inside[:] = False
        for (ax, ay), (bx, by) in zip(region.points, [*region.points[1:], region.points[-1]], strict=True):
            inside |= np.hypot(*_from_segment(x - ax, y - ay, bx - ax, by - ay)) <= 0.5 * region.width
    return np.asarray(inside, np.bool_)


def _sides(points: Sequence[Place]) -> Iterator[tuple[Place, Place]]:
    """Yield the sides of a closed line, each from its upper end: rounding puts places on shared sides in one part."""
    for ends in zip(points, [*points[1:], points[0]], strict=True):
        yield min(ends, key=_by_row), max(ends, key=_by_row)


def _by_row(place: Place) -> Place:
    return place[1], place[0]


def _from_segment(px: Float, py: Float, dx: float, dy: float) -> tuple[Float, Float]:
    """Return the vector to p from the nearest place of a segment from the origin to (dx, dy)."""
    long = dx * dx + dy * dy
    along = np.clip((px * dx + py * dy) / long, 0.0, 1.0) if long > 0.0 else 0.0
    return px - along * dx, py - along * dy


def _fill(points: Sequence[Place], x: Float, y: Float) -> Bool:
    """Return the cells (ny, nx) inside by the even-odd rule: a ray to the left crosses an odd number of sides."""
    inside = np.zeros((y.size, x.size), np.bool_)
    for (ax, ay), (bx, by) in _sides(points):
        rows = np.flatnonzero((ay > y[:, 0]) != (by > y[:, 0]))
        crossing = ax + (y[rows] - ay) / (by - ay) * (bx - ax) if len(rows) else y[rows]
        inside[rows] ^= crossing < x
    return inside


def find_distance(points: Sequence[Place], reach: float, x: Float, y: Float) -> Float:
    """Return the distance (ny, nx) to a polyline [m], inf beyond `reach` [m]. Each segment visits only the cells near
    it.
    """
    distance = np.full((y.size, x.size), np.inf)
    for (ax, ay), (bx, by) in zip(points, [*points[1:], points[-1]], strict=True):
        columns = np.flatnonzero((x[0] >= min(ax, bx) - reach) & (x[0] <= max(ax, bx) + reach))
        rows = np.flatnonzero((y[:, 0] >= min(ay, by) - reach) & (y[:, 0] <= max(ay, by) + reach))
        if not (len(columns) and len(rows)):
            continue
        px, py = x[:, columns] - ax, y[rows] - ay
        near = np.hypot(*_from_segment(px, py, bx - ax, by - ay))
        part = distance[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        np.minimum(part, np.where(near <= reach, near, np.inf), out=part)
    return distance
