"""The pictures `density` and `map`: values on the surface of bodies as colours, with a colour bar."""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from nuno_geometry.poses import Vector, blend, row_at, vector
from nuno_kernels import block_kernel, kernel
from nuno_kernels.lanes import dot, minus, plus, times
from nuno_render.annotate import annotate
from nuno_render.config import DensityConfig, Legend, MapConfig, grid_of
from nuno_render.raster import encode_picture
from nuno_render.rays.hits import make_buffers, meet_triangle
from nuno_render.rays.surfaces import find_weights
from nuno_render.rays.worn import Skin, check_eye, gather_skin
from nuno_render.rays.yarns import draw_in_parts
from nuno_render.shading.lighting import key_direction, unit
from nuno_render.sight import Sight, aim, place_sample, scramble, sight_of
from nuno_schemas.colour import colours, parse_hex
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.pictures import Camera, Picture, Progress, SurfaceValues, Worn

# Points near a place: sorted into cells as wide as the reach, so that near ones are in nine runs of three cells.


class SortedPoints(NamedTuple):
    """Points sorted into cells: points (n, 3) [m] in the order of their cells, key (n,) of each cell, values (n,); the
    lowest corner (3,), cells along each axis (3,), and the reach [m].
    """

    points: Float
    key: NDArray[np.int64]
    values: Float
    low: Float
    shape: NDArray[np.int64]
    reach: float


def sort_points(points: Float, values: Float, reach: float) -> SortedPoints:
    """Sort points (n, 3) [m] into cells of a reach, without those that are not finite."""
    finite = np.logical_and.reduce(np.isfinite(points), axis=1)
    points, values = points[finite], values[finite]
    low = points.min(axis=0) - reach if len(points) else np.zeros(3)
    cell = np.floor((points - low) / reach).astype(np.int64)
    shape = cell.max(axis=0, initial=0) + 3
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    return SortedPoints(
        np.ascontiguousarray(points[order]), key[order], values[order].astype(np.float64), low, shape, reach
    )


@kernel
def sum_near(x: float, y: float, z: float, cells: Any) -> tuple[int, float]:
    """Return (count, sum of values) of the points within the reach of a place."""
    reach, low, shape = cells.reach, cells.low, cells.shape
    i, j = int(np.floor((x - low[0]) / reach)), int(np.floor((y - low[1]) / reach))
    k = int(np.floor((z - low[2]) / reach))
    count, total = 0, 0.0
    first, last = max(k - 1, 0), min(k + 1, shape[2] - 1)
    if last < first:
        return count, total
    for a in range(max(i - 1, 0), min(i + 1, shape[0] - 1) + 1):
        for b in range(max(j - 1, 0), min(j + 1, shape[1] - 1) + 1):
            row = (a * shape[1] + b) * shape[2]
            for p in range(np.searchsorted(cells.key, row + first), np.searchsorted(cells.key, row + last + 1)):
                off = minus(row_at(cells.points, p), (x, y, z))
                if dot(off, off) <= reach * reach:
                    count += 1
                    total += cells.values[p]
    return count, total


# Rows of a picture of values on bodies: the first hit of each sample's ray, and the value there.

COUNTS, MEANS, ON_VERTICES, ON_FACES = 0, 1, 2, 3
"""The value of a place: the number of points near, the mean of theirs, its corners' or its face's."""
BACKGROUND = -np.inf


class Shown(NamedTuple):
    """The kind of value, values of vertices or faces, and points with theirs."""

    mode: int
    on_surface: Float
    cells: SortedPoints


@kernel
def value_at(p: Vector, face: int, weights: Any, skin: Skin, shown: Shown) -> Any:
    """Return the value at a point p of a face; NaN if it has none."""
    mode, values = shown.mode, shown.on_surface
    if mode == ON_FACES:
        return values[face]
    a, b, c = skin.faces[face, 0], skin.faces[face, 1], skin.faces[face, 2]
    if mode == ON_VERTICES:
        return weights[0] * values[a] + weights[1] * values[b] + weights[2] * values[c]
    count, total = sum_near(p[0], p[1], p[2], shown.cells)
    if mode == COUNTS:
        return float(count)
    return total / count if count > 0 else np.nan


@block_kernel
def map_rows(
    first: int, last: int, sight: Sight, grid: Any, light: Float, skin: Skin, shown: Shown, out: Float
) -> None:
    """Fill rows `first` to `last` of out (h, w, s, 2): value, and cosine of the smooth normal to the light (3,).

    grid: columns and rows of samples, and the seed.
    """
    eye, buffers = vector(sight.eye), make_buffers(1)
    columns, rows, seed = grid
    height, width = out.shape[0], out.shape[1]
    for row in range(first, last):
        for column in range(width):
            pattern = scramble(row * width + column, seed)
            for sample in range(columns * rows):
                sx, sy = place_sample(sample, columns, rows, pattern)
                d = aim(sight, column + sx, row + sy, width, height)
                face, t = meet_triangle(eye, d, skin.tree, buffers)
                out[row, column, sample, 0], out[row, column, sample, 1] = BACKGROUND, 0.0
                if face < 0:
                    continue
                p, corners = plus(eye, times(t, d)), (skin.faces[face, 0], skin.faces[face, 1], skin.faces[face, 2])
                weights, _, _ = find_weights(p, skin.x, corners)
                n = blend(weights, skin.normals, corners)
                out[row, column, sample, 0] = value_at(p, face, weights, skin, shown)
                out[row, column, sample, 1] = dot(n, light) / np.sqrt(dot(n, n) + 1e-300)


