"""The renderer `raster`: one picture from meshes and a camera."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from nuno_render.annotate import annotate
from nuno_render.config import RasterConfig
from nuno_render.light_maps import draw_depths, gather_openness
from nuno_render.resolve import encode, resolve
from nuno_render.scene import Scene, gather
from nuno_render.visibility import rasterise, sample_offsets
from nuno_schemas.camera import Axes, axes
from nuno_schemas.colour import parse_hex, to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Camera, Mesh

KEY = np.array([0.66, 0.635, 0.60])
"""Radiance of a white diffuse surface that faces the key light."""
SKY = np.array([0.40, 0.425, 0.46])
GROUND = np.array([0.24, 0.225, 0.21])
"""Radiance of the sky overhead and of the floor below, for surfaces."""

SHADOW_SIZE, SKY_SIZE, SKY_AXES, GROUND_GRID = 1024, 144, 22, 96
GROUND_REACH = 3.0
"""Half the width of the occlusion grid on the floor, in radii of the scene."""

_DISC = np.array(
    [
        (math.sqrt((k + 0.5) / 32) * math.cos(k * 2.399963), math.sqrt((k + 0.5) / 32) * math.sin(k * 2.399963))
        for k in range(32)
    ]
)
"""Sunflower arrangement: even cover of the unit disc, every prefix of it centred."""


class Raster:
    """Draws meshes by z-buffer with soft shadows, sky occlusion and sheen, on one core.

    Vertices that are not finite take their faces with them. uv (0, 0) is an image's upper left
    corner. One-sided meshes are closed bodies: their back faces are not drawn.
    """

    name: ClassVar[str] = "raster"
    Config: ClassVar[type[BaseModel]] = RasterConfig

    def render(self, config: BaseModel, meshes: list[Mesh], camera: Camera) -> NDArray[np.uint8]:
        """(height, width, 3) uint8 sRGB. The same input gives the same bytes.

        Raises BadInput for arrays of the wrong shape, face indices out of range, and a camera
        without size, field of view or direction.
        """
        assert isinstance(config, RasterConfig)
        picture = np.empty((camera.size[1], camera.size[0], 3), np.uint8) if _check(camera) else np.empty(0, np.uint8)
        encode(radiance(config, meshes, camera), _encoding(), picture)
        return annotate(picture, config.caption, config.legend)


def radiance(config: RasterConfig, meshes: list[Mesh], camera: Camera) -> Float:
    """(height, width, 3) linear light, before the shoulder and sRGB. Raises as `Raster.render`."""
    _check(camera)
    up = _unit(np.array(config.up))
    scene = gather(meshes, np.asarray(camera.target, np.float64), up)
    eye = np.asarray(camera.eye, np.float64) - np.asarray(camera.target, np.float64)
    basis = axes(camera)
    focal = camera.size[1] / 2.0 / math.tan(camera.fov / 2.0)
    clip = _project(scene.positions - eye, basis, focal, camera.size)
    light = _light(config, eye, camera, up)
    height = _ground_height(config, scene, camera, up)
    openness, grid = _openness(config, scene, up, height)
    ground = _ground(config, scene, eye, basis, focal, camera.size, up, height, grid)
    offsets = sample_offsets(config.samples)
    depth = _floor_depth(ground, camera.size, offsets)
    owner = np.full(depth.shape, -1, np.int32)
    near = 1e-3 * float(np.linalg.norm(eye))
    rasterise(clip, scene.faces, scene.mesh, scene.two_sided, near, offsets, 128, depth, owner)
    picture = np.empty((camera.size[1], camera.size[0], 3))
    resolve(
        owner, offsets, clip,
        (scene.positions, scene.normals, scene.albedo, scene.uv, scene.faces, scene.mesh, scene.two_sided, openness),
        (scene.textures.texels, scene.textures.levels, scene.textures.count),
        eye, (light, KEY, up, SKY, GROUND, config.light_size), _shadow_map(config, scene, light), ground,
        (parse_hex(config.background[0]), parse_hex(config.background[1])), config.sheen, picture,
    )  # fmt: skip
    return picture


def _check(camera: Camera) -> bool:
    if not (min(camera.size) >= 1 and max(camera.size) <= 16384):
        raise BadInput("no such picture", field="camera.size", value=camera.size, limit="1 to 16384 pixels a side")
    if not 0.0 < camera.fov < math.pi:
        raise BadInput("no such field of view", field="camera.fov", value=camera.fov, limit="between 0 and pi rad")
    axes(camera)
    return True


def _unit(vector: Float) -> Float:
    return np.asarray(vector / np.linalg.norm(vector))


def _project(relative: Float, basis: Axes, focal: float, size: tuple[int, int]) -> Float:
    """(n, 3) homogeneous pixels (X w, Y w, w) of points relative to the eye."""
    right, up, forward = basis
    # Written out: a BLAS product may differ in its last bits from one machine to the next.
    x, y, w = ((relative * axis).sum(axis=1) for axis in (right, up, forward))
    return np.stack([focal * x + size[0] / 2.0 * w, size[1] / 2.0 * w - focal * y, w], axis=1)


def _light(config: RasterConfig, eye: Float, camera: Camera, up: Float) -> Float:
    """(3,) unit direction toward the key light."""
    if config.light != "auto":
        return _unit(np.array(config.light, np.float64))
    level = eye - (eye @ up) * up
    if np.linalg.norm(level) < 1e-6 * np.linalg.norm(eye):
        level = -np.asarray(camera.up, np.float64)
    level = _unit(level)
    turn, rise = math.radians(42.0), math.radians(50.0)
    around = math.cos(turn) * level - math.sin(turn) * np.cross(up, level)
    return _unit(math.cos(rise) * around + math.sin(rise) * up)


def _tangents(direction: Float) -> Float:
    """(3, 3) rows: two unit vectors across `direction`, then itself."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    u = _unit(np.cross(helper, direction))
    return np.ascontiguousarray(np.stack([u, np.cross(direction, u), direction]))


