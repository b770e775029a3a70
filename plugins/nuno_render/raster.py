"""The renderer `raster`: one picture from meshes and a camera."""

from __future__ import annotations

import functools
import math
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from nuno_geometry.poses import row_at, vector
from nuno_kernels import kernel
from nuno_kernels.lanes import dot, minus, over, plus
from nuno_render.annotate import annotate
from nuno_render.config import RasterConfig
from nuno_render.refine import refine
from nuno_render.scene import DrawnScene, gather
from nuno_render.shading.ground import Ground, background, fade_at, find_ground, lay_floor
from nuno_render.shading.lighting import Lights, floor_openness, prepare_lights, shadow, tangents, unit
from nuno_render.shading.shade import shade_point
from nuno_render.sight import Sight, sight_of
from nuno_schemas.colour import to_srgb
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.pictures import Camera, Mesh

# Pixels from samples: surfaces, ground and background, averaged in linear light.


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
    at, up = (x, y, 1.0), vector(lights.up)
    background(y / height, floor.ground, out)
    inverse = dot(floor.plane, at)
    if not floor.ground.active or inverse <= 0.0:
        return
    rays = floor.rays
    ray = dot(row_at(rays, 0), at), dot(row_at(rays, 1), at), dot(row_at(rays, 2), at)
    p = plus(floor.eye, over(ray, inverse))
    off = minus(p, floor.ground.centre)
    fade = fade_at(off, floor.ground)
    if fade >= 1.0:
        return
    lit, free = 1.0, 1.0
    if lights.depths.shape[0] > 0 and dot(up, lights.direction) > 0.0:
        lit = shadow(p, up, lights)
    grid, size = floor.grid, floor.grid.shape[0]
    if size > 1:
        gu = dot(floor.grid_u, off) * floor.grid_scale + 0.5 * (size - 1)
        gv = dot(floor.grid_v, off) * floor.grid_scale + 0.5 * (size - 1)
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
    texel, colour = np.empty(3), np.empty(3)
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
                    shade_point(face, px, py, scene, clip, floor.eye, lights, texel, colour)
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


# The visible triangle of each sample of the picture: a z-buffer over exact integer coverage.  Vertices arrive in
# homogeneous pixel coordinates (X w, Y w, w): the pixel is (X, Y), y down, and w the distance along the line of sight.
# Screen positions are rounded to 1/256 pixel and the edge functions are integers, so that with the top-left rule a
# sample on an edge shared by two triangles belongs to exactly one of them, whatever their shapes (Pineda 1988).

GUARD = 2.0**21
"""Pixels around the picture beyond which triangles are clipped; within, the edge functions (24 + 8 bits, squared,
summed) fit in 63 bits."""

PATTERNS: dict[int, NDArray[np.int64]] = {
    1: np.array([[0, 0]]),
    4: np.array([[-2, -6], [6, -2], [-6, 2], [2, 6]]),
    8: np.array([[1, -3], [-1, 3], [5, 1], [-3, -5], [-5, 5], [-7, -1], [3, 7], [7, -7]]),
    16: np.array(
        [[1, 1], [-1, -3], [-3, 2], [4, -1], [-5, -2], [2, 5], [5, 3], [3, -5],
         [-2, 6], [0, -7], [-4, -6], [-6, 4], [-8, 0], [7, -4], [6, 7], [-7, -8]]
    ),
}  # fmt: skip
"""Sample positions in 1/16 pixel from the pixel's centre: the usual n-rooks patterns, with as many distinct rows and
columns as samples, which smooth steep and flat edges alike."""


def sample_offsets(samples: int) -> NDArray[np.int64]:
    """Return positions (samples, 2) in 1/256 pixel from the pixel's upper left corner."""
    return PATTERNS[samples].astype(np.int64) * 16 + 128


@kernel
def _clip(source: Float, count: int, target: Float, plane: int, near: float) -> int:
    """Clip polygon `source` (count, 3) by a plane into `target` (Sutherland-Hodgman). Return its number of corners."""
    written = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        da = _inside(source[i, 0], source[i, 1], source[i, 2], plane, near)
        db = _inside(source[j, 0], source[j, 1], source[j, 2], plane, near)
        if da >= 0.0:
            for k in range(3):
                target[written, k] = source[i, k]
            written += 1
        if (da >= 0.0) != (db >= 0.0):
            s = da / (da - db)
            for k in range(3):
                target[written, k] = source[i, k] + s * (source[j, k] - source[i, k])
            written += 1
    return written


@kernel
def _inside(x: float, y: float, w: float, plane: int, near: float) -> float:
    """Return the signed distance of a homogeneous point from a plane: near, then left, right, top, bottom."""
    if plane == 0:
        return w - near
    along = x if plane < 3 else y
    return GUARD * w + along if plane % 2 == 1 else GUARD * w - along


