"""Rows of a picture of yarns on bodies, by rays.

Each sample's ray goes on to the first body, or the floor. Yarns that it crosses on the way let a share of what is
behind them through, each crossing once however many of the yarn's capsules it takes, and at most KEEP of them; from
what it meets one ray goes to the light and one to the sky. Nothing is blurred: a yarn thinner than a pixel covers it in
the mean of the samples by as much as it does in truth, and so the knit grows denser toward the silhouette by itself.
"""

from __future__ import annotations

import numpy as np

from nuno_render.compiled import kernel
from nuno_render.light.resolve import background
from nuno_render.rays.crossings import cross_yarns
from nuno_render.rays.hits import DEPTH, meet_triangle
from nuno_render.rays.surfaces import shade_floor, shade_skin, shade_yarn
from nuno_render.sampling import place_sample, scramble
from nuno_render.sight import aim

# mypy: disable-error-code="no-untyped-def"

KEEP = 16
"""Capsules that a ray is followed through."""
FAINT = 1.0 / 1024.0
"""What is behind yarns that let less than this through is not looked at."""


@kernel
def see(eye, d, y, height, lights, look, skin, threads, floor, back, sample, hits, seen, work, out):
    """What a ray sees, into out (4,): radiance, and the yarns' share of it."""
    share, keep, flat = look[0], look[1], look[7]
    face, most = meet_triangle(eye[0], eye[1], eye[2], d[0], d[1], d[2], 0.0, np.inf, skin.tree, hits[3], hits[4])
    up = lights[2]
    fall = up[0] * d[0] + up[1] * d[1] + up[2] * d[2]
    on_floor = False
    if floor[0] and fall < 0.0 and floor[1] / fall < most:
        face, most, on_floor = -1, floor[1] / fall, True
    count = cross_yarns(eye, d, most, threads, keep, hits)
    items, enters = seen
    for i in range(count):
        items[i], enters[i] = hits[0][i], hits[1][i]
    colour, weight = work[9], 1.0
    out[0] = out[1] = out[2] = 0.0
    for i in range(count):
        if weight < FAINT:
            break
        if flat:
            for k in range(3):
                colour[k] = threads.colour[threads.yarn[items[i]], k]
        else:
            shade_yarn(items[i], eye, d, enters[i], lights, look, skin, threads, sample, hits, work, colour)
        for k in range(3):
            out[k] += weight * (1.0 - share) * colour[k]
        weight *= share
    out[3] = 1.0 - weight
    if weight < FAINT:
        return
    background(y, height, back[0], back[1], colour)
    if face >= 0:
        shade_skin(face, eye, d, most, lights, look, skin, threads, sample, hits, work, colour)
    elif on_floor:
        shade_floor(eye, d, most, floor, lights, look, skin, threads, sample, hits, work, colour)
    for k in range(3):
        out[k] += weight * colour[k]


@kernel
def cast_rows(first, last, sight, grid, lights, look, skin, threads, floor, back, picture):
    """Rows `first` to `last` of picture (h, w, 4), linear light and the yarns' share of each pixel.

    sight   sight.Sight
    grid    columns and rows of samples, seed
    lights  direction, colour, up, sky, ground, tangent of the light's radius
    look    share of light through a yarn, capsules that a ray is followed through, strength and exponent of the
            highlight, shadows, occlusion, how far rays start off a surface [m], whether yarns are of one flat colour
            and cast no shadow
    floor   whether there is one, its height over the eye [m], middle and size of the scene, albedo
    back    colours at the top and bottom
    """
    eye = sight.eye
    columns, rows, seed = grid
    height, width = picture.shape[0], picture.shape[1]
    hits = (np.empty(KEEP, np.int64), np.empty(KEEP), np.empty(KEEP), np.empty(DEPTH, np.int64), np.empty(DEPTH))
    seen = (np.empty(KEEP, np.int64), np.empty(KEEP))
    work, d, out = np.empty((10, 3)), np.empty(3), np.empty(4)
    samples = columns * rows
    for row in range(first, last):
        for column in range(width):
            pattern = scramble(row * width + column, seed)
            total = (0.0, 0.0, 0.0, 0.0)
            for s in range(samples):
                x, y = place_sample(s, columns, rows, pattern)
                aim(sight, column + x, row + y, width, height, d)
                sample = (s, columns, rows, pattern)
                see(eye, d, row + y, height, lights, look, skin, threads, floor, back, sample, hits, seen, work, out)
                total = (total[0] + out[0], total[1] + out[1], total[2] + out[2], total[3] + out[3])
            for k in range(4):
                picture[row, column, k] = total[k] / samples
