"""Camera fitting, for all renderers and viewers."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.drawing import Camera, Mesh
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

Axes = tuple[Float, Float, Float]


def axes(camera: Camera) -> Axes:
    """Return the unit vectors right, up and forward of a camera, each (3,).

    Raises BadInput if eye and target coincide, or `up` is parallel to the line of sight.
    """
    forward = np.asarray(camera.target, np.float64) - np.asarray(camera.eye, np.float64)
    length = float(np.linalg.norm(forward))
    if not (math.isfinite(length) and length > 0.0):
        raise BadInput("the camera's eye and target must be finite and apart", field="camera.eye", value=camera.eye)
    forward = forward / length
    right = np.cross(forward, np.asarray(camera.up, np.float64))
    width = float(np.linalg.norm(right))
    if not width > 1e-9:
        raise BadInput("the camera's up vector is parallel to its line of sight", field="camera.up", value=camera.up)
    right = right / width
    return right, np.cross(right, forward), forward


def frame(
    points: NDArray[np.floating] | Iterable[Mesh],
    azimuth: float = 0.6,
    elevation: float = 0.25,
    size: tuple[int, int] = (960, 720),
    fov: float = 0.5,
    margin: float = 0.08,
) -> Camera:
    """Fit a camera to all points, with z up.

    points     (n, 3) [m], or meshes; non-finite points are left out. For an animation, pass
               the points of several frames, so that the camera stands still
    azimuth    direction of the camera [rad], counter-clockwise seen from above; 0 is on the
               -y side and looks along +y
    elevation  its height above the horizon [rad], -pi/2 to pi/2
    size       (width, height) [pixels];  fov vertical field of view [rad]
    margin     part of the picture left free on each side, 0 to 0.45

    The fit is exact: the cloud touches the margin on two opposite sides. Raises BadInput for
    an argument out of range.
    """
    if not (0.01 <= fov <= 2.8 and 0.0 <= margin <= 0.45 and min(size) >= 1):
        limit = "fov 0.01 to 2.8 rad, margin 0 to 0.45, size at least 1"
        raise BadInput("the camera cannot be fitted", field="camera", value=(fov, margin, size), limit=limit)
    cloud = _cloud(points)
    flat = math.cos(elevation)
    toward = np.array([math.sin(azimuth) * flat, -math.cos(azimuth) * flat, math.sin(elevation)])
    right = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    forward, up = -toward, np.cross(toward, right)
    middle = (cloud.min(axis=0) + cloud.max(axis=0)) / 2.0
    spread = float(np.linalg.norm(cloud.max(axis=0) - cloud.min(axis=0)))
    scale = spread if spread > 0.0 else 1.0
    x, y, z = ((cloud - middle) @ np.stack([right, up, forward], axis=1)).T
    half = math.tan(fov / 2.0) * (1.0 - 2.0 * margin)
    a, back_x = _fit(x, z, half * size[0] / size[1])
    b, back_y = _fit(y, z, half)
    back = max(back_x, back_y, float(-z.min()) + 0.05 * scale)
    eye = middle + a * right + b * up - back * forward
    return Camera(eye, eye + back * forward, up, fov, size)


def _cloud(points: NDArray[np.floating] | Iterable[Mesh]) -> Float:
    """Return the finite points, shape (n, 3), or those of a unit cube if there are none."""
    parts = [points] if isinstance(points, np.ndarray) else [mesh.vertices for mesh in points]
    cloud = np.concatenate([np.zeros((0, 3)), *(np.asarray(part, np.float64).reshape(-1, 3) for part in parts)])
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    return cloud if len(cloud) else np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])


def _fit(x: Float, z: Float, k: float) -> tuple[float, float]:
    """Return the sideways position and the distance back of an eye that sees all (x, z) within slope k.

    An eye at (a, -d) sees a point where |x - a| <= k (z + d), so x - k z <= a + k d and
    -x - k z <= -a + k d for all points. With P and M the largest left sides, the smallest d
    has both equal: k d = (P + M) / 2 and a = (P - M) / 2.
    """
    p, m = float(np.max(x - k * z)), float(np.max(-x - k * z))
    return (p - m) / 2.0, (p + m) / (2.0 * k)
