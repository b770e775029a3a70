"""Closed meshes to test against, and distances to triangles found by brute force in another way."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Float, Int


def grid_faces(rows: int, columns: int, closed: bool) -> Int:
    """Triangles of a grid of vertices whose columns are closed, and whose rows are if `closed`."""
    last = rows if closed else rows - 1
    row, column = np.divmod(np.arange(last * columns), columns)
    a, b = row * columns + column, row * columns + (column + 1) % columns
    c, d = (row + 1) % rows * columns + column, (row + 1) % rows * columns + (column + 1) % columns
    return np.stack([a, b, c, b, d, c], axis=1).reshape(-1, 3).astype(np.int32)


def sphere(rings: int, radius: float = 1.0) -> tuple[Float, Int]:
    """A globe of `rings` rings of twice as many vertices, and two poles."""
    polar = np.pi * np.arange(1, rings + 1) / (rings + 1)
    around = np.pi * np.arange(2 * rings) / rings
    ring = np.stack(
        [
            np.sin(polar)[:, None] * np.cos(around),
            np.cos(polar)[:, None] + 0 * around,
            np.sin(polar)[:, None] * np.sin(around),
        ],
        axis=-1,
    )
    n, columns = rings * 2 * rings, 2 * rings
    here, after = np.arange(columns), (np.arange(columns) + 1) % columns
    north = np.stack([0 * here + n, after, here], axis=1)
    south = np.stack([0 * here + n + 1, n - columns + here, n - columns + after], axis=1)
    x = np.concatenate([ring.reshape(-1, 3), [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]])
    return outward(radius * x, np.concatenate([grid_faces(rings, columns, False), north, south]).astype(np.int32))


def torus(rows: int, columns: int, large: float = 1.0, small: float = 0.3) -> tuple[Float, Int]:
    """A ring about the y axis."""
    u, v = np.meshgrid(2 * np.pi * np.arange(rows) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij")
    out = large + small * np.cos(v)
    x = np.stack([out * np.cos(u), small * np.sin(v), out * np.sin(u)], axis=-1).reshape(-1, 3)
    return outward(x, grid_faces(rows, columns, True))


def box(size: tuple[float, float, float]) -> tuple[Float, Int]:
    """A box about the origin of twelve triangles."""
    x = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)]) * np.asarray(size)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return outward(x, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32))


def outward(x: Float, faces: Int) -> tuple[Float, Int]:
    """The mesh with its normals out of its volume, if it had them inwards."""
    a, b, c = (x[faces[:, k]] for k in range(3))
    volume = np.einsum("fi,fi->", a, np.cross(b, c))
    return x, (faces if volume > 0.0 else np.ascontiguousarray(faces[:, ::-1]))


def _to_segment(p: Float, a: Float, b: Float) -> Float:
    """(n, f) distances of points (n, 3) to segments (f, 3)."""
    along = b - a
    square = (along * along).sum(axis=1)
    s = ((p[:, None] - a) * along).sum(axis=-1) / np.where(square > 0.0, square, 1.0)
    foot = a + np.clip(s, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(p[:, None] - foot, axis=-1))


def brute_distance(p: Float, x: Float, faces: Int) -> Float:
    """(n, f) distances of points to every triangle: to its plane where the foot lies in it, else to its edges."""
    a, b, c = (x[faces[:, k]] for k in range(3))
    least = np.minimum(np.minimum(_to_segment(p, a, b), _to_segment(p, b, c)), _to_segment(p, c, a))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    unit = normal / np.where(length > 0.0, length, 1.0)[:, None]
    height = ((p[:, None] - a) * unit).sum(axis=-1)
    foot = p[:, None] - height[..., None] * unit
    inside = np.broadcast_to(length > 0.0, height.shape)
    for start, end in ((a, b), (b, c), (c, a)):
        inside = inside & ((np.cross(end - start, foot - start) * unit).sum(axis=-1) >= 0.0)
    return np.where(inside, np.abs(height), least)


def winding_number(p: Float, x: Float, faces: Int) -> Float:
    """(n,) solid angle of the mesh over 4 pi: 1 inside, 0 outside (van Oosterom & Strackee 1983)."""
    a, b, c = (x[faces[:, k]] - p[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    triple = (a * np.cross(b, c)).sum(axis=-1)
    bottom = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.asarray(2.0 * np.arctan2(triple, bottom).sum(axis=1) / (4.0 * np.pi))
