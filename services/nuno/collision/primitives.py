"""Meshes of primitives, by which bodies are drawn.

Weighed: trimesh's capsule and box, whose import takes a second that a run with a viewer waits for at its first frame.
"""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Float, Int

AROUND, RINGS = 24, 6
"""Vertices round a capsule, and rings on each of its caps."""


def _frame_along(direction: Float) -> Float:
    """(3, 3) rotation whose second column is `direction` (any length, y where it is 0)."""
    length = float(np.linalg.norm(direction))
    y = direction / length if length > 0.0 else np.array([0.0, 1.0, 0.0])
    helper = np.eye(3)[int(np.argmin(np.abs(y)))]
    x = np.cross(helper, y)
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _grid_faces(rows: int, columns: int) -> Int:
    """Triangles of a tube of `rows` rings, its columns closed, seen from outside."""
    row, column = np.divmod(np.arange((rows - 1) * columns), columns)
    a, b = row * columns + column, row * columns + (column + 1) % columns
    c, d = a + columns, b + columns
    return np.stack([a, c, b, b, c, d], axis=1).reshape(-1, 3).astype(np.int32)


def capsule_mesh(a: Float, b: Float, radius: float) -> tuple[Float, Int]:
    """A closed capsule (a sphere where a = b): rings from pole to pole, all vertices on it."""
    latitude = np.concatenate([np.linspace(-0.5, 0.0, RINGS + 1), np.linspace(0.0, 0.5, RINGS + 1)])[1:-1] * np.pi
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    ring = radius * np.cos(latitude)[:, None, None] * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=-1)
    ring[:, :, 1] = radius * np.sin(latitude)[:, None]
    centre = np.where((np.arange(latitude.size) <= RINGS - 1)[:, None], a, b)
    turn = _frame_along(b - a)
    body = (ring @ turn.T + centre[:, None]).reshape(-1, 3)
    poles = np.stack([a - radius * turn[:, 1], b + radius * turn[:, 1]])
    tube, n = _grid_faces(latitude.size, AROUND), body.shape[0]
    here = np.arange(AROUND)
    after, top = (here + 1) % AROUND, n - AROUND
    south = np.stack([np.full(AROUND, n), here, after], axis=1)
    north = np.stack([np.full(AROUND, n + 1), top + after, top + here], axis=1)
    return np.concatenate([body, poles]), np.concatenate([tube, south, north]).astype(np.int32)


def box_mesh(centre: Float, half: Float) -> tuple[Float, Int]:
    """The eight corners and twelve triangles of a box."""
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    faces = [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]  # fmt: skip
    return centre + corner * half, np.array(faces, np.int32)


def plane_mesh(point: Float, normal: Float, size: float) -> tuple[Float, Int]:
    """A square patch of edge `size` [m] round a point of the plane, facing along its normal."""
    turn = _frame_along(normal)
    corner = 0.5 * size * np.array([[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])
    return point + corner @ turn.T, np.array([[0, 2, 1], [0, 3, 2]], np.int32)
