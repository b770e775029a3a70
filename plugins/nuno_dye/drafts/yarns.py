"""Yarns of a Weaving Information File: their colours, spacing and thickness, sparse or not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_dye.drafts.text import Entry, Section, Sections
from nuno_schemas.fabric import Float

UNITS = {
    "centimeters": 0.01, "centimeter": 0.01, "centimetres": 0.01, "cm": 0.01,
    "inches": 0.0254, "inch": 0.0254, "in": 0.0254,
    "decipoints": 0.0254 / 720, "decipoint": 0.0254 / 720,
}  # fmt: skip
"""Lengths [m]; a decipoint is a tenth of a point."""
UNDYED = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Yarns:
    """The yarns of one direction; arrays are None if the file lacks them.

    colour     (n, 3)  sRGB in [0, 1]
    spacing    (n,)    from the middle of a yarn's gap to the next one [m]
    thickness  (n,)    [m]
    colourless         whether it refers to colours that it does not define
    """

    colour: Float | None
    spacing: Float | None
    thickness: Float | None
    colourless: bool = False


def read_yarns(sections: Sections, name: str, number: int) -> Yarns:
    """Read colours, spacing and thickness of WARP or WEFT."""
    section = sections.get(name)
    units = section.get("UNITS")
    unit = UNITS.get(units.bare.lower()) if units else None
    if units and unit is None:
        units.refuse("an unknown unit", "centimeters, inches or decipoints")
    spacing, thickness = (
        None if unit is None else _read_lengths(section, sections.get(f"{name} {what}"), what, unit, number)
        for what in ("SPACING", "THICKNESS")
    )
    colour = _read_colours(sections, section, number)
    listed = [line for _, line in sections.get(f"{section.name} COLORS").numbered(number, "yarn", beyond=True)]
    coloured = [line for line in (section.get("COLOR"), *listed) if line and any(line.wholes(0, 10**9, "a colour"))]
    return Yarns(colour, spacing, thickness, bool(coloured) and colour is None)


def _read_lengths(section: Section, listed: Section, what: str, unit: float, number: int) -> Float | None:
    """Return lengths (number,) [m], where 0 is unknown, or None if a yarn has none."""
    default = section.get(what)
    values = np.full(number, default.real(f"a {what.lower()}") if default else 0.0)
    for key, line in listed.numbered(number, "yarn", beyond=True):
        values[key - 1] = (line.real(f"a {what.lower()}") if line.bare else 0.0) or values[key - 1]
    return values * unit if values.all() else None


def _read_colours(sections: Sections, section: Section, number: int) -> Float | None:
    """Return sRGB (number, 3) in [0, 1], or None without a colour table and written-out colours."""
    palette = Palette(sections)
    default = section.get("COLOR")
    listed = sections.get(f"{section.name} COLORS")
    default_colour = palette.find(default) if default else None
    colours = np.tile(np.array(default_colour or UNDYED), (number, 1))
    any_known = default_colour is not None
    for key, line in listed.numbered(number, "yarn", beyond=True):
        colour = palette.find(line)
        if colour is not None:
            colours[key - 1], any_known = colour, True
    return colours if any_known or palette.table else None


Colour = tuple[float, ...]


class Palette:
    """A file's colours by number, scaled from its range (0 to 255 by default) to [0, 1]."""

    def __init__(self, sections: Sections) -> None:
        """Read the table. Raises BadInput for an empty range and colours outside of it."""
        stated = sections.get("COLOR PALETTE").get("RANGE")
        limits = stated.wholes(0, 10**9, "a range of colours") if stated else [0, 255]
        bounds = [0, *limits] if len(limits) == 1 else limits
        if stated and not (len(bounds) == 2 and bounds[0] < bounds[1]):
            stated.refuse("not a range of colours", "two numbers, the smaller first, such as 0,255")
        self.low, self.high = bounds
        table = sections.get("COLOR TABLE")
        self.table = {key: self._scale(line, 0) for key, line in table.numbered(10**9, "colour") if line.bare}

    def find(self, line: Entry) -> Colour | None:
        """Return the colour that a line refers to by number, or writes out after it; None for 0. Raises BadInput."""
        numbers = line.wholes(0, 10**9, "a colour")
        if not numbers or (numbers[0] == 0 and len(numbers) == 1):
            return None
        if numbers[0] in self.table:
            return self.table[numbers[0]]
        if len(numbers) == 4:
            return self._scale(line, 1)
        if self.table:
            line.refuse("a colour that is not in [COLOR TABLE]", f"one of its {len(self.table)} colours")
        return None

    def _scale(self, line: Entry, start: int) -> Colour:
        values = line.wholes(0, 10**9, "a colour")[start:]
        if len(values) != 3 or not all(self.low <= value <= self.high for value in values):
            line.refuse("not a colour", f"three numbers from {self.low} to {self.high}, the palette's range")
        return tuple((value - self.low) / (self.high - self.low) for value in values)
