"""Values that the viewer can colour cloth by: their scales, colours and legends."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.colour import CONTROL, MISSING, parse_hex, to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

DIVERGING = ("#2166ac", "#67a9cf", "#d1e5f0", "#f6f1e6", "#fddbc7", "#ef8a62", "#b2182b")
"""Equally spaced colours of values of both signs, after ColorBrewer's RdBu."""
SHARE = 99.0
"""A scale ends at this percentile of a frame's values [%]: the largest values are those of single points, such as pins,
and grow without limit as a mesh is refined.
"""
WIDTH, HEIGHT = 1200, 110
"""Size of a legend [pixels]."""
SIDE, TOP, BOTTOM = 90, 12, 56
"""Margin of a legend's bar on both sides, its first row, and the row below it [pixels]."""
FONT, INK, TICKS = 30, (40, 44, 52), 4
ROUND = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
BACKGROUND = (226, 230, 234)


@dataclass(frozen=True)
class Quantity:
    """What a field shows: its title with a unit, how many of these units an SI unit is, whether values have both
    signs, and the least end of its scale [SI], which keeps rounding errors pale.
    """

    title: str
    factor: float
    least: float
    signed: bool = False


QUANTITIES = {
    "stretch": Quantity("Stretch of the most stretched thread [%]", 100.0, 1e-3),
    "curvature": Quantity("Mean curvature [1/m], red where the front is convex", 1.0, 1.0, signed=True),
    "tension": Quantity("Tension along the yarns [mN]", 1e3, 1e-5),
    "nearness": Quantity("How much nearer to cloth than its thickness [mm]", 1e3, 1e-5),
    "pressure": Quantity("Pressure on bodies [Pa]", 1.0, 1.0),
    "difference": Quantity("Distance from the first recording [mm]", 1e3, 1e-5),
}
"""Fields by name, in the order of their tabs. Stretch is that of the springs at a vertex; of a net, of each link."""


class Scale:
    """The linear colour scale of one quantity: from 0, or from -end for values of both signs, to its end, which grows
    with the values and is a round number. Values beyond have the colour of the end.
    """

    def __init__(self, quantity: Quantity) -> None:
        self.quantity, self.end = quantity, quantity.least
        stops = np.array([list(bytes.fromhex(c[1:])) for c in (DIVERGING if quantity.signed else CONTROL)], np.float64)
        knots = np.linspace(0.0, 1.0, len(stops))
        table = np.stack([np.interp(np.linspace(0.0, 1.0, 256), knots, stops[:, i]) for i in range(3)], axis=1)
        self.table = np.round(table).astype(np.uint8)
        """(256, 3) sRGB."""
        packed = self.table.astype(np.uint32)
        self._packed = packed[:, 0] << 24 | packed[:, 1] << 16 | packed[:, 2] << 8 | 255

    def widen(self, values: Float) -> bool:
        """Reach up to the values (n,) [SI] of a frame, but for the largest; return whether the end has moved."""
        finite = np.abs(values[np.isfinite(values)])
        end = round_up(float(np.percentile(finite, SHARE))) if len(finite) else 0.0
        self.end, before = max(self.end, end), self.end
        return self.end > before

    def paint(self, values: Float) -> NDArray[np.uint32]:
        """Return opaque colours (n,) as 0xRRGGBBAA of values (n,) [SI]; NaN is grey."""
        low = -self.end if self.quantity.signed else 0.0
        share = (values - low) / (self.end - low)
        place = np.round(255.0 * np.clip(np.nan_to_num(share), 0.0, 1.0)).astype(int)
        return np.asarray(np.where(np.isnan(values), GREY, self._packed[place]), np.uint32)

    def ticks(self) -> list[tuple[float, str]]:
        """Return (share of the bar's length, label) of each tick, ascending."""
        low = -self.end if self.quantity.signed else 0.0
        values = np.linspace(low, self.end, TICKS + 1) * self.quantity.factor
        return [(i / TICKS, f"{value:.4g}") for i, value in enumerate(values)]

    def legend(self) -> NDArray[np.uint8]:
        """Return the picture (HEIGHT, WIDTH, 3) sRGB of the scale as a bar with its ticks."""
        from PIL import Image, ImageDraw, ImageFont

        picture = np.empty((HEIGHT, WIDTH, 3), np.uint8)
        picture[:] = BACKGROUND
        picture[TOP:BOTTOM, SIDE:-SIDE] = self.table[np.linspace(0.0, 255.0, WIDTH - 2 * SIDE).round().astype(int)]
        image = Image.fromarray(picture)
        draw, font = ImageDraw.Draw(image), ImageFont.load_default(FONT)
        for share, label in self.ticks():
            x = SIDE + round(share * (WIDTH - 2 * SIDE - 1))
            draw.line((x, BOTTOM, x, BOTTOM + 10), INK, 3)
            draw.text((x, BOTTOM + 14), label, INK, font, anchor="mt")
        return np.asarray(image)


def pack(linear: Float) -> NDArray[np.uint32]:
    """Convert linear light (n, 3) to opaque sRGB as 0xRRGGBBAA, shape (n,)."""
    byte = np.round(255.0 * to_srgb(linear)).astype(np.uint32).reshape(-1, 3)
    return np.asarray(byte[:, 0] << 24 | byte[:, 1] << 16 | byte[:, 2] << 8 | 255, np.uint32)


GREY = pack(parse_hex(MISSING))[0]
"""Colour of values that are not numbers."""


def round_up(value: float) -> float:
    """Return the least of ROUND times powers of ten that is not below a positive value; 0 for any other."""
    if not value > 0.0:
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in ROUND if step * power >= value * (1.0 - 1e-12))


def mean_curvature(x: Float, faces: Int, normals: Float) -> Float:
    """Return the mean curvature (n,) [1/m] at vertices x (n, 3) [m] with unit normals (n, 3): positive where they point
    out of a bulge, 1 / r on a sphere of radius r; NaN at vertices without a triangle.

    The discrete Laplacian with cotangent weights (Meyer and others, 2003), with a third of each triangle's area.
    """
    number = len(x)
    corners = x[faces]
    laplacian, area = np.zeros((3, number)), np.zeros(number)
    with np.errstate(invalid="ignore", divide="ignore"):
        twice = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            side = corners[:, k] - corners[:, j]
            cotangent = ((corners[:, j] - corners[:, i]) * (corners[:, k] - corners[:, i])).sum(axis=1) / twice
            pull = np.nan_to_num(0.5 * cotangent[:, None] * side, posinf=0.0, neginf=0.0)  # triangles without an area
            for axis in range(3):
                laplacian[axis] += np.bincount(faces[:, j], pull[:, axis], number)
                laplacian[axis] -= np.bincount(faces[:, k], pull[:, axis], number)
            area += np.bincount(faces[:, i], twice / 6.0, number)
        return np.asarray(-0.5 * (laplacian.T * normals).sum(axis=1) / area)


def require_field(colour: str, fields: Collection[str]) -> None:
    """Raise BadInput for a field that is to be seen first and is not among those that a recording has."""
    if colour in QUANTITIES and colour not in fields:
        limit = ", ".join(["auto", "cloth", *ordered(list(fields))])
        raise BadInput(f"the recording has no {colour} to show", field="--colour", value=colour, limit=limit)


def ordered(names: Sequence[str]) -> list[str]:
    """Return names of fields in the order of their tabs."""
    return [name for name in QUANTITIES if name in names]
