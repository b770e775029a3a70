"""Radiance of skin, yarns and the floor toward the eye: one ray to the light and one to the sky each."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_geometry.poses import Vector, blend, row_at, vector
from nuno_kernels import kernel
from nuno_kernels.lanes import cross, dot, minus, over, plus, times
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
def ambient_light(albedo: Any, up_part: float, free: float, look: Look, k: int) -> float:
    """Return reflected sky light; surfaces that hide the sky have the same colour."""
    light: float = albedo[k] * sky(up_part, look.sky, look.ground, k) * (free + (1.0 - free) * BOUNCE * albedo[k])
    return light


@kernel
def skin_light(albedo: Vector, n: Vector, view: Vector, look: Look, lit: float, free: float, out: Float) -> None:
    """Write the radiance of skin toward the viewer into out (3,); lit and free as in shade.surface_light."""
    half, nl, up_part = plus(look.direction, view), dot(n, look.direction), dot(n, look.up)
    nh = max(dot(n, half) / (np.sqrt(dot(half, half)) + 1e-12), 0.0)
    gloss = GLOSS * nh**SHARPNESS if nl > 0.0 else 0.0
    for k in range(3):
        out[k] = look.colour[k] * lit * (albedo[k] * wrapped(nl, SKIN_WRAP[k]) + gloss)
        out[k] += ambient_light(albedo, up_part, free, look, k)


@kernel
def yarn_light(
    hues: Hues, yarn: int, n: Vector, t: Vector, view: Vector, look: Look, lit: float, free: float, out: Float
) -> None:
    """Write the radiance that a yarn with normal n and tangent t sends toward the viewer into out (3,). What passes
    straight through it from behind is not part of it.
    """
    scatter(t, n, look.direction, view, hues.absorption[yarn], look.lobes, out)
    up_part = dot(n, look.up)
    for k in range(3):
        out[k] = look.colour[k] * lit * out[k] + ambient_light(hues.back[yarn], up_part, free, look, k)


LOW = 0.1
"""Least sine of the height over skin of rays to the light. Lower light reaches it through the skin, and its body must
not hide it."""


@kernel
def across(d: Vector) -> tuple[Vector, Vector]:
    """Return two unit vectors normal to the unit vector d (Duff et al., JCGT 6(1), 2017)."""
    sign = 1.0 if d[2] >= 0.0 else -1.0
    a = -1.0 / (sign + d[2])
    b = d[0] * d[1] * a
    return (1.0 + sign * d[0] * d[0] * a, sign * b, -sign * d[0]), (b, sign + d[1] * d[1] * a, -d[1])


@kernel
def on_circle(axis: Vector, turn: float) -> Vector:
    """Return the unit vector normal to a unit vector at an angle [rad] about it."""
    u, v = across(axis)
    return plus(times(np.cos(turn), u), times(np.sin(turn), v))


@kernel
def receive(
    p: Vector, q: Vector, n: Vector, least: float, look: Look, skin: Skin, threads: Threads, sample: Any,
    buffers: Buffers,
) -> tuple[float, float]:  # fmt: skip
    """Return (lit, free): shares of the key light at p, and of the sky at q with unit normal n.

    Rays to the light rise over the surface by at least the sine `least`.
    `sample` chooses one place in the light's disc and in the cosine-weighted half sphere: (number, columns, rows,
    pattern of the pixel).
    """
    number, columns, rows, pattern = sample
    lit, free = 1.0, 1.0
    if look.shadows:
        x, y = place_sample(number, columns, rows, scramble(pattern, 11))
        light = vector(look.direction)
        d = plus(light, times(look.spread * np.sqrt(x), on_circle(light, 2.0 * np.pi * y)))
        height = dot(n, d)
        if height < least:
            d = plus(d, times(least - height, n))
        lit = free_way(p, over(d, np.sqrt(dot(d, d))), skin, threads, look.flat, look.keep, buffers)
    if look.occlusion:
        x, y = place_sample(number, columns, rows, scramble(pattern, 12))
        d = plus(times(np.sqrt(1.0 - x), n), times(np.sqrt(x), on_circle(n, 2.0 * np.pi * y)))
        free = free_way(q, d, skin, threads, look.flat, look.keep, buffers)
    return lit, free


@kernel
def find_weights(p: Vector, x: Float, corners: Any) -> tuple[Vector, Vector, float]:
    """Return the weights of a triangle's corners at a point p of it, its normal, and the length of that."""
    a = row_at(x, corners[0])
    ab, ac, ap = minus(row_at(x, corners[1]), a), minus(row_at(x, corners[2]), a), minus(p, a)
    g = cross(ab, ac)
    square = dot(g, g) + 1e-300
    s, r = dot(g, cross(ap, ac)) / square, dot(g, cross(ab, ap)) / square
    return (1.0 - s - r, s, r), g, np.sqrt(square)


