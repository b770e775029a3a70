"""Division of a pattern's edges into sides, equally many in both edges of a seam, by the longer of the two."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from nuno_cloth.sewing.curves import area_under, draw, turning_of
from nuno_cloth.sewing.joined import ends_of, join_corners
from nuno_cloth.sewing.pattern import Pattern, Side
from nuno_schemas.fabric import Float

ACCURATE = 1e-3
"""Largest error of the total area of a panel's triangles, as a share of the panel's."""
AIMED = 0.9 * ACCURATE
TURNS = np.pi / 3.0
"""Largest turn of a curve along one side [rad]."""
BENT = 0.15
"""Edges that turn more than this [rad] have a point between their ends: one side alone would be 0.1 % too short."""


@dataclass
class EdgePolygon:
    """An edge's polygon (n + 1, 2) [m], and the area between it and the curve [m^2], positive on the right of it."""

    points: Float
    excess: float


def draw_edges(pattern: Pattern, spacing: float) -> dict[Side, EdgePolygon]:
    """Return each edge as a polygon of about `spacing` [m] a side, as long as the edge, with equally many sides in a
    seam. Curves of a panel whose polygons enclose another area than its curves are divided more finely.
    """
    number, partner = _numbers(pattern, spacing), pattern.partner
    drawn = {side: _draw(pattern, side, n) for side, n in number.items()}
    # A finer division of a curve for one panel changes the panel that it is sewn to, which may have been right before.
    while inaccurate := _find_inaccurate(pattern, drawn):
        for side in inaccurate:
            for one in (side, partner[side][0]) if side in partner else (side,):
                number[one] += 1 + number[one] // 4
                drawn[one] = _draw(pattern, one, number[one])
    return drawn


def _find_inaccurate(pattern: Pattern, drawn: dict[Side, EdgePolygon]) -> list[Side]:
    """Return, for each panel whose polygons enclose another area, the edge with the largest error."""
    inaccurate = []
    for name, panel in pattern.panels.items():
        sides = [(name, k) for k in range(len(panel.edges))]
        excess = sum(drawn[side].excess for side in sides)
        if abs(excess) > AIMED * abs(panel.area):
            inaccurate.append(max(sides, key=lambda side: float(np.sign(excess)) * drawn[side].excess))
    return inaccurate


def _draw(pattern: Pattern, side: Side, n: int) -> EdgePolygon:
    edge = pattern.edge(side)
    points = draw(edge.curve, n)
    (x, y), (dx, dy) = points[:-1].T, np.diff(points, axis=0).T
    return EdgePolygon(points, float(0.5 * (x * dy - y * dx).sum()) - area_under(edge.curve))


def _numbers(pattern: Pattern, spacing: float) -> dict[Side, int]:
    """Return each edge's number of sides, by its length and turn; no two sides may connect the same sewn corners."""
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
