"""A checked camera for the kernels, and the rays through its pixels."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_schemas.camera import axes
from nuno_schemas.drawing import Camera
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float


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
def aim(sight: Sight, x: float, y: float, width: int, height: int, d: Float) -> None:
    """Write the unit vector along the ray through (x, y) [pixels] from a picture's upper left corner into d (3,)."""
    u, v = (x - 0.5 * width) / sight.focal, (0.5 * height - y) / sight.focal
    for k in range(3):
        d[k] = sight.forward[k] + u * sight.right[k] + v * sight.up[k]
    norm = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    for k in range(3):
        d[k] /= norm