LINKS = 5.0
"""Default reach of points, in mean lengths of a link."""
MOST = 0.95
"""Default share of the visible values within the colours."""


class Map:
    """Shows values of vertices, of faces, or the mean of the points near each place."""

    name: ClassVar[str] = "map"
    Config: ClassVar[type[BaseModel]] = MapConfig
    curves: ClassVar[bool] = False
    shows: ClassVar[bool] = True

    def draw(self, config: MapConfig, worn: Worn, camera: Camera, progress: Progress | None = None) -> Picture:
        """Return a picture (height, width, 3) uint8 sRGB. Raises BadInput without values or for a wrong number."""
        if worn.values is None:
            raise BadInput("there are no values to show", remedy="take the pictures density, yarns or lines")
        return _paint(config, worn, camera, worn.values, MEANS, progress)


class Density:
    """Shows the number of points, where yarns cross, near each place of the skin: the knit paper's figure 18."""

    name: ClassVar[str] = "density"
    Config: ClassVar[type[BaseModel]] = DensityConfig
    curves: ClassVar[bool] = False
    shows: ClassVar[bool] = False

    def draw(self, config: DensityConfig, worn: Worn, camera: Camera, progress: Progress | None = None) -> Picture:
        """Return a picture (height, width, 3) uint8 sRGB. Raises BadInput."""
        label = f"points within {1e3 * config.radius:.3g} mm"
        counted = SurfaceValues("points", np.zeros(len(worn.points)), label)
        return _paint(config, worn, camera, counted, COUNTS, progress)


def reach_of(config: MapConfig, worn: Worn) -> float:
    """Return the reach of points [m]. Raises BadInput without a radius and links."""
    if config.radius is not None:
        return config.radius
    d = worn.points[worn.links[:, 1]] - worn.points[worn.links[:, 0]]
    length = np.sqrt((d * d).sum(axis=1))
    length = length[np.isfinite(length) & (length > 0.0)]
    if not len(length):
        raise BadInput("there are no links whose length says how near is near", field="radius", remedy="give a radius")
    return LINKS * float(length.mean())


def map_values(
    config: MapConfig, worn: Worn, camera: Camera, shown: SurfaceValues, kind: int, progress: Progress | None = None
) -> Float:
    """Return (h, w, samples, 2): the value at each sample, NaN without one and BACKGROUND without a body, and the
    cosine of the surface to the light. Raises BadInput.
    """
    sight = sight_of(camera)
    check_eye(worn.bodies, camera)
    origin = np.asarray(camera.target, np.float64)
    skin = gather_skin(worn.bodies, origin, config.skin, keep_faces=True)
    if not len(skin.faces):
        raise BadInput("there is no body whose surface could show values")
    counts = {"points": len(worn.points), "vertices": len(skin.x), "faces": len(skin.faces)}
    if shown.values.shape != (counts[shown.on],):
        limit = f"({counts[shown.on]},), one for each of the {shown.on}"
        raise BadInput("values of the wrong shape", field="values", value=shown.values.shape, limit=limit)
    reach = reach_of(config, worn) if shown.on == "points" else 1.0
    where = worn.points - origin if shown.on == "points" else np.zeros((0, 3))
    cells = sort_points(where, shown.values if shown.on == "points" else np.zeros(0), reach)
    mode = {"points": kind, "vertices": ON_VERTICES, "faces": ON_FACES}[shown.on]
    columns, rows = grid_of(config.samples)
    up = unit(np.array(config.up))
    light = key_direction(config, camera, up)
    samples = np.empty((camera.size[1], camera.size[0], columns * rows, 2))
    surface_values = Shown(mode, np.ascontiguousarray(shown.values, np.float64), cells)

    def draw(first: int, last: int) -> None:
        map_rows(first, last, sight, (columns, rows, config.seed), light, skin, surface_values, samples)

    draw_in_parts(draw, camera.size[1], None, progress)
    return samples


def _paint(
    config: MapConfig, worn: Worn, camera: Camera, shown: SurfaceValues, kind: int, progress: Progress | None
) -> Picture:
    """Draw values as colours of evenly lit bodies, on the plain background."""
    samples = map_values(config, worn, camera, shown, kind, progress)
    value, cosine = samples[..., 0], samples[..., 1]
    visible = value[np.isfinite(value) & (value != BACKGROUND)]
    low = config.low if config.low is not None else float(visible.min(initial=math.inf))
    high = config.high if config.high is not None else most_of(visible)
    if not (math.isfinite(low) and math.isfinite(high)):
        low, high = 0.0, 1.0
    if config.low is not None and config.high is not None and not low < high:
        raise BadInput("the scale has no extent", field="low", value=low, limit=f"less than high, {high:g}")
    light = colours(value, low, high).reshape(*value.shape, 3)
    light *= (0.72 + 0.28 * np.maximum(cosine, 0.0))[..., None]
    top, bottom = (parse_hex(colour) for colour in config.background)
    s = (np.arange(len(value)) + 0.5) / len(value)
    s = s * s * (3.0 - 2.0 * s)
    light = np.where((value == BACKGROUND)[..., None], (top + s[:, None] * (bottom - top))[:, None, None], light)
    legend = Legend(label=shown.label, low=low, high=high)
    return annotate(encode_picture(light.mean(axis=2)), config.caption or "", legend)


def most_of(seen: Float) -> float:
    """Return the quantile MOST of all values above the least: the maximum of a few places, edges or closed toes, would
    make the rest dark; and bare skin, which is no part of a knit, does not count.
    """
    above = seen[seen > seen.min(initial=math.inf)]
    return float(np.percentile(above, 100.0 * MOST)) if len(above) else float(seen.max(initial=-math.inf))
