"""The pictures `yarns` and `lines`: knits on bodies, by rays."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel

from nuno_geometry.poses import Vector, vector
from nuno_kernels import block_kernel, kernel
from nuno_kernels.lanes import dot
from nuno_render.annotate import annotate
from nuno_render.config import CastConfig, LinesConfig, YarnsConfig, grid_of
from nuno_render.raster import encode_picture
from nuno_render.rays.hits import Buffers, make_buffers, meet_triangle
from nuno_render.rays.surfaces import Look, shade_floor, shade_skin, shade_yarn
from nuno_render.rays.worn import Hues, Skin, Threads, check_eye, cross_yarns, gather_skin, gather_threads
from nuno_render.shading.fibre import find_absorption, find_energies, find_lobes
from nuno_render.shading.ground import Ground, background, find_ground
from nuno_render.shading.lighting import GROUND, KEY, SKY, key_direction, unit
from nuno_render.sight import Sight, aim, place_sample, scramble, sight_of
from nuno_schemas.colour import parse_hex
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.operation import YarnCurves
from nuno_schemas.pictures import Camera, Picture, Progress, Worn

# Rows of a picture of yarns on bodies, by rays. Each sample's ray ends at the first body, or the floor. Yarns that it
# crosses transmit a share of the light behind them, each crossing once however many of the yarn's capsules it passes,
# and at most KEEP of them; from each hit one ray goes to the light and one to the sky. Nothing is blurred: the mean of
# the samples gives a yarn thinner than a pixel its true coverage, and so the knit becomes denser toward the silhouette.

KEEP = 16
"""The most capsules along a ray."""
FAINT = 1.0 / 1024.0
"""Transmitted share below which surfaces behind yarns are not computed."""


@kernel
def see(
    d: Vector, down: float, look: Look, skin: Skin, threads: Threads, floor: Ground, sample: Any, buffers: Buffers,
    out: Float,
) -> None:  # fmt: skip
    """Write radiance and the yarns' share of it along a ray, at a share `down` of the picture's height, to out (4,)."""
    eye, hues = vector(look.eye), threads.hues
    face, most = meet_triangle(eye, d, skin.tree, buffers)
    fall = dot(look.up, d)
    on_floor = False
    if floor.active and fall < 0.0 and floor.drop / fall < most:
        face, most, on_floor = -1, floor.drop / fall, True
    count = cross_yarns(eye, d, most, threads, look.keep, buffers)
    items, enters = buffers.met, buffers.met_at
    for i in range(count):
        items[i], enters[i] = buffers.items[i], buffers.enters[i]
    colour, weight = buffers.work[0], buffers.work[1]
    for k in range(3):
        out[k], weight[k] = 0.0, 1.0
    for i in range(count):
        if max(weight[0], weight[1], weight[2]) < FAINT:
            break
        yarn = threads.yarn[items[i]]
        if look.flat:
            for k in range(3):
                colour[k] = hues.colour[yarn, k]
        else:
            shade_yarn(items[i], d, enters[i], look, skin, threads, sample, buffers, colour)
        for k in range(3):
            out[k] += weight[k] * colour[k]
            weight[k] *= hues.passed[yarn, k]
    out[3] = 1.0 - (weight[0] + weight[1] + weight[2]) / 3.0
    if max(weight[0], weight[1], weight[2]) < FAINT:
        return
    background(down, floor, colour)
    if face >= 0:
        shade_skin(face, d, most, look, skin, threads, sample, buffers, colour)
    elif on_floor:
        shade_floor(d, most, floor, look, skin, threads, sample, buffers, colour)
    for k in range(3):
        out[k] += weight[k] * colour[k]


@block_kernel
def cast_rows(
    first: int, last: int, sight: Sight, grid: Any, look: Look, skin: Skin, threads: Threads, floor: Ground,
    picture: Float,
) -> None:  # fmt: skip
    """Fill rows `first` to `last` of picture (h, w, 4), linear light and the yarns' share of each pixel.

    grid: columns and rows of samples, and the seed.
    """
    columns, rows, seed = grid
    height, width = picture.shape[0], picture.shape[1]
    buffers, out = make_buffers(KEEP), np.empty(4)
    samples = columns * rows
    for row in range(first, last):
        for column in range(width):
            pattern = scramble(row * width + column, seed)
            total = (0.0, 0.0, 0.0, 0.0)
            for s in range(samples):
                x, y = place_sample(s, columns, rows, pattern)
                d = aim(sight, column + x, row + y, width, height)
                sample = (s, columns, rows, pattern)
                see(d, (row + y) / height, look, skin, threads, floor, sample, buffers, out)
                total = (total[0] + out[0], total[1] + out[1], total[2] + out[2], total[3] + out[3])
            for k in range(4):
                picture[row, column, k] = total[k] / samples


OFF = 1e-9
"""Distance of the start of rays from a surface, in radii of the scene."""
ROWS = 8
"""Rows that a thread draws at a time."""


class Yarns:
    """Draws yarns as round, translucent bundles of fibres, with shadows on each other and on skin."""

    name: ClassVar[str] = "yarns"
    Config: ClassVar[type[BaseModel]] = YarnsConfig
    curves: ClassVar[bool] = True
    shows: ClassVar[bool] = False

    def draw(self, config: YarnsConfig, worn: Worn, camera: Camera, progress: Progress | None = None) -> Picture:
        """Return a picture (height, width, 3) uint8 sRGB, equal for any number of threads. Raises as `radiance`."""
        light = radiance(config, worn, camera, progress)
        return annotate(encode_picture(light[..., :3]), config.caption or "", None)


class Lines:
    """Draws every link as a straight line of one colour: the knit paper's figure 14."""

    name: ClassVar[str] = "lines"
    Config: ClassVar[type[BaseModel]] = LinesConfig
    curves: ClassVar[bool] = False
    shows: ClassVar[bool] = False

    def draw(self, config: LinesConfig, worn: Worn, camera: Camera, progress: Progress | None = None) -> Picture:
        """Return a picture (height, width, 3) uint8 sRGB, equal for any number of threads. Raises BadInput."""
        sight = sight_of(camera)
        pixel = float(np.linalg.norm(sight.eye)) / sight.focal
        flat = replace(worn, yarns=straight(worn, 0.5 * config.width * pixel))
        shared = config.model_dump(include=set(CastConfig.model_fields))
        plain = YarnsConfig(**shared, colour=config.colour, translucency=0.0)
        light = radiance(plain, flat, camera, progress, flat=True)
        return annotate(encode_picture(light[..., :3]), config.caption or "", None)


