"""The renderer `raster`: one picture from meshes and a camera."""

from __future__ import annotations

import functools
import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from nuno_render.annotate import annotate
from nuno_render.config import RasterConfig
from nuno_render.light.ground import find_ground
from nuno_render.light.lighting import prepare_lights, unit
from nuno_render.light.resolve import encode, resolve
from nuno_render.raster.floor import floor_depth, prepare_floor
from nuno_render.raster.visibility import rasterise, sample_offsets
from nuno_render.scene import gather
from nuno_render.sight import Sight, sight_of
from nuno_schemas.colour import to_srgb
from nuno_schemas.drawing import Camera, Mesh
from nuno_schemas.fabric import Float

NEAR = 1e-3
"""Distance of the near plane, relative to that of the target."""


class Raster:
    """Draws meshes by z-buffer with soft shadows, sky occlusion and sheen, on one core.

    Vertices that are not finite take their faces with them, so that a run that diverged can
    still be drawn. uv (0, 0) is an image's upper left corner. One-sided meshes are closed
    bodies: their back faces are not drawn, and vertices they share are shaded smoothly.
    """

    name: ClassVar[str] = "raster"
    Config: ClassVar[type[BaseModel]] = RasterConfig

    def render(self, config: BaseModel, meshes: list[Mesh], camera: Camera) -> NDArray[np.uint8]:
        """(height, width, 3) uint8 sRGB. The same input gives the same bytes.

        Raises BadInput for arrays of the wrong shape, face indices out of range, and a camera
        without size, field of view or direction.
        """
        if not isinstance(config, RasterConfig):
            raise TypeError(f"expected a RasterConfig, not a {type(config).__name__}")
        light = radiance(config, meshes, camera)
        picture = encode_picture(light)
        return annotate(picture, config.caption, config.legend)


def radiance(config: RasterConfig, meshes: list[Mesh], camera: Camera) -> Float:
    """(height, width, 3) linear light, before the shoulder and sRGB. Raises as `Raster.render`."""
    sight = sight_of(camera)
    width, height = camera.size
    up = unit(np.array(config.up))
    origin = np.asarray(camera.target, np.float64)
    scene = gather(meshes, origin, up)
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
    """(n, 3) homogeneous pixels (X w, Y w, w) of points (n, 3) relative to the eye."""
    _, *axes, focal = sight
    x, y, w = (relative[:, 0] * axis[0] + relative[:, 1] * axis[1] + relative[:, 2] * axis[2] for axis in axes)
    return np.stack([focal * x + size[0] / 2.0 * w, size[1] / 2.0 * w - focal * y, w], axis=1)


def encode_picture(light: Float) -> NDArray[np.uint8]:
    """(h, w, 3) sRGB of linear light, highlights rolled off."""
    picture = np.empty(light.shape, np.uint8)
    encode(np.ascontiguousarray(light), _encoding(), picture)
    return picture


@functools.cache
def _encoding() -> NDArray[np.uint8]:
    """What `encode` looks up."""
    return np.asarray(np.rint(to_srgb(np.linspace(0.0, 1.0, 16384) ** 2) * 255.0).astype(np.uint8))
