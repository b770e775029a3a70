"""Distance and gradient of sampled distance fields (nuno_schemas.bodies) at any point.

A point's whole cell is found by division, its leaf by halving, and the eight corners of a leaf stand in 128
bytes: a sample reads two lines of the cache beside the few that lead there. Not chosen: bricks of cells with shared
corners, half as large, whose eight corners lie in four places; a gradient of the interpolated distance, which
needs no memory of its own but jumps between cells, and with it the friction of what slides over them.

Outside of its box a field is that of the box's nearest point, and so much longer as that is away.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numba import prange
from numpy.typing import NDArray

from nuno_geometry.poses import Index
from nuno_kernels import forced_inline, parallel_kernel, threads_available
from nuno_schemas.bodies import DistanceField
from nuno_schemas.fabric import Float, Int

BLOCK = 1024
"""points handled together"""
LOWEST, INVERSE, COUNT, FIRST = 0, 3, 4, 7
"""columns of `Fields.head`"""


class Fields(NamedTuple):
    """Several fields, one after the other.

    head    (q, 8) of each: lowest corner [m], 1 / edge of a whole cell [1/m], whole cells along x, y, z, where its
            whole cells begin in `child`
    child   (c,) int32 and corners (l, 32) float32: as in DistanceField, counted over all of them
    """

    head: Float
    child: Int
    corners: NDArray[np.float32]


Leaf = tuple[Index, float, float, float, float]


def join_fields(fields: Sequence[DistanceField]) -> Fields:
    """Return at least one field in the layout of the kernels."""
    cells = np.cumsum([0, *(len(field.child) for field in fields)])
    leaves = np.cumsum([0, *(len(field.corners) for field in fields)])
    return Fields(
        np.array([[*f.low, 1.0 / f.size, *f.shape, cells[k]] for k, f in enumerate(fields)], np.float64),
        np.concatenate(
            [np.where(f.child >= 0, f.child + cells[k], f.child - leaves[k]) for k, f in enumerate(fields)]
        ).astype(np.int32),
        np.ascontiguousarray(np.concatenate([field.corners for field in fields]), np.float32),
    )


@forced_inline
def clamp_to(value: float, most: float) -> float:
    """Clamp `value` to [0, most]; NaN to 0."""
    return min(value, most) if value > 0.0 else 0.0


@forced_inline
def find_leaf(px: float, py: float, pz: float, q: int, fields: Fields) -> Leaf:
    """Return (leaf, the point's place in it from 0 to 1 along x, y, z, and its distance from the box [m])."""
    head, child = fields.head, fields.child
    scale = head[q, 3]
    u, v, w = (px - head[q, 0]) * scale, (py - head[q, 1]) * scale, (pz - head[q, 2]) * scale
    nx, ny, nz = head[q, 4], head[q, 5], head[q, 6]
    x, y, z = clamp_to(u, nx), clamp_to(v, ny), clamp_to(w, nz)
    away = abs(u - x) + abs(v - y) + abs(w - z)
    if away > 0.0:
        away = ((u - x) * (u - x) + (v - y) * (v - y) + (w - z) * (w - z)) ** 0.5 / scale
    i, j, k = min(np.floor(x), nx - 1.0), min(np.floor(y), ny - 1.0), min(np.floor(z), nz - 1.0)
    x, y, z = x - i, y - j, z - k
    at = child[np.uint64(head[q, 7] + (i * ny + j) * nz + k)]
    while at >= 0:
        x, y, z = x + x, y + y, z + z
        a, b, c = x >= 1.0, y >= 1.0, z >= 1.0
        x, y, z = x - a, y - b, z - c
        at = child[np.uint64(at + 4 * a + 2 * b + c)]
    return np.uint64(-1 - at), x, y, z, away


@forced_inline
def blend(corners: NDArray[np.float32], leaf: Index, part: Index, x: float, y: float, z: float) -> float:
    """Interpolate trilinearly a quantity `part` of a leaf, 0 the distance and 1 to 3 the gradient."""
    row = corners[leaf]
    a = row[part] + z * (row[part + np.uint64(4)] - row[part])
    b = row[part + np.uint64(8)] + z * (row[part + np.uint64(12)] - row[part + np.uint64(8)])
    c = row[part + np.uint64(16)] + z * (row[part + np.uint64(20)] - row[part + np.uint64(16)])
    d = row[part + np.uint64(24)] + z * (row[part + np.uint64(28)] - row[part + np.uint64(24)])
    a, c = a + y * (b - a), c + y * (d - c)
    return float(a + x * (c - a))


@forced_inline
def sample_distance(px: float, py: float, pz: float, q: int, fields: Fields) -> float:
    """Return the distance [m] of a point from field q."""
    leaf, x, y, z, away = find_leaf(px, py, pz, q, fields)
    return blend(fields.corners, leaf, np.uint64(0), x, y, z) + away


@forced_inline
def sample(px: float, py: float, pz: float, q: int, fields: Fields) -> tuple[float, float, float, float]:
    """Return the distance [m] of a point from field q and the gradient there, interpolated: about of length 1."""
    leaf, x, y, z, away = find_leaf(px, py, pz, q, fields)
    corners = fields.corners
    return (
        blend(corners, leaf, np.uint64(0), x, y, z) + away,
        blend(corners, leaf, np.uint64(1), x, y, z),
        blend(corners, leaf, np.uint64(2), x, y, z),
        blend(corners, leaf, np.uint64(3), x, y, z),
    )


@parallel_kernel
def sample_points(points: Float, fields: Fields, out: Float) -> None:
    """Write out (n, 4): distance [m] and gradient at points (n, 3) of the first field, in parallel blocks."""
    for block in prange((points.shape[0] + BLOCK - 1) // BLOCK):
        for i in range(np.uint64(block * BLOCK), np.uint64(min((block + 1) * BLOCK, points.shape[0]))):
            d, gx, gy, gz = sample(points[i, 0], points[i, 1], points[i, 2], 0, fields)
            out[i, 0], out[i, 1], out[i, 2], out[i, 3] = d, gx, gy, gz


def sample_field(field: DistanceField, points: Float, threads: int | None = None) -> Float:
    """Return distance [m] and gradient, not of unit length between corners, (n, 4), at points (n, 3) [m].

    `threads`: all by default; the result has the same bits with any number.
    """
    points = np.ascontiguousarray(points, np.float64)
    out = np.empty((len(points), 4))
    available = threads_available()[0]
    numba.set_num_threads(max(1, min(threads or available, available)))
    sample_points(points, join_fields([field]), out)
    return out
