"""Rows of a picture of values on bodies: what each sample's ray meets first, and the value there."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import block_kernel, kernel
from nuno_render.rays.hits import make_buffers, meet_triangle
from nuno_render.rays.near import sum_near
from nuno_render.rays.surfaces import find_weights
from nuno_render.rays.worn import Skin
from nuno_render.sampling import place_sample, scramble
from nuno_render.sight import Sight, aim
from nuno_schemas.fabric import Float

COUNTS, MEANS, ON_VERTICES, ON_FACES = 0, 1, 2, 3
"""Which value a place has: how many points are near, the mean of theirs, its corners' or its face's."""
BACKGROUND = -np.inf


class Shown(NamedTuple):
    """Which value a place has, that of each vertex or face, and points with theirs as in nuno_render.rays.near."""

    mode: int
    on_surface: Float
    points: Float
    key: NDArray[np.int64]
    values: Float
    low: Float
    shape: NDArray[np.int64]
    reach: float


@kernel
def value_at(p: Float, face: int, weights: Any, skin: Skin, shown: Shown) -> Any:
    """The value at a point p (3,) of a face; NaN where nothing says any."""
    mode, values = shown.mode, shown.on_surface
    if mode == ON_FACES:
        return values[face]
    s, r = weights
    a, b, c = skin.faces[face, 0], skin.faces[face, 1], skin.faces[face, 2]
    if mode == ON_VERTICES:
        return (1.0 - s - r) * values[a] + s * values[b] + r * values[c]
    count, total = sum_near(p[0], p[1], p[2], shown)
    if mode == COUNTS:
        return float(count)
    return total / count if count > 0 else np.nan


@block_kernel
def map_rows(
    first: int, last: int, sight: Sight, grid: Any, light: Float, skin: Skin, shown: Shown, found: Float
) -> None:
    """Rows `first` to `last` of found (h, w, s, 2): value, and cosine of the smooth normal to the light (3,).

    grid: columns and rows of samples, and the seed.
    """
    eye = sight.eye
    columns, rows, seed = grid
    height, width = found.shape[0], found.shape[1]
    buffers = make_buffers(1)
    d, p, g = np.empty(3), np.empty(3), np.empty(3)
    x, normals = skin.x, skin.normals
    for row in range(first, last):
        for column in range(width):
            pattern = scramble(row * width + column, seed)
            for sample in range(columns * rows):
                sx, sy = place_sample(sample, columns, rows, pattern)
                aim(sight, column + sx, row + sy, width, height, d)
                face, t = meet_triangle(eye, d, skin.tree, buffers)
                found[row, column, sample, 0], found[row, column, sample, 1] = BACKGROUND, 0.0
                if face < 0:
                    continue
                a, b, c = skin.faces[face, 0], skin.faces[face, 1], skin.faces[face, 2]
                for k in range(3):
                    i, j = (k + 1) % 3, (k + 2) % 3
                    g[k] = (x[b, i] - x[a, i]) * (x[c, j] - x[a, j]) - (x[b, j] - x[a, j]) * (x[c, i] - x[a, i])
                    p[k] = eye[k] + t * d[k]
                s, r, _ = find_weights(p, g, x, a, b, c)
                cosine, norm = 0.0, 1e-300
                for k in range(3):
                    n = (1.0 - s - r) * normals[a, k] + s * normals[b, k] + r * normals[c, k]
                    cosine += n * light[k]
                    norm += n * n
                found[row, column, sample, 0] = value_at(p, face, (s, r), skin, shown)
                found[row, column, sample, 1] = cosine / np.sqrt(norm)
