"""Panels that are sewn into a tube, as a sleeve of one piece, are wrapped round the limb that they lie beside.

Such a panel lies flat before the limb, and both edges of its seam would be joined there, before it. So it is bent
round an axis instead, its seam on the far side: each height of it to a circle, as wide as the panel is there, or as the
limb is, whichever is more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_cloth.sewing.sew import Sewn
from nuno_kernels.meshes.loops import Loop, cut_mesh
from nuno_schemas.fabric import Float, Int

LEVELS = 24
"""Sections of the body, over the height of a panel, by which a limb is found."""


@dataclass(frozen=True)
class Frame:
    """A panel as it is placed: a point of it and its middle there [m], its directions across and along the tube in the
    panel's plane (2,), and with that out of the cloth in space (3,).
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
    """(m, 3) where cut vertices start [m] beside a body (v, 3), faces (f, 3): as they are placed, but for tubes."""
    placed = sewn.placed.copy()
    for panel in range(len(sewn.names)):
        for pairs in tubes(sewn, panel):
            own = np.unique(sewn.faces[sewn.panel == panel])
            frame = _frame(sewn, own, pairs)
            placed[own] = _bend(sewn, own, pairs, frame, body, faces, clearance)
    return placed


def tubes(sewn: Sewn, panel: int) -> list[Int]:
    """Pairs (k, 2) of cut vertices of each line along which a panel is sewn to itself from side to side: darts, whose
    two edges meet in a tip, are none.
    """
    name, lines = sewn.names[panel], list[Int]()
    for seam in sewn.seams:
        if seam.seam.one[0] == seam.seam.other[0] == name:
            ends = {frozenset(pair) for pair in seam.pairs[[0, -1]].tolist()}
            joined = [line for line in lines if ends & {frozenset(pair) for pair in line.tolist()}]
            lines = [line for line in lines if not any(line is one for one in joined)]
            lines.append(np.concatenate([seam.pairs, *joined]))
    return [line for line in lines if (line[:, 0] != line[:, 1]).all()]


def _frame(sewn: Sewn, own: Int, pairs: Int) -> Frame:
    flat, middle = sewn.flat[own].mean(axis=0), sewn.placed[own].mean(axis=0)
    way = sewn.flat[pairs[:, 1]] - sewn.flat[pairs[:, 0]]
    way *= np.where(way @ way[0] < 0.0, -1.0, 1.0)[:, None]
    across = way.sum(axis=0) / np.linalg.norm(way.sum(axis=0))
    turn = np.array([across, [-across[1], across[0]]])
    plane, *_ = np.linalg.lstsq((sewn.flat[own] - flat) @ turn.T, sewn.placed[own] - middle, rcond=None)
    return Frame(flat, middle, turn, np.concatenate([plane, np.cross(*plane)[None]]))


def _bend(sewn: Sewn, own: Int, pairs: Int, frame: Frame, body: Float, faces: Int, clearance: float) -> Float:
    """(k, 3) where the panel's own vertices (k,) are when it is bent round its limb [m]."""
    heights, ends = frame.along(sewn.flat[pairs].mean(axis=1)), frame.across(sewn.flat[pairs])
    order = heights.argsort()
    height, left, right = heights[order], ends.min(axis=1)[order], ends.max(axis=1)[order]
    along, across = frame.along(sewn.flat[own]), frame.across(sewn.flat[own])
    low, high = np.interp(along, height, left), np.interp(along, height, right)
    angle = np.pi * (2.0 * across - low - high) / (high - low)
    levels = np.linspace(along.min(), along.max(), LEVELS)
    narrowest = int(np.interp(levels, height, right - left).argmin())
    axis, reach = _limb(frame, levels, narrowest, body, faces)
    radius = np.maximum((high - low) / (2.0 * np.pi), np.interp(along, levels, reach) + clearance)
    over, up, out = frame.axes
    return np.asarray(
        axis + along[:, None] * up + (radius * np.sin(angle))[:, None] * over + (radius * np.cos(angle))[:, None] * out
    )


def _limb(frame: Frame, levels: Float, first: int, body: Float, faces: Int) -> tuple[Float, Float]:
    """A point (3,) of the axis of what a panel goes round, at its height 0, and how far it reaches from there at each
    level (l,) [m].

    At its narrowest, the first level, it goes round the part of the body that is next to it; from there on, up and
    down, round what begins within the part before: a skirt round both legs, and no arm.
    """
    up = frame.axes[1]
    heights = (body - frame.middle) @ up
    sections = [cut_mesh(body, faces, heights - level) for level in levels]
    reach = np.zeros(len(levels))
    nearby = sorted(range(len(levels)), key=lambda k: abs(k - first))
    first = next((k for k in nearby if sections[k]), -1)
    if first < 0:
        return frame.middle, reach
    here = frame.middle + levels[first] * up
    next_to = min(sections[first], key=lambda loop: float(np.linalg.norm(loop.points - here, axis=1).min()))
    centre = next_to.centroid()
    axis = centre - levels[first] * up

    def farthest(loops: list[Loop]) -> float:
        points = np.concatenate([loop.points for loop in loops]) - axis
        return float(np.linalg.norm(points - (points @ up)[:, None] * up, axis=1).max())

    def off(loop: Loop) -> float:
        way = loop.centroid() - axis
        return float(np.linalg.norm(way - (way @ up) * up))

    reach[first] = farthest([next_to])
    for step in (-1, 1):
        within = reach[first]
        for k in range(first + step, len(levels) if step > 0 else -1, step):
            inner = [loop for loop in sections[k] if off(loop) < within]
            reach[k] = within = farthest(inner) if inner else within
    return axis, reach
