"""Measures of the membrane besides its force: energy, stretch, the largest force, work of turning."""

from __future__ import annotations

import math

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.forces.energy import edge
from nuno_kernels.forces.membrane import MembraneLists
from nuno_kernels.lanes.triples import dot, plus, times
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import Measured
from nuno_schemas.fabric import Float

Point = tuple[float, float, float]


@kernel
def yarns_of(lists: MembraneLists, x: Float, c: int) -> tuple[Point, Point]:
    """Return F_w and F_f of the triangle in column c, or of other arrays (3, n), linear in its corners."""
    corners, constants = lists.corners, lists.constants
    d1, d2 = edge(x, corners[0, c], corners[1, c]), edge(x, corners[0, c], corners[2, c])
    warp = plus(times(constants[0, c], d1), times(constants[1, c], d2))
    return warp, plus(times(constants[2, c], d1), times(constants[3, c], d2))


@kernel
def stress_of(lists: MembraneLists, c: int, warp: float, weft: float) -> Point:
    """Return A S_w, A S_f [N m] and A G of the triangle in column c, whose yarns have these lengths."""
    k = lists.constants
    e, f = warp - 1.0, weft - 1.0
    return k[4, c] * e + k[6, c] * f, k[5, c] * f + k[6, c] * e, k[7, c]


@kernel
def is_home(lists: MembraneLists, block: int, c: int, vertices: int) -> bool:
    """Whether column c holds a triangle, and the block has its first vertex: so each counts once."""
    width = min(BLOCK, vertices - block * BLOCK)
    return bool(lists.corners[0, c] != lists.corners[1, c] and lists.corners[3, c] < width)


@kernel
def measure_membrane(lists: MembraneLists, x: Float) -> Measured:
    """Return energy, the largest stretch in any direction, and the shortest side of any triangle."""
    energy, stretch, shortest = 0.0, -1.0, math.inf
    for block in range(lists.start.shape[0] - 1):
        for c in range(lists.start[block], lists.start[block + 1]):
            if not is_home(lists, block, c, x.shape[1]):
                continue
            warp, weft = yarns_of(lists, x, c)
            ww, ff, wf = dot(warp, warp), dot(weft, weft), dot(warp, weft)
            long, wide = math.sqrt(ww), math.sqrt(ff)
            s = stress_of(lists, c, long, wide)
            energy += 0.5 * (s[0] * (long - 1.0) + s[1] * (wide - 1.0) + s[2] * wf * wf)
            largest = 0.5 * (ww + ff) + math.sqrt(0.25 * (ww - ff) * (ww - ff) + wf * wf)
            stretch = max(stretch, math.sqrt(largest) - 1.0)
            for k in range(3):
                side = edge(x, lists.corners[k, c], lists.corners[(k + 1) % 3, c])
                square = dot(side, side)
                if square > 0.0:
                    shortest = min(shortest, math.sqrt(square))
    return Measured(energy, stretch, shortest)


@kernel
def tension_of_membrane(lists: MembraneLists, x: Float) -> float:
    """Return the largest force [N] of any triangle on a corner."""
    largest, k = 0.0, lists.constants
    for c in range(lists.corners.shape[1]):
        warp, weft = yarns_of(lists, x, c)
        ww, ff, wf = dot(warp, warp), dot(weft, weft), dot(warp, weft)
        long, wide = math.sqrt(ww), math.sqrt(ff)
        s = stress_of(lists, c, long, wide)
        along, across = (s[0] / long if long > 0.0 else 0.0), (s[1] / wide if wide > 0.0 else 0.0)
        on_warp = plus(times(along, warp), times(s[2] * wf, weft))
        on_weft = plus(times(across, weft), times(s[2] * wf, warp))
        first = plus(times(k[0, c], on_warp), times(k[2, c], on_weft))
        second = plus(times(k[1, c], on_warp), times(k[3, c], on_weft))
        total = plus(first, second)
        largest = max(largest, dot(first, first), dot(second, second), dot(total, total))
    return math.sqrt(largest)


@kernel
def turned_further(length: float, before: Point, now: Point) -> float:
    """Return how much longer a yarn of this length is than a linear step from `before` predicts."""
    square = dot(before, before)
    return length - dot(before, now) / math.sqrt(square) if square > 0.0 else 0.0


@kernel
def turning_of_membrane(lists: MembraneLists, x0: Float, x: Float, d: Float) -> float:
    """Return work along d (3, n) of the stress that yarns got by turning on their way from x0 to x [J]."""
    total, k = 0.0, lists.constants
    for block in range(lists.start.shape[0] - 1):
        for c in range(lists.start[block], lists.start[block + 1]):
            if not is_home(lists, block, c, x.shape[1]):
                continue
            (warp, weft), (warp0, weft0), moved = yarns_of(lists, x, c), yarns_of(lists, x0, c), yarns_of(lists, d, c)
            long, wide = math.sqrt(dot(warp, warp)), math.sqrt(dot(weft, weft))
            e, f = turned_further(long, warp0, warp), turned_further(wide, weft0, weft)
            if long > 0.0:
                total += (k[4, c] * e + k[6, c] * f) * dot(warp, moved[0]) / long
            if wide > 0.0:
                total += (k[5, c] * f + k[6, c] * e) * dot(weft, moved[1]) / wide
    return total


def stiffest(lists: MembraneLists) -> float:
    """Return the greatest stiffness of any triangle for one of its corners [N/m]."""
    k = lists.constants
    shares = np.stack([k[:2], k[2:4]])
    squares = np.square(np.concatenate([shares, shares.sum(axis=1, keepdims=True)], axis=1)).max(axis=1, initial=0.0)
    return float((k[4] * squares[0] + k[5] * squares[1] + k[7] * (squares[0] + squares[1])).max(initial=0.0))
