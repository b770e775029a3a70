"""The floor and the background, of pictures by a z-buffer and by rays."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from nuno_geometry.poses import Vector
from nuno_kernels import kernel
from nuno_kernels.lanes import dot
from nuno_render.config import PictureConfig
from nuno_render.shading.shade import sky
from nuno_schemas.colour import parse_hex
from nuno_schemas.fabric import Float

SUNK = 1e-4
"""Distance of the drawn floor below its height, in radii of the scene, so that objects on it stay visible."""


class Ground(NamedTuple):
    """The floor, an infinite plane that fades into the background.

    active       whether it is visible, from an eye above it
    drop         its height over the eye [m]
    centre (3,)  the point of it below or above the scene's middle [m]; radius: of the scene [m]
    albedo (3,)  linear; top, bottom (3,): the background's colours, linear
    """

    active: bool
    drop: float
    centre: Float
    radius: float
    albedo: Float
    top: Float
    bottom: Float


def find_ground(
    config: PictureConfig, lowest: float, origin: Float, eye: Float, up: Float, centre: Float, radius: float
) -> Ground:
    """Return the floor of a picture. `lowest`: least height of objects on it, inf without any; `up` (3,) of length 1;
    heights, `eye`, `centre` (3,) and `radius` of the scene [m] are relative to the origin (3,).
    """
    level = lowest if config.ground == "auto" else math.inf
    if not isinstance(config.ground, str):
        level = float(config.ground - origin @ up)
    seen = math.isfinite(level)
    level = level if seen else 0.0
    drop = level - SUNK * radius - float(eye @ up)
    middle = centre + (level - float(centre @ up)) * up
    top, bottom = (parse_hex(colour) for colour in config.background)
    return Ground(seen and drop < 0.0, drop, middle, radius, parse_hex(config.ground_colour), top, bottom)


@kernel
def background(down: float, ground: Ground, out: Float) -> None:
    """Write the background, a gradient flat at both ends, at a share `down` of the picture's height into out (3,)."""
    s = min(max(down, 0.0), 1.0)
    s = s * s * (3.0 - 2.0 * s)
    for k in range(3):
        out[k] = ground.top[k] + s * (ground.bottom[k] - ground.top[k])


@kernel
def fade_at(off: Vector, ground: Ground) -> float:
    """Return the share of the background in the floor at a way [m] from its centre, 0 to 1."""
    distance = np.sqrt(dot(off, off)) / ground.radius
    fade: float = min(max((distance - 1.0) / 4.0, 0.0), 1.0)
    return fade * fade * (3.0 - 2.0 * fade)


@kernel
def lay_floor(fade: float, lit: float, free: float, ground: Ground, lights: Any, out: Float) -> None:
    """Blend the floor's radiance into out (3,), which holds the background; lit, free: parts of the key light and of
    the sky that reach it. `lights` have the needed fields of nuno_render.shading.lighting.Lights.
    """
    nl = max(dot(lights.up, lights.direction), 0.0)
    for k in range(3):
        radiance = ground.albedo[k] * (lights.colour[k] * nl * lit + sky(1.0, lights.sky, lights.ground, k) * free)
        out[k] += (1.0 - fade) * (radiance - out[k])
