"""Radiance of skin, yarns and the floor toward the eye: one ray to the light and one to the sky each."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_render.rays.hits import Buffers
from nuno_render.rays.worn import Hues, Skin, Threads, free_way
from nuno_render.shading.fibre import scatter
from nuno_render.shading.ground import Ground, fade_at, lay_floor
from nuno_render.shading.shade import raise_point, sky
from nuno_render.sight import place_sample, scramble
from nuno_schemas.fabric import Float

# Light on skin and on yarns.
#
# A yarn scatters the key light as one clear fibre does (nuno_render.shading.fibre), and the sky's by the same energies:
# what passes it is seen through it, straight, as the surface behind is near.
#
# Skin scatters light inside, which carries it beyond the terminator: (n.L + w) / (1 + w), w larger for red, which
# passes skin best.

SKIN_WRAP = np.array([0.34, 0.20, 0.14])
GLOSS, SHARPNESS = 0.05, 18.0
"""Strength and exponent of the skin's highlight."""
BOUNCE = 0.55
"""Light of a surface that hides the sky, relative to the sky's, without its colour."""


class Look(NamedTuple):
    """The settings of a picture by rays.

    eye (3,)              [m]; direction, colour, up, sky, ground and spread as in nuno_render.shading.lighting.Lights
    keep                  the most capsules along a ray
    lobes (4,)            how wide the yarns' highlights are, as in nuno_render.shading.fibre
    shadows, occlusion    whether the key light casts shadows, and whether yarns and bodies hide the sky
    off                   distance of the start of rays from a surface [m]
    flat                  whether yarns have one flat colour and cast no shadow
    """

    eye: Float
    direction: Float
    colour: Float
    up: Float
    sky: Float
    ground: Float
    spread: float
    keep: int
    lobes: Float
    shadows: bool
    occlusion: bool
    off: float
    flat: bool


@kernel
def wrapped(cosine: float, w: float) -> float:
    """Return Lambert's law with the terminator moved by w."""
    return max((cosine + w) / (1.0 + w), 0.0)


@kernel
def ambient_light(albedo: Float, up_part: float, free: float, look: Look, k: int) -> float:
    """Return reflected sky light; surfaces that hide the sky have the same colour."""
    light: float = albedo[k] * sky(up_part, look.sky, look.ground, k) * (free + (1.0 - free) * BOUNCE * albedo[k])
    return light


@kernel
def skin_light(albedo: Float, n: Float, view: Float, look: Look, lit: float, free: float, out: Float) -> None:
    """Write the radiance of skin toward the viewer into out (3,); lit and free as in shade.surface_light."""
    light, light_colour, up = look.direction, look.colour, look.up
    nl = n[0] * light[0] + n[1] * light[1] + n[2] * light[2]
    hx, hy, hz = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    norm = np.sqrt(hx * hx + hy * hy + hz * hz) + 1e-12
    nh = max((n[0] * hx + n[1] * hy + n[2] * hz) / norm, 0.0)
    gloss = GLOSS * nh**SHARPNESS if nl > 0.0 else 0.0
    up_part = n[0] * up[0] + n[1] * up[1] + n[2] * up[2]
    for k in range(3):
        out[k] = light_colour[k] * lit * (albedo[k] * wrapped(nl, SKIN_WRAP[k]) + gloss)
        out[k] += ambient_light(albedo, up_part, free, look, k)


@kernel
def yarn_light(
    hues: Hues, yarn: int, n: Float, t: Float, view: Float, look: Look, lit: float, free: float, out: Float
) -> None:
    """Write the radiance that a yarn with normal n and tangent t sends toward the viewer into out (3,). What passes
    straight through it from behind is not part of it.
    """
    up = look.up
    scatter(t, n, look.direction, view, hues.absorption[yarn], look.lobes, out)
    up_part = n[0] * up[0] + n[1] * up[1] + n[2] * up[2]
    for k in range(3):
        out[k] = look.colour[k] * lit * out[k] + ambient_light(hues.back[yarn], up_part, free, look, k)


LOW = 0.1
"""Least sine of the height over skin of rays to the light. Lower light reaches it through the skin, and its body must
not hide it."""


@kernel
def across(d: Float, u: Float, v: Float) -> None:
    """Write two unit vectors normal to the unit vector d into u and v (Duff et al., JCGT 6(1), 2017)."""
    sign = 1.0 if d[2] >= 0.0 else -1.0
    a = -1.0 / (sign + d[2])
    b = d[0] * d[1] * a
    u[0], u[1], u[2] = 1.0 + sign * d[0] * d[0] * a, sign * b, -sign * d[0]
    v[0], v[1], v[2] = b, sign + d[1] * d[1] * a, -d[1]


@kernel
def receive(
    p: Float, q: Float, n: Float, least: float, look: Look, skin: Skin, threads: Threads, sample: Any, buffers: Buffers
) -> tuple[float, float]:
    """Return (lit, free): shares of the key light at p (3,), and of the sky at q (3,) with unit normal n.

    Rays to the light rise over the surface by at least the sine `least`.

    `sample` chooses one place in the light's disc and in the cosine-weighted half sphere: (number, columns, rows,
    pattern of the pixel).
    """
    keep, light, work = look.keep, look.direction, buffers.work
    number, columns, rows, pattern = sample
    d, u, v = work[0], work[1], work[2]
    lit, free = 1.0, 1.0
    if look.shadows:
        x, y = place_sample(number, columns, rows, scramble(pattern, 11))
        across(light, u, v)
        far, turn = look.spread * np.sqrt(x), 2.0 * np.pi * y
        for k in range(3):
            d[k] = light[k] + far * (np.cos(turn) * u[k] + np.sin(turn) * v[k])
        height = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
        if height < least:
            for k in range(3):
                d[k] += (least - height) * n[k]
        norm = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        for k in range(3):
            d[k] /= norm
        lit = free_way(p, d, skin, threads, look.flat, keep, buffers)
    if look.occlusion:
        x, y = place_sample(number, columns, rows, scramble(pattern, 12))
        across(n, u, v)
        sine, rise, turn = np.sqrt(x), np.sqrt(1.0 - x), 2.0 * np.pi * y
        for k in range(3):
            d[k] = rise * n[k] + sine * (np.cos(turn) * u[k] + np.sin(turn) * v[k])
        free = free_way(q, d, skin, threads, look.flat, keep, buffers)
    return lit, free


