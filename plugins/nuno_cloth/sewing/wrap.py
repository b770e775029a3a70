"""Wrapping of panels that are sewn into a tube, such as a sleeve of one piece, round the limb next to them.

Such a panel lies flat before the limb, and both edges of its seam would be joined there, before it. So it is bent round
an axis instead, its seam on the far side: at each height to a circle as long as the panel is wide there, or round the
limb if that is wider.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_cloth.sewing.sew import Sewn
from nuno_geometry.section import Loop, cut_mesh
from nuno_schemas.fabric import Float, Int

LEVELS = 24
"""Sections of the body, over the height of a panel, in which a limb is searched."""


@dataclass(frozen=True)
class Frame:
    """The frame of a placed panel: its middle in `flat` (2,) and in space (3,) [m], the directions across and along the
    tube in the panel's plane (2, 2), and those and the normal in space (3, 3).
    """

    flat: Float
    middle: Float
    turn: Float
    axes: Float

    def across(self, flat: Float) -> Float:
        return np.asarray((flat - self.flat) @ self.turn[0])

    def along(self, flat: Float) -> Float:
        return np.asarray((flat - self.flat) @ self.turn[1])


def wrap(sewn: Sewn, body: Float, faces: Int, clearance: float) -> Float:
    """Return where cut vertices (m, 3) start [m] by a body (v, 3), faces (f, 3): as placed, but for tubes."""
    placed = sewn.placed.copy()
    for panel in range(len(sewn.names)):
        for pairs in tubes(sewn, panel):
            vertices = np.unique(sewn.faces[sewn.panel == panel])
            frame = _frame(sewn, vertices, pairs)
            placed[vertices] = _bend(sewn, vertices, pairs, frame, body, faces, clearance)
    return placed


def tubes(sewn: Sewn, panel: int) -> list[Int]:
    """Return pairs (k, 2) of cut vertices of each line along which a panel is sewn to itself from side to side. Darts,
    whose two edges meet in a tip, are left out.
    """
    name, lines = sewn.names[panel], list[Int]()
    for seam in sewn.seams:
        if seam.seam.one[0] == seam.seam.other[0] == name:
            ends = {frozenset(pair) for pair in seam.pairs[[0, -1]].tolist()}
            joined = [line for line in lines if ends & {frozenset(pair) for pair in line.tolist()}]
            lines = [line for line in lines if not any(line is one for one in joined)]
            lines.append(np.concatenate([seam.pairs, *joined]))
    return [line for line in lines if (line[:, 0] != line[:, 1]).all()]


def _frame(sewn: Sewn, vertices: Int, pairs: Int) -> Frame:
    flat, middle = sewn.flat[vertices].mean(axis=0), sewn.placed[vertices].mean(axis=0)
    across_seam = sewn.flat[pairs[:, 1]] - sewn.flat[pairs[:, 0]]
    across_seam *= np.where(across_seam @ across_seam[0] < 0.0, -1.0, 1.0)[:, None]
    across = across_seam.sum(axis=0) / np.linalg.norm(across_seam.sum(axis=0))
    turn = np.array([across, [-across[1], across[0]]])
    plane, *_ = np.linalg.lstsq((sewn.flat[vertices] - flat) @ turn.T, sewn.placed[vertices] - middle, rcond=None)
    return Frame(flat, middle, turn, np.concatenate([plane, np.cross(*plane)[None]]))


def _bend(sewn: Sewn, vertices: Int, pairs: Int, frame: Frame, body: Float, faces: Int, clearance: float) -> Float:
    """Return the places (k, 3) of a panel's vertices (k,) bent round its limb [m]."""
    heights, ends = frame.along(sewn.flat[pairs].mean(axis=1)), frame.across(sewn.flat[pairs])
    order = heights.argsort()
    height, left, right = heights[order], ends.min(axis=1)[order], ends.max(axis=1)[order]
    along, across = frame.along(sewn.flat[vertices]), frame.across(sewn.flat[vertices])
    low, high = np.interp(along, height, left), np.interp(along, height, right)
    angle = np.pi * (2.0 * across - low - high) / (high - low)
    levels = np.linspace(along.min(), along.max(), LEVELS)
    narrowest = int(np.interp(levels, height, right - left).argmin())
    axis, reach = _limb(frame, levels, narrowest, body, faces)
    radius = np.maximum((high - low) / (2.0 * np.pi), np.interp(along, levels, reach) + clearance)
    side, up, out = frame.axes
    return np.asarray(
        axis + along[:, None] * up + (radius * np.sin(angle))[:, None] * side + (radius * np.cos(angle))[:, None] * out
    )


def _limb(frame: Frame, levels: Float, first: int, body: Float, faces: Int) -> tuple[Float, Float]:
    """Return a point (3,) of the axis of a panel's limb, at height 0, and the limb's largest radius at each level (l,)
    [m].

    At its narrowest, the `first` level, it goes round the nearest part of the body; from there up and down round parts
    that begin within the previous one: a skirt round both legs, and no arm.
    """
    up = frame.axes[1]
    heights = (body - frame.middle) @ up
    sections = [cut_mesh(body, faces, heights - level) for level in levels]
    reach = np.zeros(len(levels))
    nearby = sorted(range(len(levels)), key=lambda k: abs(k - first))
    first = next((k for k in nearby if sections[k]), -1)
    if first < 0:
        return frame.middle, reach
    middle = frame.middle + levels[first] * up
    nearest = min(sections[first], key=lambda loop: float(np.linalg.norm(loop.points - middle, axis=1).min()))
    centre = nearest.centroid()
    axis = centre - levels[first] * up

    def farthest(loops: list[Loop]) -> float:
        points = np.concatenate([loop.points for loop in loops]) - axis
        return float(np.linalg.norm(points - (points @ up)[:, None] * up, axis=1).max())

    def off(loop: Loop) -> float:
        way = loop.centroid() - axis
        return float(np.linalg.norm(way - (way @ up) * up))

    reach[first] = farthest([nearest])
    for step in (-1, 1):
        bound = reach[first]
        for k in range(first + step, len(levels) if step > 0 else -1, step):
            inner = [loop for loop in sections[k] if off(loop) < bound]
            reach[k] = bound = farthest(inner) if inner else bound
    return axis, reach
