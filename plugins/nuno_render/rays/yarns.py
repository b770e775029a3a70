"""The pictures `yarns` and `lines`: knits on bodies, by rays."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

from nuno_render.annotate import annotate
from nuno_render.light.ground import find_ground
from nuno_render.light.lighting import GROUND, KEY, SKY, key_direction, unit
from nuno_render.raster.plugin import encode_picture
from nuno_render.rays.cast import KEEP, cast_rows
from nuno_render.rays.fibre import Look
from nuno_render.rays.worn import check_eye, gather_skin, gather_threads
from nuno_render.rays.yarn_config import CastConfig, LinesConfig, YarnsConfig, grid_of
from nuno_render.sight import sight_of
from nuno_schemas.colour import parse_hex
from nuno_schemas.curves import YarnCurves
from nuno_schemas.drawing import Camera
from nuno_schemas.dye_picture import Picture
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.yarn_picture import Progress, Worn

OFF = 1e-9
"""How far rays start off a surface, in sizes of the scene."""
ROWS = 8
"""Rows that a thread draws at a time."""


class Yarns:
    """Draws yarns as round, translucent bundles of fibres, with shadows on each other and on skin."""

    name: ClassVar[str] = "yarns"
    Config: ClassVar[type[BaseModel]] = YarnsConfig
    curves: ClassVar[bool] = True
    shows: ClassVar[bool] = False

    def draw(self, config: YarnsConfig, worn: Worn, camera: Camera, progress: Progress | None = None) -> Picture:
        """(height, width, 3) uint8 sRGB, the same bytes with any number of threads. Raises as `radiance`."""
        light = radiance(config, worn, camera, progress)
        return annotate(encode_picture(light[..., :3]), config.caption or "", None)


class Lines:
    """Draws every link as a straight line of one colour: the knit paper's figure 14."""

    name: ClassVar[str] = "lines"
    Config: ClassVar[type[BaseModel]] = LinesConfig
    curves: ClassVar[bool] = False
    shows: ClassVar[bool] = False

    def draw(self, config: LinesConfig, worn: Worn, camera: Camera, progress: Progress | None = None) -> Picture:
        """(height, width, 3) uint8 sRGB, the same bytes with any number of threads. Raises BadInput."""
        sight = sight_of(camera)
        pixel = float(np.linalg.norm(sight.eye)) / sight.focal
        flat = replace(worn, yarns=straight(worn, 0.5 * config.width * pixel))
        shared = config.model_dump(include=set(CastConfig.model_fields))
        plain = YarnsConfig(**shared, colour=config.colour, translucency=0.0)
        light = radiance(plain, flat, camera, progress, flat=True)
        return annotate(encode_picture(light[..., :3]), config.caption or "", None)


def straight(worn: Worn, radius: float) -> YarnCurves:
    """Every link as a yarn of its own, of a radius [m]."""
    count = len(worn.links)
    points = worn.points[worn.links].reshape(-1, 3)
    ptr = 2 * np.arange(count + 1, dtype=np.int64)
    kind = np.zeros(count, np.int32)
    return YarnCurves(points, ptr, np.full(count, radius), kind, ("yarn",), np.zeros_like(points))


def radiance(
    config: YarnsConfig, worn: Worn, camera: Camera, progress: Progress | None = None, threads: int | None = None,
    flat: bool = False,
) -> Float:  # fmt: skip
    """(height, width, 4): linear light, and the share of each pixel that is yarn.

    `threads` draw rows side by side, all processors unless given; `flat` yarns are one colour and cast no shadow.
    Raises BadInput for an eye inside of a body, a camera without size, field of view or direction, a yarn without
    thickness, arrays of the wrong shape, and where there are no yarns.
    """
    sight = sight_of(camera)
    if worn.yarns is None or not len(worn.yarns.points):
        raise BadInput("there are no yarns to draw", remedy="draw a knit, or leave the style out")
    check_eye(worn.bodies, camera)
    origin = np.asarray(camera.target, np.float64)
    skin = gather_skin(worn.bodies, origin, config.skin)
    yarns = gather_threads(worn.yarns, origin, config.radius, yarn_colours(config, worn.yarns))
    up = unit(np.array(config.up))
    drawn = np.concatenate([skin.x[np.unique(skin.faces)], yarns.start, yarns.end, np.zeros((1, 3))])
    centre = 0.5 * (drawn.min(axis=0) + drawn.max(axis=0))
    radius = float(np.sqrt(((drawn - centre) ** 2).sum(axis=1).max())) or 1.0
    height, width = camera.size[1], camera.size[0]
    keep = 1 if config.translucency == 0.0 else KEEP
    look = Look(
        sight.eye, key_direction(config, camera, up), KEY, up, SKY, GROUND, config.light_size, config.translucency,
        keep, config.highlight, config.sharpness, config.shadows, config.occlusion, OFF * radius, flat,
    )  # fmt: skip
    solid = skin.x[np.unique(skin.faces)] if len(skin.faces) else np.concatenate([yarns.start, yarns.end])
    floor = find_ground(config, float((solid @ up).min(initial=np.inf)), origin, sight.eye, up, centre, radius)
    grid = (*grid_of(config.samples), config.seed)
    picture = np.empty((height, width, 4))

    def draw(first: int, last: int) -> None:
        cast_rows(first, last, sight, grid, look, skin, yarns, floor, picture)

    in_parts(draw, height, threads, progress)
    return picture


def in_parts(draw: Callable[[int, int], None], height: int, threads: int | None, progress: Progress | None) -> None:
    """Draw rows `first` up to `last`, a few at a time, on several threads."""
    parts = {first: min(first + ROWS, height) for first in range(0, height, ROWS)}
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        waiting = {pool.submit(draw, first, last): last - first for first, last in parts.items()}
        done = 0
        for part in as_completed(waiting):
            part.result()
            done += waiting[part]
            if progress is not None:
                progress(done, height)


def yarn_colours(config: YarnsConfig, yarns: YarnCurves) -> Float:
    """(y, 3) linear light of the yarns."""
    if config.colour is not None:
        return np.tile(parse_hex(config.colour), (yarns.number, 1))
    table = np.stack([parse_hex(colour) for colour in config.colours])
    return np.asarray(table[yarns.kind % len(table)])