@kernel
def _fill(
    polygon: Float, b: int, owner_id: int, cull: bool, offsets: NDArray[np.int64], reach: int,
    depth: NDArray[np.float32], owner: Int,
) -> int:  # fmt: skip
    """Draw the triangle of corners 0, b, b + 1 of a clipped, convex polygon. Return the number of samples covered."""
    a, c = 0, b + 1
    height, width, samples = depth.shape
    ia, ib, ic = 1.0 / polygon[a, 2], 1.0 / polygon[b, 2], 1.0 / polygon[c, 2]
    ax, ay = round(polygon[a, 0] * ia * 256.0), round(polygon[a, 1] * ia * 256.0)
    bx, by = round(polygon[b, 0] * ib * 256.0), round(polygon[b, 1] * ib * 256.0)
    cx, cy = round(polygon[c, 0] * ic * 256.0), round(polygon[c, 1] * ic * 256.0)
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if area == 0 or (cull and area > 0):
        return 0
    if area < 0:
        bx, by, ib, cx, cy, ic = cx, cy, ic, bx, by, ib
        area = -area
    left, right = max(min(ax, bx, cx) >> 8, 0), min(max(ax, bx, cx) >> 8, width - 1)
    top, bottom = max(min(ay, by, cy) >> 8, 0), min(max(ay, by, cy) >> 8, height - 1)
    if left > right or top > bottom:
        return 0
    # Edge p -> q at a sample r: (q - p) x (r - p) >= 0, less one if the edge is neither top nor left.
    x0, y0, x1, y1, x2, y2 = bx - ax, by - ay, cx - bx, cy - by, ax - cx, ay - cy
    t0 = 0 if y0 < 0 or (y0 == 0 and x0 > 0) else 1
    t1 = 0 if y1 < 0 or (y1 == 0 and x1 > 0) else 1
    t2 = 0 if y2 < 0 or (y2 == 0 and x2 > 0) else 1
    m0, m1, m2 = reach * (abs(x0) + abs(y0)), reach * (abs(x1) + abs(y1)), reach * (abs(x2) + abs(y2))
    # 1/w is affine on the screen, here from the rounded corners, so that it stays between theirs.
    gx = ((ib - ia) * (cy - ay) - (ic - ia) * (by - ay)) / area
    gy = ((ic - ia) * (bx - ax) - (ib - ia) * (cx - ax)) / area
    low, high = min(ia, ib, ic), max(ia, ib, ic)
    written = 0
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            px, py = column << 8, row << 8
            mx, my = px + 128, py + 128
            miss = x0 * (my - ay) - y0 * (mx - ax) + m0 < 0 or x1 * (my - by) - y1 * (mx - bx) + m1 < 0
            if miss or x2 * (my - cy) - y2 * (mx - cx) + m2 < 0:
                continue
            for s in range(samples):
                rx, ry = px + offsets[s, 0], py + offsets[s, 1]
                miss = x0 * (ry - ay) - y0 * (rx - ax) < t0 or x1 * (ry - by) - y1 * (rx - bx) < t1
                if miss or x2 * (ry - cy) - y2 * (rx - cx) < t2:
                    continue
                written += 1
                iw = np.float32(min(max(ia + gx * (rx - ax) + gy * (ry - ay), low), high))
                if iw > depth[row, column, s]:
                    depth[row, column, s] = iw
                    owner[row, column, s] = owner_id
    return written


@kernel
def rasterise(
    clip: Float, faces: Int, mesh: Int, two_sided: Bool, near: float, offsets: NDArray[np.int64], reach: int,
    depth: NDArray[np.float32], owner: Int,
) -> int:  # fmt: skip
    """Draw all triangles. Return the number of samples that they cover, including hidden ones.

    clip (n, 3) homogeneous pixels; faces (f, 3); mesh (f,) index into two_sided (m,); near [m]; offsets (s, 2) [1/256
    pixel], at most `reach` from the pixel's centre; depth (h, w, s) float32, nearest 1/w, and owner (h, w, s) int32,
    its face: both updated. At equal depth the first surface stays. Front faces, counter-clockwise seen by the viewer,
    have a negative area, since y points down; a one-sided mesh shows only these.
    """
    first = np.empty((10, 3))
    second = np.empty((10, 3))
    covered = 0
    for f in range(faces.shape[0]):
        outside = False
        for k in range(3):
            x, y, w = clip[faces[f, k], 0], clip[faces[f, k], 1], clip[faces[f, k], 2]
            first[k, 0], first[k, 1], first[k, 2] = x, y, w
            outside |= not (w >= near and abs(x) <= GUARD * w and abs(y) <= GUARD * w)
        count = 3
        if outside:
            for plane in range(5):
                count = _clip(first, count, second, plane, near)
                first, second = second, first
        cull = not two_sided[mesh[f]]
        for k in range(1, count - 1):
            covered += _fill(first, k, f, cull, offsets, reach, depth, owner)
    return covered


# The floor: an infinite plane, in closed form at every pixel.