@kernel
def shade_skin(
    face: int, d: Vector, t: float, look: Look, skin: Skin, threads: Threads, sample: Any, buffers: Buffers, out: Float
) -> None:
    """Write the radiance of a body where a ray meets a triangle into out (3,)."""
    corners, p = (skin.faces[face, 0], skin.faces[face, 1], skin.faces[face, 2]), plus(look.eye, times(t, d))
    weights, g, area = find_weights(p, skin.x, corners)
    turn = -1.0 if dot(g, d) > 0.0 else 1.0
    n = times(turn, blend(weights, skin.normals, corners))
    n = over(n, np.sqrt(dot(n, n)) + 1e-300)
    start = plus(p, times(look.off, times(turn / area, g)))
    start = raise_point(p, start, corners, weights, turn, skin.x, skin.normals)
    lit, free = receive(start, start, n, LOW, look, skin, threads, sample, buffers)
    skin_light(blend(weights, skin.albedo, corners), n, times(-1.0, d), look, lit, free, out)


@kernel
def shade_yarn(
    item: int, d: Vector, t: float, look: Look, skin: Skin, threads: Threads, sample: Any, buffers: Buffers, out: Float
) -> None:
    """Write the radiance of a yarn where a ray enters a capsule into out (3,)."""
    light, p, start = look.direction, plus(look.eye, times(t, d)), row_at(threads.start, item)
    axis = minus(row_at(threads.end, item), start)
    length = dot(axis, axis)
    s = min(max(dot(axis, minus(p, start)) / length, 0.0), 1.0) if length > 0.0 else 0.0
    middle = plus(start, times(s, axis))
    n = minus(p, middle)
    n = over(n, np.sqrt(dot(n, n)) + 1e-300)
    tangent = plus(times(1.0 - s, row_at(threads.first, item)), times(s, row_at(threads.last, item)))
    tangent = over(tangent, np.sqrt(dot(tangent, tangent)) + 1e-300)
    tl = dot(tangent, light)
    # The yarn receives the light of the side that faces it, and scatters it inside.
    side = over(minus(light, times(tl, tangent)), np.sqrt(max(1.0 - tl * tl, 0.0)) + 1e-12)
    on_lit_side = plus(middle, times(threads.radius[item] + look.off, side))
    lit, free = receive(on_lit_side, plus(p, times(look.off, n)), n, -2.0, look, skin, threads, sample, buffers)
    yarn_light(threads.hues, threads.yarn[item], n, tangent, times(-1.0, d), look, lit, free, out)


@kernel
def shade_floor(
    d: Vector, t: float, floor: Ground, look: Look, skin: Skin, threads: Threads, sample: Any, buffers: Buffers,
    out: Float,
) -> None:  # fmt: skip
    """Blend the radiance of the floor into out (3,), which holds the background."""
    p = plus(look.eye, times(t, d))
    fade = fade_at(minus(p, floor.centre), floor)
    if fade < 1.0:
        lit, free = receive(p, p, vector(look.up), -2.0, look, skin, threads, sample, buffers)
        lay_floor(fade, lit, free, floor, look, out)
