"""Rows of a picture of values on bodies: what each sample's ray meets first, and the value there."""

from __future__ import annotations

import numpy as np

from nuno_render.compiled import kernel
from nuno_render.rays.hits import DEPTH, meet_triangle
from nuno_render.rays.near import sum_near
from nuno_render.rays.surfaces import find_weights
from nuno_render.sampling import place_sample, scramble
from nuno_render.sight import aim

# mypy: disable-error-code="no-untyped-def"

COUNTS, MEANS, ON_VERTICES, ON_FACES = 0, 1, 2, 3
"""Which value a place has: how many points are near, the mean of theirs, its corners' or its face's."""
BACKGROUND = -np.inf


@kernel
def value_at(p, face, weights, skin, mode, values, cells):
    """The value at a point p (3,) of a face; NaN where nothing says any."""
    if mode == ON_FACES:
        return values[face]
    s, r = weights
    a, b, c = skin.faces[face, 0], skin.faces[face, 1], skin.faces[face, 2]
    if mode == ON_VERTICES:
        return (1.0 - s - r) * values[a] + s * values[b] + r * values[c]
    count, total = sum_near(p[0], p[1], p[2], cells)
    if mode == COUNTS:
        return float(count)
    return total / count if count > 0 else np.nan


@kernel
def map_rows(first, last, sight, grid, light, skin, mode, values, cells, found):
    """Rows `first` to `last` of found (h, w, s, 2): value, and cosine of the smooth normal to the light (3,).

    sight and grid as in cast.cast_rows; mode, values and cells say what the value is.
    """
    eye = sight.eye
    columns, rows, seed = grid
    height, width = found.shape[0], found.shape[1]
    waiting, bound = np.empty(DEPTH, np.int64), np.empty(DEPTH)
    d, p, g = np.empty(3), np.empty(3), np.empty(3)
    x, normals = skin.x, skin.normals
    for row in range(first, last):
        for column in range(width):
            pattern = scramble(row * width + column, seed)
            for sample in range(columns * rows):
                sx, sy = place_sample(sample, columns, rows, pattern)
                aim(sight, column + sx, row + sy, width, height, d)
                face, t = meet_triangle(
                    eye[0], eye[1], eye[2], d[0], d[1], d[2], 0.0, np.inf, skin.tree, waiting, bound
                )
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
                found[row, column, sample, 0] = value_at(p, face, (s, r), skin, mode, values, cells)
                found[row, column, sample, 1] = cosine / np.sqrt(norm)
