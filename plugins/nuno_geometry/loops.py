"""Sections of a closed mesh: the loops in which a plane, or a level of values on the vertices, cuts it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_schemas.fabric import Float, Int
from nuno_schemas.vectors import dot, norm


@dataclass(frozen=True)
class Loop:
    """A closed polygon in a section: its corners (k, 3) [m], each on an edge of the mesh.

    edges (k, 2) vertices of those edges
    """

    points: Float
    edges: Int

    @property
    def girth(self) -> float:
        """Return the length round it [m]."""
        return float(np.linalg.norm(self.points - np.roll(self.points, 1, axis=0), axis=1).sum())

    def centroid(self) -> Float:
        """Return the centroid (3,) of the enclosed area [m], by triangles about the mean of its corners.

        Independent of how the corners lie on the outline; the mean of the corners where there is no area.
        """
        middle = self.points.mean(axis=0)
        here, after = self.points - middle, np.roll(self.points, -1, axis=0) - middle
        areas = np.cross(here, after)
        normal = areas.sum(axis=0)
        size = float(dot(normal, normal))
        if size == 0.0:
            return np.asarray(middle)
        weight = dot(areas, normal) / size
        return np.asarray(middle + (weight[:, None] * (here + after)).sum(axis=0) / 3.0)


def cut_mesh(x: Float, faces: Int, value: Float) -> list[Loop]:
    """Return the loops in which the level 0 of values (n,) on the vertices cuts a closed mesh (n, 3), (f, 3).

    A vertex of value 0 counts as above, so that no loop ever passes through a vertex and each triangle that is
    cut joins just two cut edges.
    """
    above = value >= 0.0
    count = above[faces].sum(axis=1)
    cut = faces[(count == 1) | (count == 2)]
    if len(cut) == 0:
        return []
    ends = np.stack([cut, np.roll(cut, -1, axis=1)], axis=-1)
    crossing = above[ends[..., 0]] != above[ends[..., 1]]
    pairs = np.sort(ends[crossing], axis=-1).astype(np.int64)
    keys, number = np.unique(pairs[:, 0] * len(x) + pairs[:, 1], return_inverse=True)
    low, high = np.divmod(keys, len(x))
    share = value[low] / (value[low] - value[high])
    place = x[low] + share[:, None] * (x[high] - x[low])
    edges = np.stack([low, high], axis=1)
    return [Loop(place[order], edges[order]) for order in _chain(number.reshape(-1, 2))]


def _chain(links: Int) -> list[list[int]]:
    """Return closed chains of links (m, 2) between numbers with two links each; from the lowest number on."""
    neighbours: dict[int, list[int]] = {}
    for a, b in links.tolist():
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    chains, used = [], set()
    for first in sorted(neighbours):
        if first in used:
            continue
        chain, here, last = [first], neighbours[first][0], first
        used.add(first)
        while here != first:
            chain.append(here)
            used.add(here)
            one, other = neighbours[here]
            here, last = (other if one == last else one), here
        chains.append(chain)
    return chains


def section_about(x: Float, faces: Int, point: Float, normal: Float) -> Loop | None:
    """Return the loop that the plane through `point` (3,) across `normal` (3,) cuts round it; if none goes round it,
    that with the nearest middle, and None if the plane cuts nothing.
    """
    loops = cut_mesh(x, faces, dot(x - point, normal))
    if not loops:
        return None
    round_it = [loop for loop in loops if _goes_round(loop.points - point, normal)]
    return min(round_it or loops, key=lambda loop: float(norm(loop.centroid() - point)))


def _goes_round(points: Float, normal: Float) -> bool:
    """Whether a polygon in the plane across `normal` winds round the origin."""
    after = np.roll(points, -1, axis=0)
    unit = normal / norm(normal)
    angle = np.arctan2(dot(np.cross(points, after), unit), (points * after).sum(axis=1))
    return bool(abs(angle.sum()) > np.pi)