def straight(worn: Worn, radius: float) -> YarnCurves:
    """Return every link as a separate yarn of a radius [m]."""
    count = len(worn.links)
    points = worn.points[worn.links].reshape(-1, 3)
    ptr = 2 * np.arange(count + 1, dtype=np.int64)
    kind = np.zeros(count, np.int32)
    return YarnCurves(points, ptr, np.full(count, radius), kind, ("yarn",), np.zeros_like(points))


def radiance(
    config: YarnsConfig, worn: Worn, camera: Camera, progress: Progress | None = None, threads: int | None = None,
    flat: bool = False,
) -> Float:  # fmt: skip
    """Return linear light, and the share of yarn in each pixel (height, width, 4).

    `threads` draw rows in parallel, by default all processors; `flat` yarns are one colour and cast no shadow. Raises
    BadInput for an eye inside of a body, a camera without size, field of view or direction, a yarn without thickness,
    arrays of the wrong shape, and without yarns.
    """
    sight = sight_of(camera)
    if worn.yarns is None or not len(worn.yarns.points):
        raise BadInput("there are no yarns to draw", remedy="draw a knit, or leave the style out")
    check_eye(worn.bodies, camera)
    origin = np.asarray(camera.target, np.float64)
    skin = gather_skin(worn.bodies, origin, config.skin)
    yarns = gather_threads(worn.yarns, origin, config.radius, yarn_hues(config, worn.yarns))
    up = unit(np.array(config.up))
    drawn = np.concatenate([skin.x[np.unique(skin.faces)], yarns.start, yarns.end, np.zeros((1, 3))])
    centre = 0.5 * (drawn.min(axis=0) + drawn.max(axis=0))
    radius = float(np.sqrt(((drawn - centre) ** 2).sum(axis=1).max())) or 1.0
    height, width = camera.size[1], camera.size[0]
    keep = 1 if config.translucency == 0.0 else KEEP
    look = Look(
        sight.eye, key_direction(config, camera, up), KEY, up, SKY, GROUND, config.light_size,
        keep, find_lobes(config.roughness), config.shadows, config.occlusion, OFF * radius, flat,
    )  # fmt: skip
    solid = skin.x[np.unique(skin.faces)] if len(skin.faces) else np.concatenate([yarns.start, yarns.end])
    floor = find_ground(config, float((solid @ up).min(initial=np.inf)), origin, sight.eye, up, centre, radius)
    grid = (*grid_of(config.samples), config.seed)
    picture = np.empty((height, width, 4))

    def draw(first: int, last: int) -> None:
        cast_rows(first, last, sight, grid, look, skin, yarns, floor, picture)

    draw_in_parts(draw, height, threads, progress)
    return picture


def draw_in_parts(
    draw: Callable[[int, int], None], height: int, threads: int | None, progress: Progress | None
) -> None:
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


def yarn_hues(config: YarnsConfig, yarns: YarnCurves) -> Hues:
    """Return the colours of all yarns, and what they do to light."""
    if config.colour is not None:
        colour = np.tile(parse_hex(config.colour), (yarns.number, 1))
    else:
        table = np.stack([parse_hex(colour) for colour in config.colours])
        colour = table[yarns.kind % len(table)]
    absorption = find_absorption(colour, config.roughness)
    passed, back = find_energies(absorption)
    return Hues(colour, absorption, passed if config.translucency is None else 0.0 * passed + config.translucency, back)
