"""The lights of a picture, and maps of what they reach."""

from __future__ import annotations

import math

import numpy as np

from nuno_render.config import PictureConfig, RasterConfig
from nuno_render.light.light_maps import Lights, draw_depths
from nuno_render.scene import DrawnScene
from nuno_schemas.drawing import Camera
from nuno_schemas.fabric import Float

KEY = np.array([0.86, 0.82, 0.765])
"""Radiance of a white diffuse surface that faces the key light."""
SKY, GROUND = np.array([0.33, 0.36, 0.405]), np.array([0.20, 0.185, 0.17])
"""Radiance of the sky overhead and of the floor below, which light surfaces."""

SHADOW_SIZE, SKY_SIZE, SKY_AXES, TAPS = 1024, 144, 22, 64
GOLDEN = math.pi * (3.0 - math.sqrt(5.0))
DISC = np.array(
    [
        (math.sqrt((k + 0.5) / TAPS) * math.cos(k * GOLDEN), math.sqrt((k + 0.5) / TAPS) * math.sin(k * GOLDEN))
        for k in range(TAPS)
    ]
)
"""Sunflower arrangement (64, 2): it covers the unit disc evenly, and so does each prefix."""


def unit(vector: Float) -> Float:
    """Return a vector (3,) over its length."""
    return np.asarray(vector / np.linalg.norm(vector))


def tangents(direction: Float) -> Float:
    """Return rows (3, 3): two unit vectors normal to a unit `direction`, then itself."""
    u = unit(np.cross(np.eye(3)[int(np.argmin(np.abs(direction)))], direction))
    return np.ascontiguousarray(np.stack([u, np.cross(direction, u), direction]))


def key_direction(config: PictureConfig, camera: Camera, up: Float) -> Float:
    """Return the unit direction (3,) toward the key light; auto is 52 degrees left of the camera, 50 high."""
    if config.light != "auto":
        return unit(np.array(config.light, np.float64))
    sight = np.asarray(camera.eye, np.float64) - np.asarray(camera.target, np.float64)
    level = sight - (sight @ up) * up
    if np.linalg.norm(level) < 1e-6 * np.linalg.norm(sight):
        level = -np.asarray(camera.up, np.float64)
        level = level - (level @ up) * up
    level = unit(level)
    turn, rise = math.radians(52.0), math.radians(50.0)
    around = math.cos(turn) * level - math.sin(turn) * np.cross(up, level)
    return math.cos(rise) * around + math.sin(rise) * up


def prepare_lights(config: RasterConfig, scene: DrawnScene, camera: Camera, up: Float) -> Lights:
    """Return lights with their maps: depths seen from the key light, and along directions spread evenly over the
    sphere, in opposite pairs that share one projection.

    Rejected: occlusion on the screen, which flickers, leaves halos, and misses surfaces that the camera does not see.
    """
    light, drawn = key_direction(config, camera, up), len(scene.faces) > 0
    size, count = SHADOW_SIZE if config.shadows and drawn else 0, SKY_AXES if config.occlusion and drawn else 0
    depths, basis = np.full((size, size), -np.inf, np.float32), tangents(light)
    scale = SHADOW_SIZE / (2.02 * scene.radius)
    if size:
        none = np.empty((0, 0), np.float32)
        draw_depths(scene.positions, scene.faces, basis, scene.centre, scale, depths, none)
    frame = np.stack([*tangents(up)[:2], up])
    nearest = np.full((count, SKY_SIZE, SKY_SIZE), -np.inf, np.float32)
    farthest, bases, sky_scale = -nearest, np.zeros((count, 3, 3)), SKY_SIZE / (2.04 * scene.radius)
    for k in range(count):
        rise, turn = (k + 0.5) / count, k * GOLDEN
        level = math.sqrt(1.0 - rise * rise)
        axis = np.array([level * math.cos(turn), level * math.sin(turn), rise])
        bases[k] = tangents(unit((axis[:, None] * frame).sum(axis=0)))
        draw_depths(scene.positions, scene.faces, bases[k], scene.centre, sky_scale, nearest[k], farthest[k])
    return Lights(
        light, KEY, up, SKY, GROUND, config.light_size, config.sheen, scene.centre, DISC, depths, basis, scale, nearest,
        farthest, bases, sky_scale,
    )  # fmt: skip