@kernel
def find_weights(p: Float, g: Float, x: Float, a: int, b: int, c: int) -> Any:
    """Return weights of corners b and c at a point p (3,) of their triangle, and the length of its normal g (3,)."""
    square, s, r = g[0] * g[0] + g[1] * g[1] + g[2] * g[2] + 1e-300, 0.0, 0.0
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        s += g[k] * ((p[i] - x[a, i]) * (x[c, j] - x[a, j]) - (p[j] - x[a, j]) * (x[c, i] - x[a, i]))
        r += g[k] * ((x[b, i] - x[a, i]) * (p[j] - x[a, j]) - (x[b, j] - x[a, j]) * (p[i] - x[a, i]))
    return s / square, r / square, np.sqrt(square)


@kernel
def shade_skin(
    face: int, d: Float, t: float, look: Look, skin: Skin, threads: Threads, sample: Any, buffers: Buffers, out: Float
) -> None:
    """Write the radiance of a body where a ray meets a triangle into out (3,)."""
    eye, work = look.eye, buffers.work
    p, n, g, albedo, view = work[3], work[4], work[5], work[6], work[7]
    a, b, c = skin.faces[face, 0], skin.faces[face, 1], skin.faces[face, 2]
    x = skin.x
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        g[k] = (x[b, i] - x[a, i]) * (x[c, j] - x[a, j]) - (x[b, j] - x[a, j]) * (x[c, i] - x[a, i])
        p[k], view[k] = eye[k] + t * d[k], -d[k]
    s, r, area = find_weights(p, g, x, a, b, c)
    turn = -1.0 if g[0] * d[0] + g[1] * d[1] + g[2] * d[2] > 0.0 else 1.0
    norm = 0.0
    for k in range(3):
        n[k] = turn * ((1.0 - s - r) * skin.normals[a, k] + s * skin.normals[b, k] + r * skin.normals[c, k])
        albedo[k] = (1.0 - s - r) * skin.albedo[a, k] + s * skin.albedo[b, k] + r * skin.albedo[c, k]
        norm += n[k] * n[k]
    norm = np.sqrt(norm) + 1e-300
    for k in range(3):
        n[k] /= norm
        g[k] *= turn / area
    for k in range(3):
        work[8][k] = p[k] + look.off * g[k]
    raise_point(p, (a, b, c), (1.0 - s - r, s, r), turn, x, skin.normals, work[8])
    lit, free = receive(work[8], work[8], n, LOW, look, skin, threads, sample, buffers)
    skin_light(albedo, n, view, look, lit, free, out)


@kernel
def shade_yarn(
    item: int, d: Float, t: float, look: Look, skin: Skin, threads: Threads, sample: Any, buffers: Buffers, out: Float
) -> None:
    """Write the radiance of a yarn where a ray enters a capsule into out (3,)."""
    eye, light, work = look.eye, look.direction, buffers.work
    p, n, view, axis, tangent = work[3], work[4], work[5], work[6], work[7]
    along, length = 0.0, 0.0
    for k in range(3):
        p[k], view[k] = eye[k] + t * d[k], -d[k]
        axis[k] = threads.end[item, k] - threads.start[item, k]
        along += axis[k] * (p[k] - threads.start[item, k])
        length += axis[k] * axis[k]
    s = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    norm, bend, tl = 0.0, 0.0, 0.0
    for k in range(3):
        work[8][k] = threads.start[item, k] + s * axis[k]
        n[k] = p[k] - work[8][k]
        tangent[k] = (1.0 - s) * threads.first[item, k] + s * threads.last[item, k]
        norm += n[k] * n[k]
        bend += tangent[k] * tangent[k]
    norm, bend = np.sqrt(norm) + 1e-300, np.sqrt(bend) + 1e-300
    for k in range(3):
        n[k] /= norm
        tangent[k] /= bend
        tl += tangent[k] * light[k]
    # The yarn receives the light of the side that faces it, and scatters it inside.
    side = np.sqrt(max(1.0 - tl * tl, 0.0)) + 1e-12
    for k in range(3):
        work[8][k] += (threads.radius[item] + look.off) * (light[k] - tl * tangent[k]) / side
        p[k] += look.off * n[k]
    lit, free = receive(work[8], p, n, -2.0, look, skin, threads, sample, buffers)
    yarn_light(threads.hues, threads.yarn[item], n, tangent, view, look, lit, free, out)


@kernel
def shade_floor(
    d: Float, t: float, floor: Ground, look: Look, skin: Skin, threads: Threads, sample: Any, buffers: Buffers,
    out: Float,
) -> None:  # fmt: skip
    """Blend the radiance of the floor into out (3,), which holds the background."""
    eye, p, up = look.eye, buffers.work[3], look.up
    for k in range(3):
        p[k] = eye[k] + t * d[k]
    fade = fade_at(p[0] - floor.centre[0], p[1] - floor.centre[1], p[2] - floor.centre[2], floor)
    if fade < 1.0:
        lit, free = receive(p, p, up, -2.0, look, skin, threads, sample, buffers)
        lay_floor(fade, lit, free, floor, look, out)
