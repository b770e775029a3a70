"""Into how many sides each edge of a pattern is parted: as many on both sides of a seam, by the longer of the two."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from nuno_cloth.sewing.curves import area_under, draw, turning_of
from nuno_cloth.sewing.joined import ends_of, join_corners
from nuno_cloth.sewing.pattern import Pattern, Side
from nuno_schemas.fabric import Float

ACCURATE = 1e-3
"""A panel's triangles are as large in all as the panel, but for this share of it at most."""
AIMED = 0.9 * ACCURATE
TURNS = np.pi / 3.0
"""A side stands for a turn of this at most [rad]."""
BENT = 0.15
"""Edges that turn more than this [rad] have a point between their ends: one side alone would be 0.1 % too short."""


@dataclass
class Drawn:
    """An edge's polygon (n + 1, 2) [m], and the area between it and the curve [m^2], more than 0 to the right of it."""

    points: Float
    excess: float


def draw_edges(pattern: Pattern, spacing: float) -> dict[Side, Drawn]:
    """Each edge as a polygon of about `spacing` [m] a side, as long as the edge; in a seam both have as many sides.

    Where the polygons of a panel enclose another area than its curves do, curves are parted more finely.
    """
    number, partner = _numbers(pattern, spacing), pattern.partner
    drawn = {side: _draw(pattern, side, n) for side, n in number.items()}
    # A curve that is parted anew for one panel changes the panel that it is sewn to, which may have been right before.
    while off := _find_off(pattern, drawn):
        for side in off:
            for one in (side, partner[side][0]) if side in partner else (side,):
                number[one] += 1 + number[one] // 4
                drawn[one] = _draw(pattern, one, number[one])
    return drawn


def _find_off(pattern: Pattern, drawn: dict[Side, Drawn]) -> list[Side]:
    """Of each panel whose polygons enclose another area the edge that is most to blame."""
    off = []
    for name, panel in pattern.panels.items():
        sides = [(name, k) for k in range(len(panel.edges))]
        excess = sum(drawn[side].excess for side in sides)
        if abs(excess) > AIMED * abs(panel.area):
            off.append(max(sides, key=lambda side: float(np.sign(excess)) * drawn[side].excess))
    return off


def _draw(pattern: Pattern, side: Side, n: int) -> Drawn:
    edge = pattern.edge(side)
    points = draw(edge.curve, n)
    (x, y), (dx, dy) = points[:-1].T, np.diff(points, axis=0).T
    return Drawn(points, float(0.5 * (x * dy - y * dx).sum()) - area_under(edge.curve))


def _numbers(pattern: Pattern, spacing: float) -> dict[Side, int]:
    """Of each edge by its length and turn; no two sides may come to join the same two corners once seams are sewn."""
    number = {}
    for name, panel in pattern.panels.items():
        for k, edge in enumerate(panel.edges):
            turning = turning_of(edge.curve)
            least = max(1 if turning < BENT else 2, int(np.ceil(turning / TURNS)))
            number[name, k] = max(least, round(edge.length / spacing))
    corner = join_corners(pattern)
    ends = {side: tuple(sorted(corner[end] for end in ends_of(pattern, side))) for side in number}
    for seam in pattern.seams:
        number[seam.one] = number[seam.other] = max(number[seam.one], number[seam.other])
    second = {seam.other for seam in pattern.seams}
    shared = Counter(ends[side] for side in number if side not in second)
    for side in number:
        low, high = ends[side]
        number[side] = max(number[side], 3 if low == high else 2 if shared[ends[side]] > 1 else 1)
    return number
