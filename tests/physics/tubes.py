"""Closed tubes round a straight or bent axis."""

from __future__ import annotations

import math
from collections.abc import Callable

import closed_meshes as meshes
import numpy as np

from nuno_schemas.fabric import Float, Int

UP, ACROSS, DEEP = np.array([0.0, 1, 0]), np.array([1.0, 0, 0]), np.array([0.0, 0, 1])


def tube(
    rows: int, around: int, place: Callable[[float], tuple[Float, Float, Float]], radius: Callable[[float], float]
) -> tuple[Float, Int]:
    """A tube closed by fans: `place(s)` is the middle and two directions across, s from 0 to 1."""
    angle = 2 * np.pi * np.arange(around) / around
    rings, ends = [], []
    for s in np.linspace(0.0, 1.0, rows):
        middle, u, v = place(float(s))
        rings.append(middle + radius(float(s)) * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v))
        ends.append(middle)
    n = rows * around
    here, after = np.arange(around), (np.arange(around) + 1) % around
    first = np.stack([np.full(around, n), here, after], axis=1)
    last = np.stack([np.full(around, n + 1), n - around + after, n - around + here], axis=1)
    tube_faces = meshes.grid_faces(rows, around, False)
    x = np.concatenate([*rings, [ends[0], ends[-1]]])
    one_way = np.concatenate([tube_faces[:, ::-1], first, last]).astype(np.int32)
    return meshes.outward(x, one_way)


def straight(s: float) -> tuple[Float, Float, Float]:
    return s * UP, ACROSS, DEEP


def bent(s: float) -> tuple[Float, Float, Float]:
    """A quarter of a circle of radius 0.5 about the origin, in the plane of x and y."""
    out = np.array([math.cos(0.5 * math.pi * s), math.sin(0.5 * math.pi * s), 0.0])
    return 0.5 * out, out, DEEP
