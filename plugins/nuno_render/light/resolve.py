"""From samples to pixels: surfaces, ground and background, averaged in linear light."""

from __future__ import annotations

import numpy as np

from nuno_render.compiled import kernel
from nuno_render.light.light_maps import shadow
from nuno_render.light.shade import shade_point, sky

# mypy: disable-error-code="no-untyped-def"


@kernel
def background(y, height, top, bottom, out):
    """Gradient from `top` to `bottom` over the picture's height, level at both ends."""
    s = min(max(y / height, 0.0), 1.0)
    s = s * s * (3.0 - 2.0 * s)
    for k in range(3):
        out[k] = top[k] + s * (bottom[k] - top[k])


@kernel
def ground_point(x, y, height, ground, lights, maps, back, out):
    """Ground seen at pixel (x, y), fading into the background with distance, into out (3,)."""
    active, plane, rays, eye, normal, centre, radius, albedo, grid, grid_u, grid_v, grid_scale = ground
    top, bottom = back
    background(y, height, top, bottom, out)
    inverse = plane[0] * x + plane[1] * y + plane[2]
    if not active or inverse <= 0.0:
        return
    px = eye[0] + (rays[0, 0] * x + rays[0, 1] * y + rays[0, 2]) / inverse
    py = eye[1] + (rays[1, 0] * x + rays[1, 1] * y + rays[1, 2]) / inverse
    pz = eye[2] + (rays[2, 0] * x + rays[2, 1] * y + rays[2, 2]) / inverse
    dx, dy, dz = px - centre[0], py - centre[1], pz - centre[2]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz) / radius
    fade = min(max((distance - 1.0) / 4.0, 0.0), 1.0)
    fade = fade * fade * (3.0 - 2.0 * fade)
    if fade >= 1.0:
        return
    light, light_colour, _, sky_light, ground_light, spread = lights
    depths, disc, basis, map_centre, scale = maps
    nl = max(normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2], 0.0)
    lit = 1.0
    if depths.shape[0] > 0 and nl > 0.0:
        lit = shadow(depths, disc, basis, map_centre, scale, px, py, pz, normal[0], normal[1], normal[2], spread)
    free = 1.0
    size = grid.shape[0]
    if size > 1:
        gu = (grid_u[0] * dx + grid_u[1] * dy + grid_u[2] * dz) * grid_scale + 0.5 * (size - 1)
        gv = (grid_v[0] * dx + grid_v[1] * dy + grid_v[2] * dz) * grid_scale + 0.5 * (size - 1)
        if 0.0 <= gu < size - 1.0 and 0.0 <= gv < size - 1.0:
            i, j = int(gv), int(gu)
            s, t = gu - j, gv - i
            free = (grid[i, j] * (1 - s) + grid[i, j + 1] * s) * (1 - t)
            free += (grid[i + 1, j] * (1 - s) + grid[i + 1, j + 1] * s) * t
    for k in range(3):
        radiance = albedo[k] * (light_colour[k] * nl * lit + sky(1.0, sky_light, ground_light, k) * free)
        out[k] += (1.0 - fade) * (radiance - out[k])


@kernel
def resolve(owner, offsets, clip, scene, textures, eye, lights, maps, skies, ground, back, sheen, picture):
    """Shade every pixel into picture (h, w, 3) float64, linear light.

    owner (h, w, s) int32 face of each sample, -1 for none; offsets (s, 2) [1/256 pixel].
    scene, textures, lights, maps, skies, ground, back: tuples of arrays, made in `raster`.
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
                    ground_point(px, py, height, ground, lights, maps, back, colour)
                else:
                    shade_point(face, px, py, clip, scene, textures, eye, lights, maps, skies, sheen, work, colour)
                for k in range(3):
                    picture[row, column, k] += colour[k] * count / samples


@kernel
def encode(picture, table, out):
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
