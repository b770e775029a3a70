"""A checked camera for the kernels, the rays through its pixels, and the places of samples in a pixel."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nuno_geometry.poses import Vector
from nuno_kernels import kernel
from nuno_kernels.lanes import dot, over, plus, times
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.pictures import Camera, axes

# Places of samples: correlated multi-jittered sampling (Kensler, Pixar technical memo 13-01, 2013).
#
# N samples are one in each cell of a grid, and one in each of N columns and N rows: yarns form rows and columns over
# long stretches of a picture, and a pixel's share of them is more accurate with more rows of samples. Each pattern is a
# hash of a seed, not a generator's state, so that tiles can be drawn in any order.

MASK = 0xFFFFFFFF


@kernel
def scramble(a: int, b: int) -> int:
    """Return a 32-bit hash of two numbers."""
    x = (a * 0x9E3779B1 + b * 0x85EBCA77 + 0x27220A95) & MASK
    x ^= x >> 16
    x = (x * 0x7FEB352D) & MASK
    x ^= x >> 15
    x = (x * 0x846CA68B) & MASK
    return x ^ (x >> 16)


@kernel
def uniform(i: int, pattern: int) -> float:
    """Return a number in [0, 1) from a hash."""
    return scramble(i, pattern) / 4294967296.0


@kernel
def permute(i: int, count: int, pattern: int) -> int:
    """Return the image of i in a permutation of `count` numbers: rounds that are invertible on a power of two, repeated
    until below `count`.
    """
    w = count - 1
    w |= w >> 1
    w |= w >> 2
    w |= w >> 4
    w |= w >> 8
    w |= w >> 16
    while True:
        i ^= pattern & w
        i = (i * 0xE170893D) & MASK
        i ^= (pattern >> 16) & w
        i ^= (i & w) >> 4
        i ^= (pattern >> 8) & w
        i = (i * 0x0929EB3F) & MASK
        i ^= (pattern >> 23) & w
        i ^= (i & w) >> 1
        i = (i * (1 | pattern >> 27)) & MASK
        i = (i * 0x6935FA69) & MASK
        i ^= (i & w) >> 11
        i = (i * 0x74DCB303) & MASK
        i ^= (i & w) >> 2
        i = (i * 0x9E501CC3) & MASK
        i ^= (i & w) >> 2
        i = (i * 0xC860A3DF) & MASK
        i &= w
        i ^= i >> 5
        if i < count:
            return (i + pattern) % count


@kernel
def place_sample(s: int, columns: int, rows: int, pattern: int) -> tuple[float, float]:
    """Return (x, y) in [0, 1)^2 of sample s of columns x rows."""
    s = permute(s, columns * rows, scramble(pattern, 1))
    column = permute(s % columns, columns, scramble(pattern, 2))
    row = permute(s // columns, rows, scramble(pattern, 3))
    x = (column + (row + uniform(s, scramble(pattern, 4))) / rows) / columns
    y = (s + uniform(s, scramble(pattern, 5))) / (columns * rows)
    return x, y


# A checked camera for the kernels, and the rays through its pixels.


class Sight(NamedTuple):
    """A camera: eye (3,) [m] from its target; unit vectors right, up and forward (3,); focal length [pixels]. All
    coordinates are relative to the target, so that a scene far from the origin keeps its digits.
    """

    eye: Float
    right: Float
    up: Float
    forward: Float
    focal: float


def sight_of(camera: Camera) -> Sight:
    """Return a checked camera. Raises BadInput for one without size, field of view or direction."""
    if not (min(camera.size) >= 1 and max(camera.size) <= 16384):
        raise BadInput("no such picture", field="camera.size", value=camera.size, limit="1 to 16384 pixels a side")
    if not 0.0 < camera.fov < math.pi:
        raise BadInput("no such field of view", field="camera.fov", value=camera.fov, limit="between 0 and pi rad")
    eye = np.asarray(camera.eye, np.float64) - np.asarray(camera.target, np.float64)
    return Sight(eye, *axes(camera), camera.size[1] / 2.0 / math.tan(camera.fov / 2.0))


@kernel
def aim(sight: Sight, x: float, y: float, width: int, height: int) -> Vector:
    """Return the unit vector along the ray through (x, y) [pixels] from a picture's upper left corner."""
    u, v = (x - 0.5 * width) / sight.focal, (0.5 * height - y) / sight.focal
    d = plus(plus(sight.forward, times(u, sight.right)), times(v, sight.up))
    return over(d, np.sqrt(dot(d, d)))