GRID, REACH = 96, 3.0
"""Points along each side of the grid of openness, and half its width in radii of the scene."""


def prepare_floor(ground: Ground, size: tuple[int, int], sight: Sight, lights: Lights) -> Floor:
    """Return the floor in a picture of this size.

    With ray = forward + right (X - w / 2) / focal - up (Y - h / 2) / focal, affine in the pixel, the point eye + z ray
    lies on the floor n . p = d where 1/z = n . ray / (d - n . eye), also affine: so the floor is in the depth test
    without a triangle.
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
    """Smooth a square grid by ten passes of (1 2 1) / 4 along both axes: a normal distribution 2.2 cells wide, which
    blends the separate shadows of the few sky directions.
    """
    for _ in range(20):
        padded = np.concatenate([grid[:1], grid, grid[-1:]])
        grid = (0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]).T
    return np.ascontiguousarray(grid)


def floor_depth(floor: Floor, size: tuple[int, int], offsets: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return 1/z (h, w, s) float32 of the floor at every sample, 0 where it is not visible."""
    if not floor.ground.active:
        return np.zeros((size[1], size[0], len(offsets)), np.float32)
    plane = floor.plane
    x = np.arange(size[0])[:, None] + offsets[:, 0] / 256.0
    y = np.arange(size[1])[:, None] + offsets[:, 1] / 256.0
    rows, columns = (plane[1] * y + plane[2]).astype(np.float32), (plane[0] * x).astype(np.float32)
    return np.asarray(np.maximum(rows[:, None, :] + columns[None, :, :], np.float32(0.0)))


NEAR = 1e-3
"""Distance of the near plane, relative to that of the target."""


class Raster:
    """Draws meshes by z-buffer with soft shadows, sky occlusion and sheen, on one core.

    Faces of vertices that are not finite are left out, so that a run that diverged can still be drawn. uv (0, 0) is an
    image's upper left corner. One-sided meshes are closed bodies: their back faces are not drawn, and vertices they
    share are shaded smoothly.
    """

    name: ClassVar[str] = "raster"
    Config: ClassVar[type[BaseModel]] = RasterConfig

    def render(self, config: BaseModel, meshes: list[Mesh], camera: Camera) -> NDArray[np.uint8]:
        """Return a picture (height, width, 3) uint8 sRGB. The same input gives the same bytes.

        Raises BadInput for arrays of the wrong shape, face indices out of range, and a camera
        without size, field of view or direction.
        """
        if not isinstance(config, RasterConfig):
            raise TypeError(f"expected a RasterConfig, not a {type(config).__name__}")
        light = radiance(config, meshes, camera)
        picture = encode_picture(light)
        return annotate(picture, config.caption, config.legend)


def radiance(config: RasterConfig, meshes: list[Mesh], camera: Camera) -> Float:
    """Return linear light (height, width, 3), before the shoulder and sRGB. Raises as `Raster.render`."""
    sight = sight_of(camera)
    width, height = camera.size
    up = unit(np.array(config.up))
    origin = np.asarray(camera.target, np.float64)
    scene = gather(refine(meshes, camera), origin, up)
    clip = _project(scene.positions - sight.eye, sight, camera.size)
    lights = prepare_lights(config, scene, camera, up)
    lowest = scene.lowest if len(scene.faces) else math.inf
    ground = find_ground(config, lowest, origin, sight.eye, up, scene.centre, scene.radius)
    floor = prepare_floor(ground, camera.size, sight, lights)
    offsets = sample_offsets(config.samples)
    depth = floor_depth(floor, camera.size, offsets)
    owner = np.full(depth.shape, -1, np.int32)
    near = NEAR * float(np.linalg.norm(sight.eye))
    rasterise(clip, scene.faces, scene.mesh, scene.two_sided, near, offsets, 128, depth, owner)
    picture = np.empty((height, width, 3))
    resolve(owner, offsets, scene, clip, lights, floor, picture)
    return picture


def _project(relative: Float, sight: Sight, size: tuple[int, int]) -> Float:
    """Return homogeneous pixels (n, 3) (X w, Y w, w) of points (n, 3) relative to the eye."""
    _, *axes, focal = sight
    x, y, w = (relative[:, 0] * axis[0] + relative[:, 1] * axis[1] + relative[:, 2] * axis[2] for axis in axes)
    return np.stack([focal * x + size[0] / 2.0 * w, size[1] / 2.0 * w - focal * y, w], axis=1)


def encode_picture(light: Float) -> NDArray[np.uint8]:
    """Return sRGB (h, w, 3) of linear light, highlights rolled off."""
    picture = np.empty(light.shape, np.uint8)
    encode(np.ascontiguousarray(light), _encoding(), picture)
    return picture


@functools.cache
def _encoding() -> NDArray[np.uint8]:
    """Return the table of `encode`."""
    return np.asarray(np.rint(to_srgb(np.linspace(0.0, 1.0, 16384) ** 2) * 255.0).astype(np.uint8))
