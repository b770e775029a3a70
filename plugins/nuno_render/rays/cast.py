"""Rows of a picture of yarns on bodies, by rays.

Each sample's ray goes on to the first body, or the floor. Yarns that it crosses on the way let a share of what is
behind them through, each crossing once however many of the yarn's capsules it takes, and at most KEEP of them; from
what it meets one ray goes to the light and one to the sky. Nothing is blurred: a yarn thinner than a pixel covers it in
the mean of the samples by as much as it does in truth, and so the knit grows denser toward the silhouette by itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_kernels import block_kernel, kernel
from nuno_render.light.ground import Ground, background
from nuno_render.rays.crossings import cross_yarns
from nuno_render.rays.fibre import Look
from nuno_render.rays.hits import Buffers, make_buffers, meet_triangle
from nuno_render.rays.surfaces import shade_floor, shade_skin, shade_yarn
from nuno_render.rays.worn import Skin, Threads
from nuno_render.sampling import place_sample, scramble
from nuno_render.sight import Sight, aim
from nuno_schemas.fabric import Float

KEEP = 16
"""Capsules that a ray is followed through."""
FAINT = 1.0 / 1024.0
"""What is behind yarns that let less than this through is not looked at."""


@kernel
def see(
    d: Float, down: float, look: Look, skin: Skin, threads: Threads, floor: Ground, sample: Any, buffers: Buffers,
    out: Float,
) -> None:  # fmt: skip
    """What a ray sees that passes the picture at a share `down` of its height, into out (4,): radiance, and the yarns'
    share of it.
    """
    eye, up, share = look.eye, look.up, look.share
    face, most = meet_triangle(eye, d, skin.tree, buffers)
    fall = up[0] * d[0] + up[1] * d[1] + up[2] * d[2]
    on_floor = False
    if floor.active and fall < 0.0 and floor.drop / fall < most:
        face, most, on_floor = -1, floor.drop / fall, True
    count = cross_yarns(eye, d, most, threads, look.keep, buffers)
    items, enters = buffers.met, buffers.met_at
    for i in range(count):
        items[i], enters[i] = buffers.items[i], buffers.enters[i]
    colour, weight = buffers.work[9], 1.0
    out[0] = out[1] = out[2] = 0.0
    for i in range(count):
        if weight < FAINT:
            break
        if look.flat:
            for k in range(3):
                colour[k] = threads.colour[threads.yarn[items[i]], k]
        else:
            shade_yarn(items[i], d, enters[i], look, skin, threads, sample, buffers, colour)
        for k in range(3):
            out[k] += weight * (1.0 - share) * colour[k]
        weight *= share
    out[3] = 1.0 - weight
    if weight < FAINT:
        return
    background(down, floor, colour)
    if face >= 0:
        shade_skin(face, d, most, look, skin, threads, sample, buffers, colour)
    elif on_floor:
        shade_floor(d, most, floor, look, skin, threads, sample, buffers, colour)
    for k in range(3):
        out[k] += weight * colour[k]


@block_kernel
def cast_rows(
    first: int, last: int, sight: Sight, grid: Any, look: Look, skin: Skin, threads: Threads, floor: Ground,
    picture: Float,
) -> None:  # fmt: skip
    """Rows `first` to `last` of picture (h, w, 4), linear light and the yarns' share of each pixel.

    grid: columns and rows of samples, and the seed.
    """
    columns, rows, seed = grid
    height, width = picture.shape[0], picture.shape[1]
    buffers, d, out = make_buffers(KEEP), np.empty(3), np.empty(4)
    samples = columns * rows
    for row in range(first, last):
        for column in range(width):
            pattern = scramble(row * width + column, seed)
            total = (0.0, 0.0, 0.0, 0.0)
            for s in range(samples):
                x, y = place_sample(s, columns, rows, pattern)
                aim(sight, column + x, row + y, width, height, d)
                sample = (s, columns, rows, pattern)
                see(d, (row + y) / height, look, skin, threads, floor, sample, buffers, out)
                total = (total[0] + out[0], total[1] + out[1], total[2] + out[2], total[3] + out[3])
            for k in range(4):
                picture[row, column, k] = total[k] / samples
