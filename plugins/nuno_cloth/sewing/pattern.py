"""Panels and the seams between their edges, in metres, and the topology of the sewn pattern."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from nuno_cloth.sewing.curves import Curve, area_under, length_of
from nuno_schemas.fabric import Float
from nuno_schemas.vectors import turn

# Panels, and the seams between their edges, in metres.

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


# Topology of a sewn pattern: merged corners, connected pieces, sides that face outwards, and openings.

Item = TypeVar("Item", bound=Hashable)


def group(items: Iterable[Item], pairs: Iterable[tuple[Item, Item]]) -> dict[Item, Item]:
    """Return for each item the first of its group of items that pairs connect."""
    parent = {item: item for item in items}
    order = {item: k for k, item in enumerate(parent)}

    def root(item: Item) -> Item:
        while parent[item] != item:
            parent[item] = parent[parent[item]]
            item = parent[item]
        return item

    for one, other in pairs:
        one, other = root(one), root(other)
        if one != other:
            low, high = sorted((one, other), key=order.__getitem__)
            parent[high] = low
    return {item: root(item) for item in parent}


def ends_of(pattern: Pattern, side: Side) -> tuple[Side, Side]:
    """Return the corners where an edge starts and ends; a corner is named by the edge that starts there."""
    panel, edge = side
    return side, (panel, (edge + 1) % len(pattern.panels[panel].edges))


def join_corners(pattern: Pattern) -> dict[Side, Side]:
    """Return for each corner the first of those that seams merge with it."""
    pairs = []
    for seam in pattern.seams:
        (start, end), (other_start, other_end) = ends_of(pattern, seam.one), ends_of(pattern, seam.other)
        pairs += (
            [(start, other_start), (end, other_end)] if seam.right_wrong else [(start, other_end), (end, other_start)]
        )
    corners = [(name, k) for name, panel in pattern.panels.items() for k in range(len(panel.edges))]
    return group(corners, pairs)


def find_pieces(pattern: Pattern) -> dict[str, str]:
    """Return for each panel the first of the piece that seams connect with it."""
    return group(pattern.panels, [(seam.one[0], seam.other[0]) for seam in pattern.seams])


def find_sides(pattern: Pattern) -> tuple[dict[str, bool], Seam | None]:
    """Return for each panel whether it is worn with its wrong side out, so that sides agree along all seams, and a seam
    along which they cannot, or None. Most cloth of a piece has its right side out.
    """
    inside: dict[str, bool] = {}
    neighbours: dict[str, list[tuple[str, Seam]]] = {name: [] for name in pattern.panels}
    for seam in pattern.seams:
        neighbours[seam.one[0]].append((seam.other[0], seam))
        neighbours[seam.other[0]].append((seam.one[0], seam))
    for first in pattern.panels:
        if first in inside:
            continue
        piece, inside[first] = [first], False
        for name in piece:
            for other, seam in neighbours[name]:
                if other not in inside:
                    inside[other] = inside[name] != seam.right_wrong
                    piece.append(other)
                elif inside[other] != (inside[name] != seam.right_wrong):
                    return inside, seam
        out = sum((-1.0 if inside[name] else 1.0) * abs(pattern.panels[name].area) for name in piece)
        if out < 0.0:
            inside.update({name: not inside[name] for name in piece})
    return inside, None


def find_openings(pattern: Pattern) -> list[list[Side]]:
    """Return the edges round each opening, in order: the next edge is found by going round the corner at the end of the
    last, from panel to panel, across seams.
    """
    partner = pattern.partner
    edges = [(name, k) for name, panel in pattern.panels.items() for k in range(len(panel.edges))]
    free = dict.fromkeys(side for side in edges if side not in partner)
    openings = []
    while free:
        side, way = next(iter(free)), 1
        opening: list[Side] = []
        while side in free:
            opening.append(side)
            del free[side]
            side = _next_edge(pattern, side, way)
            while side in partner:
                side, turned = partner[side]
                way = -way if turned else way
                side = _next_edge(pattern, side, way)
        openings.append(opening)
    return openings


def _next_edge(pattern: Pattern, side: Side, way: int) -> Side:
    return side[0], (side[1] + way) % len(pattern.panels[side[0]].edges)
