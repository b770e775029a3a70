"""A net's springs as thin tubes, so that a renderer of triangles can show it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Float, Int

SIDES = 6
THICKNESS = 0.004
"""Radius of a tube, as part of the net's extent."""


def tubes(x: Float, edges: Int) -> tuple[Float, Int, NDArray[np.int64]]:
    """Open tubes along edges (e, 2) between points x (n, 3) [m].

    Returns vertices (12 e, 3), faces (12 e, 3) counter-clockwise seen from outside, and the
    point (12 e,) whose colour each vertex takes.
    """
    finite = x[np.isfinite(x).all(axis=1)]
    extent = float(np.ptp(finite, axis=0).max()) if len(finite) else 0.0
    start, end = x[edges[:, 0]], x[edges[:, 1]]
    axis = end - start
    helper = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    u = _unit(np.cross(helper, axis))
    v = _unit(np.cross(axis, u))
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * v[:, None]
    ring *= THICKNESS * (extent or 1.0)
    vertices = np.stack([start[:, None] + ring, end[:, None] + ring], axis=1).reshape(-1, 3)
    side = np.arange(SIDES)
    after = (side + 1) % SIDES
    pattern = np.concatenate(
        [np.stack([side, after, side + SIDES], axis=1), np.stack([after, after + SIDES, side + SIDES], axis=1)]
    )
    faces = (pattern[None] + 2 * SIDES * np.arange(len(edges))[:, None, None]).reshape(-1, 3).astype(np.int32)
    return vertices, faces, np.repeat(edges, SIDES, axis=1).reshape(-1).astype(np.int64)


def _unit(vectors: Float) -> Float:
    length = np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0))
