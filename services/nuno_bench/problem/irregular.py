"""Irregular triangles: a level square of cloth whose vertices lie in no rows, and files of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay

from nuno_schemas.fabric import Float, Int

STRAY = 0.3
"""Vertices inside are this part of a spacing off the grid at most, along each axis."""


def irregular_square(side: int, size: float, seed: int) -> tuple[Float, Int]:
    """(n, 3) vertices [m] of a square of so many vertices a side, its middle at the origin and its outside up, and its
    Delaunay triangles (f, 3): edges of 0.4 to about 2 spacings.
    """
    rng, spacing = np.random.default_rng(seed), size / (side - 1)
    across = spacing * np.arange(side) - 0.5 * size
    grid = np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1)
    grid[1:-1, 1:-1] += spacing * rng.uniform(-STRAY, STRAY, (side - 2, side - 2, 2))
    flat = grid.reshape(-1, 2)
    faces = Delaunay(flat).simplices.astype(np.int32)
    (ax, ay), (bx, by) = ((flat[faces[:, k]] - flat[faces[:, 0]]).T for k in (1, 2))
    faces = np.where((ax * by < ay * bx)[:, None], faces, faces[:, ::-1])
    return np.ascontiguousarray(np.insert(flat, 1, 0.0, axis=1)), np.ascontiguousarray(faces)


def write_obj(path: Path, x: Float, faces: Int) -> None:
    """Vertices (n, 3), with all their digits, and triangles (f, 3)."""
    lines = [f"v {a!r} {b!r} {c!r}" for a, b, c in x.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
