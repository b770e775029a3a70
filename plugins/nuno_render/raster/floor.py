"""The floor: an endless plane, known in closed form at every pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nuno_render.config import RasterConfig
from nuno_render.light.light_maps import Lights, floor_openness
from nuno_render.light.lighting import tangents
from nuno_render.light.resolve import Floor
from nuno_render.scene import DrawnScene
from nuno_render.sight import Sight
from nuno_schemas.colour import parse_hex
from nuno_schemas.fabric import Float

GRID, REACH = 96, 3.0
"""Points along each side of the grid of openness, and half its width in radii of the scene."""

SUNK = 1e-4
"""How far the floor is drawn below its height, in radii of the scene, so that cloth lying on it
stays in sight."""


def floor_height(config: RasterConfig, scene: DrawnScene, origin: Float, up: Float) -> float | None:
    """Height of the floor above `origin` along `up` [m], or None without one."""
    if config.ground == "none" or (config.ground == "auto" and not len(scene.faces)):
        return None
    return scene.lowest if config.ground == "auto" else float(config.ground - origin @ up)


def prepare_floor(
    config: RasterConfig, scene: DrawnScene, size: tuple[int, int], sight: Sight, height: float | None, lights: Lights
) -> Floor:
    """The floor as seen in a picture of this size, `height` [m] above the origin, None where there is none.

    With ray = forward + right (X - w / 2) / focal - up (Y - h / 2) / focal, affine in the
    pixel, the point eye + z ray lies on the floor n . p = d where 1/z = n . ray / (d - n . eye),
    affine too: so the floor takes part in the depth test without a triangle.
    """
    eye, right, above, forward, focal = sight
    rays = np.stack([right / focal, -above / focal, forward], axis=1)
    rays[:, 2] -= rays[:, 0] * size[0] / 2.0 + rays[:, 1] * size[1] / 2.0
    level = height if height is not None else 0.0
    up, (top, bottom) = lights.up, (parse_hex(colour) for colour in config.background)
    drop = level - SUNK * scene.radius - eye @ up
    active = height is not None and bool(drop < 0.0)
    plane = (up @ rays) / drop if active else np.zeros(3)
    middle = scene.centre + (level - scene.centre @ up) * up
    u, v, _ = tangents(up)
    step = 2.0 * REACH * scene.radius / (GRID - 1)
    grid = np.ones((GRID, GRID))
    if active:
        floor_openness(middle - REACH * scene.radius * (u + v), step * u, step * v, lights, grid)
        grid = _smooth(grid)
    colour = parse_hex(config.ground_colour)
    return Floor(active, plane, rays, eye, middle, scene.radius, colour, grid, u, v, 1.0 / step, top, bottom)


def _smooth(grid: Float) -> Float:
    """A square grid after ten passes of (1 2 1) / 4 along both axes: a normal distribution 2.2
    cells wide, which blends the separate shadows of the few sky directions.
    """
    for _ in range(20):
        padded = np.concatenate([grid[:1], grid, grid[-1:]])
        grid = (0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]).T
    return np.ascontiguousarray(grid)


def floor_depth(floor: Floor, size: tuple[int, int], offsets: NDArray[np.int64]) -> NDArray[np.float32]:
    """(h, w, s) float32 1/z of the floor at every sample, 0 where it is not seen."""
    if not floor.active:
        return np.zeros((size[1], size[0], len(offsets)), np.float32)
    plane = floor.plane
    x = np.arange(size[0])[:, None] + offsets[:, 0] / 256.0
    y = np.arange(size[1])[:, None] + offsets[:, 1] / 256.0
    rows, columns = (plane[1] * y + plane[2]).astype(np.float32), (plane[0] * x).astype(np.float32)
    depth: NDArray[np.float32] = np.maximum(rows[:, None, :] + columns[None, :, :], np.float32(0.0))
    return depth
