"""Topology of a sewn pattern: merged corners, connected pieces, sides that face outwards, and openings."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import TypeVar

from nuno_cloth.sewing.pattern import Pattern, Seam, Side

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
