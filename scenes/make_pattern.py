"""Make seigaiha.png, waves of the blue sea: python scenes/make_pattern.py

The traditional pattern: discs of one radius R in rows R/2 apart, every other row shifted by R, each
disc over the row above it, so that only fans are seen; every disc is drawn as rings. The picture
holds whole waves across and whole pairs of rows, so that it tiles: its left side goes on at its right one where it goes
round a skirt.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

PATH = Path(__file__).with_name("seigaiha.png")
WIDTH, HEIGHT = 2048, 512
ACROSS, PAIRS = 24, 12
"""Discs side by side, and pairs of rows. One repeat is 2 R wide and R high: 85 by 43 pixels."""
RINGS = (0.97, 0.82, 0.67, 0.52, 0.37, 0.22)
"""Outer radii of the rings, over R: indigo and paper take turns."""
INDIGO, PAPER = (38, 52, 110), (244, 240, 228)
SAMPLES = 4
"""Samples along each side of a pixel."""
LEVELS = 16


def cover(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where indigo lies; u and v count repeats to the right and down.

    In units of R the rows are 1/2 apart, and a point at height v is seen in the lowest row whose
    disc reaches it.
    """
    x, y = 2.0 * u, v
    distance = np.full(np.broadcast_shapes(u.shape, v.shape), np.inf)
    # Discs are 2 R wide, rows R/2 apart: rows from 2 below to 2 above a point can reach it.
    for step in range(2, -4, -1):
        row = np.floor(2.0 * y) + step
        shift = np.mod(row, 2.0)
        middle = 2.0 * np.round((x - shift) / 2.0) + shift
        reach = np.hypot(x - middle, y - 0.5 * row)
        distance = np.where(np.isinf(distance) & (reach <= 1.0), reach, distance)
    return np.asarray(np.searchsorted(np.sort(RINGS), distance) % 2 == len(RINGS) % 2)


def make_pattern() -> Image.Image:
    """The picture, (512, 2048), in 16 shades between the two colours."""
    u = (np.arange(WIDTH * SAMPLES) + 0.5) / (WIDTH * SAMPLES) * ACROSS
    v = (np.arange(HEIGHT * SAMPLES) + 0.5) / (HEIGHT * SAMPLES) * PAIRS
    fine = ~cover(u[None, :], v[:, None])
    count = fine.reshape(HEIGHT, SAMPLES, WIDTH, SAMPLES).sum(axis=(1, 3))
    shade = np.round(count * ((LEVELS - 1) / SAMPLES**2)).astype(np.uint8)
    image = Image.fromarray(shade)
    ramp = np.linspace(INDIGO, PAPER, LEVELS).round().astype(np.uint8)
    image.putpalette(ramp.tobytes())
    return image


if __name__ == "__main__":
    make_pattern().save(PATH, optimize=True)
