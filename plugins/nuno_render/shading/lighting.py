"""The lights of a picture, and depth maps seen along directions, which give shadows and the openness of a point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.poses import Vector, row_at, vector
from nuno_kernels import kernel
from nuno_kernels.lanes import dot, minus, plus, times
from nuno_render.config import PictureConfig, RasterConfig
from nuno_render.scene import DrawnScene
from nuno_schemas.fabric import Float, Int
from nuno_schemas.pictures import Camera

# Depth maps seen along directions, which give shadows and the openness of a point.


class Lights(NamedTuple):
    """The lights of a picture, and maps of what they reach.

    direction (3,)        toward the key light; colour (3,) radiance of a white diffuse surface that faces it
    up (3,)               away from the floor; sky, ground (3,) radiance of the sky overhead and of the floor below
    spread                tangent of the key light's angular radius
    sheen                 strength of the velvet-like rim of cloth
    centre (3,)           middle of all maps [m]
    disc (k, 2)           taps in the unit disc
    depths (r, r)         seen along basis[2], basis (3, 3), at `scale` [texels/m] (draw_depths); r = 0: no shadows
    nearest, farthest (k, r, r)  seen along k axes, their bases (k, 3, 3) and `sky_scale`; k = 0 if all is open
    """

    direction: Float
    colour: Float
    up: Float
    sky: Float
    ground: Float
    spread: float
    sheen: float
    centre: Float
    disc: Float
    depths: NDArray[np.float32]
    basis: Float
    scale: float
    nearest: NDArray[np.float32]
    farthest: NDArray[np.float32]
    bases: Float
    sky_scale: float


@kernel
def on_map(p: Vector, basis: Float, scale: float, size: int) -> Vector:
    """Return the place of a point on a map, right and down [texels], and its distance along the map's axis; the point
    is relative to the middle of the map, which has `size` texels a side.
    """
    u, v = dot(row_at(basis, 0), p) * scale + 0.5 * size, dot(row_at(basis, 1), p) * scale + 0.5 * size
    return u, v, dot(row_at(basis, 2), p)


@kernel
def draw_depths(
    positions: Float, faces: Int, basis: Float, centre: Float, scale: float, nearest: NDArray[np.float32],
    farthest: NDArray[np.float32],
) -> None:  # fmt: skip
    """Project all faces in parallel into two maps of signed distance along basis[2].

    positions (n, 3); faces (f, 3); basis (3, 3) rows u, v and the direction toward the light; centre (3,) is at the
    middle of the maps; scale [texels/m]; nearest (r, r) float32 starts at -inf and keeps the largest distance; farthest
    likewise at +inf the smallest, unless (0, 0). Edges count as inside: a crack would let light through, but surplus
    hits are invisible.
    """
    size = nearest.shape[0]
    both = farthest.shape[0] > 0
    count = positions.shape[0]
    seen = np.empty((count, 3))
    for i in range(count):
        seen[i, 0], seen[i, 1], seen[i, 2] = on_map(minus(row_at(positions, i), centre), basis, scale, size)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, bx, by, cx, cy = seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if not abs(area) > 1e-12:
            continue
        inverse = 1.0 / area
        left = int(max(np.ceil(min(ax, bx, cx) - 0.5), 0.0))
        right = int(min(np.floor(max(ax, bx, cx) - 0.5), size - 1.0))
        top = int(max(np.ceil(min(ay, by, cy) - 0.5), 0.0))
        bottom = int(min(np.floor(max(ay, by, cy) - 0.5), size - 1.0))
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                wb = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) * inverse
                wc = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) * inverse
                if wb < -1e-9 or wc < -1e-9 or wb + wc > 1.0 + 1e-9:
                    continue
                z = np.float32(seen[a, 2] + wb * (seen[b, 2] - seen[a, 2]) + wc * (seen[c, 2] - seen[a, 2]))
                nearest[row, column] = max(nearest[row, column], z)
                if both and z < farthest[row, column]:
                    farthest[row, column] = z


@kernel
def open_part(depths: NDArray[np.float32], x: float, y: float, z: float, sign: float) -> float:
    """Return the share of a bilinear texel footprint at (x, y) that does not block a point at z. sign +1: surfaces
    above z block it; -1: those below (farthest map).
    """
    size = depths.shape[0]
    x -= 0.5
    y -= 0.5
    column, row = int(np.floor(x)), int(np.floor(y))
    if column < 0 or row < 0 or column + 1 >= size or row + 1 >= size:
        return 1.0
    fx, fy = x - column, y - row
    result = 0.0
    if sign * (depths[row, column] - z) <= 0.0:
        result += (1.0 - fx) * (1.0 - fy)
    if sign * (depths[row, column + 1] - z) <= 0.0:
        result += fx * (1.0 - fy)
    if sign * (depths[row + 1, column] - z) <= 0.0:
        result += (1.0 - fx) * fy
    if sign * (depths[row + 1, column + 1] - z) <= 0.0:
        result += fx * fy
    return result


@kernel
def openness(p: Vector, n: Vector, lights: Lights) -> float:
    """Return the share of the sky's light that reaches a point p, 0 to 1.

    n is its unit normal on the visible side. Each axis of the sky's maps serves the
    one of its two directions that the normal faces, weighted by cosine and by a sky that is brighter overhead. Without
    maps everything is open.
    """
    nearest, farthest, bases, up = lights.nearest, lights.farthest, lights.bases, lights.up
    centre, scale = lights.centre, lights.sky_scale
    size = nearest.shape[1]
    lift = 1.5 / scale
    raised = plus(minus(p, centre), times(lift, n))
    total, free = 0.0, 0.0
    for k in range(nearest.shape[0]):
        basis = bases[k]
        axis = row_at(basis, 2)
        cosine = dot(n, axis)
        sign = 1.0 if cosine >= 0.0 else -1.0
        u, v, w = on_map(raised, basis, scale, size)
        # A slope rises within a texel: the tolerance grows with it, up to a limit.
        slope = np.sqrt(max(1.0 - cosine * cosine, 0.0)) / max(abs(cosine), 0.1)
        slack = lift * (0.5 + min(slope, 4.0))
        weight = abs(cosine) * (0.8 + 0.5 * sign * dot(axis, up))
        total += weight
        free += weight * open_part(nearest[k] if sign > 0.0 else farthest[k], u, v, w + sign * slack, sign)
    return free / total if total > 0.0 else 1.0


@kernel
def floor_openness(corner: Float, across: Float, along: Float, lights: Lights, out: Float) -> None:
    """Write the openness of a floor at corner + j across + i along into out[i, j]; all vectors (3,) [m]."""
    up = vector(lights.up)
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = openness(plus(plus(corner, times(j, across)), times(i, along)), up, lights)


@kernel
def shadow(p: Vector, n: Vector, lights: Lights) -> float:
    """Return the share of the key light that reaches a point p, lifted off its surface, 0 to 1: percentage-closer soft
    shadows. n is the surface's unit normal on the lit side.

    The taps compare with the receiver's own tangent plane rather than with one depth, so that a
    wide filter neither darkens a slope (acne) nor needs a large bias (detached shadows). The
    width is that of the penumbra: distance to the mean blocker times the spread (Fernando 2005).
    """
    depths, disc, basis, scale = lights.depths, lights.disc, lights.basis, lights.scale
    size = depths.shape[0]
    u, v, w = on_map(minus(p, lights.centre), basis, scale, size)
    facing = max(dot(row_at(basis, 2), n), 0.15)
    gu, gv = -dot(row_at(basis, 0), n) / (facing * scale), -dot(row_at(basis, 1), n) / (facing * scale)
    search = 0.02 * size
    blockers, clear, total = 0, 0, 0.0
    taps = disc.shape[0]
    for k in range(0, taps, 4):
        du, dv = disc[k, 0] * search, disc[k, 1] * search
        column, row = int(np.floor(u + du)), int(np.floor(v + dv))
        if column < 0 or row < 0 or column >= size or row >= size:
            continue
        above = depths[row, column] - (w + gu * du + gv * dv)
        if above > (abs(gu) + abs(gv)):
            blockers += 1
            total += above
        else:
            clear += 1
    mean = total / blockers if blockers > 0 else 0.0
    radius = min(max(mean * lights.spread * scale, 1.5), search)
    if blockers == 0 or clear == 0:
        taps //= 4
    result = 0.0
    for k in range(taps):
        du, dv = disc[k, 0] * radius, disc[k, 1] * radius
        result += open_part(depths, u + du, v + dv, w + gu * du + gv * dv, 1.0)
    lit: float = result / taps
    return lit


# The lights of a picture, and maps of what they reach.

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
