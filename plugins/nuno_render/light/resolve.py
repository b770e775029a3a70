"""Pixels from samples: surfaces, ground and background, averaged in linear light."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import kernel
from nuno_render.light.ground import Ground, background, fade_at, lay_floor
from nuno_render.light.light_maps import Lights, shadow
from nuno_render.light.shade import shade_point
from nuno_render.scene import DrawnScene
from nuno_schemas.fabric import Float, Int


class Floor(NamedTuple):
    """The floor in a z-buffer.

    ground         its place and colour
    plane (3,)     1 / z of the floor at a pixel (x, y, 1)
    rays (3, 3)    columns: the change of a ray over a pixel to the right and down, and the ray at pixel (0, 0)
    eye (3,)       [m] of the camera
    grid (g, g)    openness about the centre; grid_u, grid_v (3,) its directions, grid_scale its points a metre
    """

    ground: Ground
    plane: Float
    rays: Float
    eye: Float
    grid: Float
    grid_u: Float
    grid_v: Float
    grid_scale: float


@kernel
def ground_point(x: float, y: float, height: int, floor: Floor, lights: Lights, out: Float) -> None:
    """Write the ground at pixel (x, y), fading into the background with distance, into out (3,)."""
    plane, rays, eye, normal, centre = floor.plane, floor.rays, floor.eye, lights.up, floor.ground.centre
    background(y / height, floor.ground, out)
    inverse = plane[0] * x + plane[1] * y + plane[2]
    if not floor.ground.active or inverse <= 0.0:
        return
    px = eye[0] + (rays[0, 0] * x + rays[0, 1] * y + rays[0, 2]) / inverse
    py = eye[1] + (rays[1, 0] * x + rays[1, 1] * y + rays[1, 2]) / inverse
    pz = eye[2] + (rays[2, 0] * x + rays[2, 1] * y + rays[2, 2]) / inverse
    dx, dy, dz = px - centre[0], py - centre[1], pz - centre[2]
    fade = fade_at(dx, dy, dz, floor.ground)
    if fade >= 1.0:
        return
    light = lights.direction
    lit, free = 1.0, 1.0
    if lights.depths.shape[0] > 0 and normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2] > 0.0:
        lit = shadow(lights, px, py, pz, normal[0], normal[1], normal[2])
    grid, grid_u, grid_v, grid_scale = floor.grid, floor.grid_u, floor.grid_v, floor.grid_scale
    size = grid.shape[0]
    if size > 1:
        gu = (grid_u[0] * dx + grid_u[1] * dy + grid_u[2] * dz) * grid_scale + 0.5 * (size - 1)
        gv = (grid_v[0] * dx + grid_v[1] * dy + grid_v[2] * dz) * grid_scale + 0.5 * (size - 1)
        if 0.0 <= gu < size - 1.0 and 0.0 <= gv < size - 1.0:
            i, j = int(gv), int(gu)
            s, t = gu - j, gv - i
            free = (grid[i, j] * (1 - s) + grid[i, j + 1] * s) * (1 - t)
            free += (grid[i + 1, j] * (1 - s) + grid[i + 1, j + 1] * s) * t
    lay_floor(fade, lit, free, floor.ground, lights, out)


@kernel
def resolve(
    owner: Int, offsets: NDArray[np.int64], scene: DrawnScene, clip: Float, lights: Lights, floor: Floor, picture: Float
) -> None:
    """Shade every pixel into picture (h, w, 3) float64, linear light.

    owner (h, w, s) int32 face of each sample, -1 for none; offsets (s, 2) [1/256 pixel]; clip (n, 3) the scene's
    vertices on the screen.
    """
    height, width, samples = owner.shape
    work = np.empty((9, 3))
    colour = np.empty(3)
    for row in range(height):
        for column in range(width):
            for k in range(3):
                picture[row, column, k] = 0.0
            done = 0
            for s in range(samples):
                if done >> s & 1:
                    continue
                face = owner[row, column, s]
                x, y, count = 0, 0, 0
                for q in range(s, samples):
                    if owner[row, column, q] == face:
                        done |= 1 << q
                        x += offsets[q, 0]
                        y += offsets[q, 1]
                        count += 1
                px, py = column + x / (256.0 * count), row + y / (256.0 * count)
                if face < 0:
                    ground_point(px, py, height, floor, lights, colour)
                else:
                    shade_point(face, px, py, scene, clip, floor.eye, lights, work, colour)
                for k in range(3):
                    picture[row, column, k] += colour[k] * count / samples


@kernel
def encode(picture: Float, table: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """Linear light to sRGB bytes, with a shoulder above 0.8 so that highlights do not clip.

    table (t,) uint8 is sRGB at equal steps of the square root of linear light in [0, 1], whose
    slope is bounded at black, where that of sRGB itself would need a long table.
    """
    last = table.shape[0] - 1.0
    for row in range(picture.shape[0]):
        for column in range(picture.shape[1]):
            for k in range(3):
                value = max(picture[row, column, k], 0.0)
                if value > 0.8:
                    value = 1.0 - 0.2 * np.exp((0.8 - value) / 0.2)
                out[row, column, k] = table[int(np.sqrt(value) * last + 0.5)]
