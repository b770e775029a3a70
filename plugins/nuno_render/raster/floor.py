"""The floor: an endless plane, known in closed form at every pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nuno_render.light.ground import Ground
from nuno_render.light.light_maps import Lights, floor_openness
from nuno_render.light.lighting import tangents
from nuno_render.light.resolve import Floor
from nuno_render.sight import Sight
from nuno_schemas.fabric import Float

GRID, REACH = 96, 3.0
"""Points along each side of the grid of openness, and half its width in radii of the scene."""


def prepare_floor(ground: Ground, size: tuple[int, int], sight: Sight, lights: Lights) -> Floor:
    """The floor as seen in a picture of this size.

    With ray = forward + right (X - w / 2) / focal - up (Y - h / 2) / focal, affine in the
    pixel, the point eye + z ray lies on the floor n . p = d where 1/z = n . ray / (d - n . eye),
    affine too: so the floor takes part in the depth test without a triangle.
    """
    eye, right, above, forward, focal = sight
    rays = np.stack([right / focal, -above / focal, forward], axis=1)
    rays[:, 2] -= rays[:, 0] * size[0] / 2.0 + rays[:, 1] * size[1] / 2.0
    u, v, up = tangents(lights.up)
    plane, reach, grid = np.zeros(3), REACH * ground.radius, np.ones((GRID, GRID))
    step = 2.0 * reach / (GRID - 1)
    if ground.active:
        plane = (up @ rays) / ground.drop
        floor_openness(ground.centre - reach * (u + v), step * u, step * v, lights, grid)
        grid = _smooth(grid)
    return Floor(ground, plane, rays, eye, grid, u, v, 1.0 / step)


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
    if not floor.ground.active:
        return np.zeros((size[1], size[0], len(offsets)), np.float32)
    plane = floor.plane
    x = np.arange(size[0])[:, None] + offsets[:, 0] / 256.0
    y = np.arange(size[1])[:, None] + offsets[:, 1] / 256.0
    rows, columns = (plane[1] * y + plane[2]).astype(np.float32), (plane[0] * x).astype(np.float32)
    depth: NDArray[np.float32] = np.maximum(rows[:, None, :] + columns[None, :, :], np.float32(0.0))
    return depth
