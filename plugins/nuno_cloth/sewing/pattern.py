"""Panels, and the seams between their edges, in metres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nuno_cloth.sewing.curves import Curve, area_under, length_of
from nuno_schemas.fabric import Float
from nuno_schemas.vectors import turn

Side = tuple[str, int]
"""A panel's name, and the number of one of its edges."""


def name_of(side: Side) -> str:
    return f"{side[0]}[{side[1]}]"


@dataclass(frozen=True)
class Edge:
    """A side of a panel, from one corner to the next: a curve in the panel's plane [m]."""

    curve: Curve
    label: str | None = None

    @cached_property
    def length(self) -> float:
        """Length [m]."""
        return length_of(self.curve)

    def ends(self) -> Float:
        """Return the points (2, 2) where it starts and ends [m]."""
        return self.curve.at(np.array([0.0, 1.0]))


@dataclass(frozen=True)
class Panel:
    """A piece of cloth, cut along its edges, which go round it in order.

    Seen from its right side, which is worn outside, they go round counter-clockwise: a panel that is drawn clockwise
    shows its wrong side in the drawing.

    rotation (3, 3) and translation (3,) [m] place it by the body; grain is the direction (2,) of its warp as drawn.
    """

    name: str
    edges: tuple[Edge, ...]
    rotation: Float
    translation: Float
    grain: Float
    label: str | None = None

    @cached_property
    def area(self) -> float:
        """Signed area as drawn, positive if counter-clockwise [m^2]."""
        return sum(area_under(edge.curve) for edge in self.edges)

    def place(self, drawn: Float) -> Float:
        """Return where points (n, 2) of the drawing start (n, 3) [m]."""
        level = np.concatenate([drawn, np.zeros((len(drawn), 1))], axis=1)
        return turn(self.rotation, level) + self.translation


@dataclass(frozen=True)
class Seam:
    """Two edges that are sewn together: the start of one meets the end of the other, or its start if the right side of
    one panel continues in the wrong side of the other.

    `stitch` is its number in the file.
    """

    one: Side
    other: Side
    right_wrong: bool = False
    stitch: int = 0

    @property
    def sides(self) -> tuple[Side, Side]:
        return self.one, self.other

    @property
    def names(self) -> str:
        return ", ".join(map(name_of, self.sides))


@dataclass(frozen=True)
class Pattern:
    """Panels by name, in the file's order, and seams; an edge is in at most one seam."""

    panels: Mapping[str, Panel]
    seams: tuple[Seam, ...]

    def edge(self, side: Side) -> Edge:
        return self.panels[side[0]].edges[side[1]]

    @cached_property
    def partner(self) -> Mapping[Side, tuple[Side, bool]]:
        """For each sewn edge its partner, and whether right is sewn to wrong."""
        both = [(seam.one, seam.other, seam.right_wrong) for seam in self.seams]
        return {a: (b, right_wrong) for one, other, right_wrong in both for a, b in ((one, other), (other, one))}