def _shadow_map(config: RasterConfig, scene: Scene, light: Float) -> tuple[NDArray[np.generic] | float, ...]:
    size = SHADOW_SIZE if config.shadows and len(scene.faces) else 0
    depths = np.full((size, size), -np.inf, np.float32)
    basis, scale = _tangents(light), SHADOW_SIZE / (2.02 * scene.radius)
    if size:
        none = np.empty((0, 0), np.float32)
        draw_depths(scene.positions, scene.faces, basis, scene.centre, scale, depths, none)
    return depths, _DISC, basis, scene.centre, scale


def _ground_height(config: RasterConfig, scene: Scene, camera: Camera, up: Float) -> float | None:
    """Height of the floor above the camera's target [m], or None."""
    if config.ground == "none" or (config.ground == "auto" and not len(scene.faces)):
        return None
    if config.ground == "auto":
        return scene.lowest
    return float(config.ground - np.asarray(camera.target, np.float64) @ up)


def _openness(config: RasterConfig, scene: Scene, up: Float, height: float | None) -> tuple[Float, Float]:
    """Part of the sky light that reaches each vertex, (n, 2) front and back, and the floor, (g, g).

    Directions are spread evenly over the sphere, in opposite pairs that share one projection.
    Vertex values are smooth, do not flicker with the view, and cost no work per pixel.
    """
    size = GROUND_GRID if height is not None else 0
    if not config.occlusion or not len(scene.faces):
        return np.ones((len(scene.positions), 2)), np.ones((1, 1))
    u, v, _ = _tangents(up)
    place = (np.arange(size) / max(size - 1, 1) * 2.0 - 1.0) * GROUND_REACH * scene.radius
    floor = scene.centre + ((height or 0.0) - scene.centre @ up) * up
    points = (floor + place[None, :, None] * u + place[:, None, None] * v).reshape(-1, 3)
    points = np.ascontiguousarray(np.concatenate([scene.positions, points]))
    normals = np.ascontiguousarray(np.concatenate([scene.normals, np.tile(up, (size * size, 1))]))
    free, total = np.zeros((len(points), 2)), np.full((len(points), 2), 1e-9)
    scale = SKY_SIZE / (2.04 * scene.radius)
    frame = np.stack([u, v, up])
    for k in range(SKY_AXES):
        rise = (k + 0.5) / SKY_AXES
        level, turn = math.sqrt(1.0 - rise * rise), k * 2.399963
        axis = np.array([level * math.cos(turn), level * math.sin(turn), rise])
        basis = _tangents(_unit(axis @ frame))
        nearest = np.full((SKY_SIZE, SKY_SIZE), -np.inf, np.float32)
        farthest = np.full((SKY_SIZE, SKY_SIZE), np.inf, np.float32)
        draw_depths(scene.positions, scene.faces, basis, scene.centre, scale, nearest, farthest)
        offset = 1.5 / scale
        gather_openness(points, normals, basis, scene.centre, scale, nearest, farthest, offset, free, total)
    openness = (free + 1e-9) / total
    openness = np.minimum(openness, 1.0)
    return openness[: len(scene.positions)], np.ascontiguousarray(
        openness[len(scene.positions) :, 0].reshape(size, size)
    )


def _ground(
    config: RasterConfig, scene: Scene, eye: Float, basis: Axes, focal: float, size: tuple[int, int],
    up: Float, height: float | None, grid: Float,
) -> tuple[object, ...]:  # fmt: skip
    """What `ground_point` takes. With ray (X, Y) = forward + ..., affine in the pixel, a point
    eye + w ray lies on the floor up . p = h where 1/w = up . ray / (h - up . eye): affine too."""
    right, above, forward = basis
    rays = np.stack([right / focal, -above / focal, forward], axis=1)
    rays[:, 2] -= rays[:, 0] * size[0] / 2.0 + rays[:, 1] * size[1] / 2.0
    drop = (height if height is not None else 0.0) - 1e-4 * scene.radius - eye @ up
    active = height is not None and drop < 0.0
    plane = (up @ rays) / drop if active else np.zeros(3)
    floor = scene.centre + ((height or 0.0) - scene.centre @ up) * up
    u, v, _ = _tangents(up)
    grid_scale = (grid.shape[0] - 1) / 2.0 / (GROUND_REACH * scene.radius)
    colour = parse_hex(config.ground_colour)
    return active, plane, rays, eye, up, floor, scene.radius, colour, grid, u, v, grid_scale


def _floor_depth(ground: tuple[object, ...], size: tuple[int, int], offsets: NDArray[np.int64]) -> NDArray[np.float32]:
    """(h, w, s) float32 1/w of the floor at every sample, 0 where it is not seen."""
    plane = np.asarray(ground[1], np.float64)
    x = np.arange(size[0])[:, None] + offsets[:, 0] / 256.0
    y = np.arange(size[1])[:, None] + offsets[:, 1] / 256.0
    if not ground[0]:
        return np.zeros((size[1], size[0], len(offsets)), np.float32)
    rows, columns = (plane[1] * y + plane[2]).astype(np.float32), (plane[0] * x).astype(np.float32)
    return np.maximum(rows[:, None, :] + columns[None, :, :], np.float32(0.0))


def _encoding() -> NDArray[np.uint8]:
    return np.rint(to_srgb(np.linspace(0.0, 1.0, 16384) ** 2) * 255.0).astype(np.uint8)
