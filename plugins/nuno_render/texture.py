"""Images on cloth: mip maps in linear light, and trilinear look-up with a few taps along the slant."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import kernel
from nuno_schemas.colour import to_linear
from nuno_schemas.fabric import Float

TAPS = 8
"""The most look-ups along the longer axis of a pixel's footprint."""


class Textures(NamedTuple):
    """Mip maps of the images of meshes: texels (t, 3) float32 linear, all levels of all images; levels (m, l, 3) int64
    per mesh: first texel, height, width; number (m,) int64 of levels, 0 for a mesh without image.
    """

    texels: NDArray[np.float32]
    levels: NDArray[np.int64]
    number: NDArray[np.int64]


def gather_textures(images: list[NDArray[np.uint8] | None]) -> Textures:
    """Return mip maps of the images, one per mesh or None."""
    pyramids = [_pyramid(image.tobytes(), image.shape) if image is not None else () for image in images]
    count = np.array([len(p) for p in pyramids], np.int64)
    levels = np.zeros((len(images), max([1, *map(len, pyramids)]), 3), np.int64)
    parts, start = [np.zeros((1, 3), np.float32)], 1
    for m, pyramid in enumerate(pyramids):
        for level, picture in enumerate(pyramid):
            levels[m, level] = start, picture.shape[0], picture.shape[1]
            parts.append(picture.reshape(-1, 3))
            start += picture.shape[0] * picture.shape[1]
    return Textures(np.concatenate(parts), levels, count)


@functools.lru_cache(maxsize=4)
def _pyramid(data: bytes, shape: tuple[int, ...]) -> tuple[NDArray[np.float32], ...]:
    """Return levels from full size to one texel. Cached, since an animation has the same image in every frame."""
    table = to_linear(np.arange(256) / 255.0).astype(np.float32)
    picture = table[np.frombuffer(data, np.uint8).reshape(shape)]
    levels = [picture]
    while max(picture.shape[:2]) > 1:
        picture = _halve(_halve(picture, 0), 1)
        levels.append(picture)
    return tuple(levels)


def _halve(picture: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Halve the size along an axis, rounded up; an odd last line is repeated."""
    size = picture.shape[axis]
    if size == 1:
        return picture
    first = picture.take(range(0, size, 2), axis)
    second = picture.take([min(i + 1, size - 1) for i in range(0, size, 2)], axis)
    return np.asarray((first + second) * np.float32(0.5))


@kernel
def _bilinear(
    texels: NDArray[np.float32], level: NDArray[np.int64], u: float, v: float, weight: float, out: Float
) -> None:
    """Add weight times the image at (u, v): repeats beyond [0, 1], (0, 0) is the upper left corner."""
    start, height, width = level[0], level[1], level[2]
    x, y = (u - np.floor(u)) * width - 0.5, (v - np.floor(v)) * height - 0.5
    x0, y0 = np.floor(x), np.floor(y)
    fx, fy = x - x0, y - y0
    left, right = int(x0) % width, int(x0 + 1.0) % width
    top, bottom = int(y0) % height, int(y0 + 1.0) % height
    for k in range(3):
        above = texels[start + top * width + left, k] * (1.0 - fx) + texels[start + top * width + right, k] * fx
        below = texels[start + bottom * width + left, k] * (1.0 - fx) + texels[start + bottom * width + right, k] * fx
        out[k] += weight * (above * (1.0 - fy) + below * fy)


@kernel
def look_up(textures: Textures, mesh: int, place: Any, change: Any, out: Float) -> None:
    """Write the mean of a mesh's image over a pixel's footprint about (u, v) into out (3,).

    change: of (u, v) over one pixel to the right, and down. Taps cover the longer of the two and the shorter chooses
    the mip level, so that slanted cloth is sharp along its short axis without aliasing along the long one.
    """
    texels, levels, count = textures.texels, textures.levels[mesh], textures.number[mesh]
    (u, v), (ux, vx, uy, vy), height, width = place, change, levels[0, 1], levels[0, 2]
    a = np.sqrt((ux * width) ** 2 + (vx * height) ** 2)
    b = np.sqrt((uy * width) ** 2 + (vy * height) ** 2)
    long_u, long_v = (ux, vx) if a >= b else (uy, vy)
    long, short = max(a, b), min(a, b)
    taps = 1
    if long > 1.0:
        taps = int(min(np.ceil(long / max(short, 1.0)), TAPS))
    level = np.log2(max(long / taps, 1.0))
    coarse = int(min(level, count - 1.0))
    blend = min(level - coarse, 1.0)
    out[0] = out[1] = out[2] = 0.0
    for tap in range(taps):
        place = (tap + 0.5) / taps - 0.5
        tu, tv = u + place * long_u, v + place * long_v
        _bilinear(texels, levels[coarse], tu, tv, (1.0 - blend) / taps, out)
        if blend > 0.0 and coarse + 1 < count:
            _bilinear(texels, levels[coarse + 1], tu, tv, blend / taps, out)
        elif blend > 0.0:
            _bilinear(texels, levels[coarse], tu, tv, blend / taps, out)
