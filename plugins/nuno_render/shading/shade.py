"""Light on the surface at each pixel, resolved from samples to a picture in linear light.

A pixel's samples are grouped by triangle; each group is shaded once, at the mean place of its samples, and weighted by
their number. That place is inside the triangle, so nothing is extrapolated at silhouettes (centroid sampling), and a
smooth surface costs one shading a pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_geometry.poses import Vector, blend, row_at
from nuno_kernels import kernel
from nuno_kernels.lanes import cross, dot, minus, over, plus, times
from nuno_render.scene import DrawnScene, look_up
from nuno_render.shading.lighting import Lights, openness, shadow
from nuno_schemas.fabric import Float

SHEEN_ROUGHNESS = 0.4
BACK_SIDE = 0.82
"""Albedo of the back of cloth relative to its front: the wrong side of most weaves is duller."""
BODY_GLOSS = 0.04


Planes = tuple[Vector, Vector, Vector]


@kernel
def corner_planes(clip: Float, a: int, b: int, c: int) -> Planes:
    """Return the linear forms of the corners' weights at a pixel.

    A point sum b_i c_i of homogeneous corners projects to (x, y) if it is parallel to (x, y, 1), so b_i is (c_j x c_k)
    . (x, y, 1), up to a common factor (Olano and Greer 1997). No division by w: corners behind the eye do no harm.
    """
    p, q, r = row_at(clip, a), row_at(clip, b), row_at(clip, c)
    return cross(q, r), cross(r, p), cross(p, q)


@kernel
def corner_weights(planes: Planes, x: float, y: float) -> Vector:
    """Return perspective-correct weights (b0, b1, b2) at pixel (x, y); thirds if degenerate."""
    at = x, y, 1.0
    weights = dot(planes[0], at), dot(planes[1], at), dot(planes[2], at)
    total = weights[0] + weights[1] + weights[2]
    return over(weights, total) if total != 0.0 else (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)


@kernel
def sky(up_part: float, sky_light: Float, ground_light: Float, k: int) -> float:
    """Return irradiance / pi of a hemisphere sky in one channel, its radiance blending from ground to sky with height:
    integral of (d.n)+ ((s + g) / 2 + (s - g) / 2 d.up) over directions = (s + g) / 2 + (s - g) n.up / 3.
    """
    irradiance: float = 0.5 * (sky_light[k] + ground_light[k]) + (sky_light[k] - ground_light[k]) * up_part / 3.0
    return irradiance


@kernel
def _interreflect(free: float, albedo: float) -> float:
    """Return sky light in a cavity of one colour, with all bounces: f / (1 - albedo (1 - f))."""
    return free / (1.0 - albedo * (1.0 - free))


@kernel
def _sheen(nl: float, nv: float, nh: float) -> Any:
    """Return Charlie sheen (Estevez and Kulla 2017) with the visibility of Neubelt and Pettineo (2013)."""
    inverse = 1.0 / SHEEN_ROUGHNESS
    sine = np.sqrt(max(1.0 - nh * nh, 0.0))
    return (2.0 + inverse) * sine**inverse / (2.0 * np.pi) / (4.0 * (nl + nv - nl * nv) + 1e-6)


@kernel
def surface_light(
    albedo: Vector, n: Vector, view: Vector, lights: Lights, lit: float, free: float, cloth: bool, out: Float
) -> None:
    """Write radiance toward the viewer into out (3,): diffuse key and sky light, and sheen or gloss.

    n, view (3,) unit vectors; lit: part of the key light, 0 to 1; free: part of the sky.
    """
    light, light_colour, sheen = lights.direction, lights.colour, lights.sheen
    half, nl, nv = plus(light, view), dot(n, light), max(dot(n, view), 0.02)
    nh = max(dot(n, half) / (np.sqrt(dot(half, half)) + 1e-12), 0.0)
    direct = lit * max(nl, 0.0)
    highlight, rim = 0.0, 0.0
    if nl > 0.0 and cloth:
        highlight = sheen * np.pi * _sheen(nl, nv, nh)
    elif nl > 0.0:
        highlight = BODY_GLOSS * 6.0 * nh**24
    if cloth:
        rim = 0.35 * sheen * (1.0 - nv) ** 3
    up_part = dot(n, lights.up)
    for k in range(3):
        tint = 0.25 + 0.75 * albedo[k]
        ambient = sky(up_part, lights.sky, lights.ground, k)
        out[k] = light_colour[k] * direct * (albedo[k] + highlight * tint)
        out[k] += ambient * (albedo[k] * _interreflect(free, albedo[k]) + rim * tint * free)


@kernel
def _texel(planes: Planes, corners: Any, scene: DrawnScene, mesh: int, x: float, y: float, out: Float) -> None:
    """Write the image of a mesh at pixel (x, y), averaged over the pixel, into out (3,)."""
    (a, b, c), uv, weights = corners, scene.uv, corner_weights(planes, x, y)
    u = weights[0] * uv[a, 0] + weights[1] * uv[b, 0] + weights[2] * uv[c, 0]
    v = weights[0] * uv[a, 1] + weights[1] * uv[b, 1] + weights[2] * uv[c, 1]
    change = (0.0, 0.0, 0.0, 0.0)
    for step in range(2):
        weights = corner_weights(planes, x + 1.0 - step, y + step)
        du = weights[0] * uv[a, 0] + weights[1] * uv[b, 0] + weights[2] * uv[c, 0] - u
        dv = weights[0] * uv[a, 1] + weights[1] * uv[b, 1] + weights[2] * uv[c, 1] - v
        change = (change[2], change[3], du, dv)
    look_up(scene.textures, mesh, (u, v), change, out)


@kernel
def _place(weights: Vector, corners: Any, scene: DrawnScene, eye: Float) -> tuple[Vector, Vector, Vector, bool]:
    """Return point p, smooth normal n, turned toward the viewer, direction to the eye, and whether the back of the face
    is visible.
    """
    corner = row_at(scene.positions, corners[0])
    ab, ac = minus(row_at(scene.positions, corners[1]), corner), minus(row_at(scene.positions, corners[2]), corner)
    p, n = blend(weights, scene.positions, corners), blend(weights, scene.normals, corners)
    view = minus(eye, p)
    back = dot(view, cross(ab, ac)) < 0.0
    n = times((-1.0 if back else 1.0) / (np.sqrt(dot(n, n)) + 1e-30), n)
    return p, n, over(view, np.sqrt(dot(view, view)) + 1e-30), back


@kernel
def shade_point(
    f: int, x: float, y: float, scene: DrawnScene, clip: Float, eye: Float, lights: Lights, texel: Float, out: Float
) -> None:
    """Write the radiance of face f at pixel (x, y) into out (3,).

    clip (n, 3): the scene's vertices on the screen; eye (3,) [m]; `texel` (3,) is scratch.
    """
    corners, m = (scene.faces[f, 0], scene.faces[f, 1], scene.faces[f, 2]), scene.mesh[f]
    planes = corner_planes(clip, corners[0], corners[1], corners[2])
    weights = corner_weights(planes, x, y)
    p, n, view, back = _place(weights, corners, scene, eye)
    albedo = times(BACK_SIDE if back and scene.two_sided[m] else 1.0, blend(weights, scene.albedo, corners))
    if scene.textures.number[m] > 0:
        _texel(planes, corners, scene, m, x, y, texel)
        albedo = albedo[0] * texel[0], albedo[1] * texel[1], albedo[2] * texel[2]
    free = openness(p, n, lights)
    lit = 1.0 if dot(n, lights.direction) > 0.0 else 0.0
    if lit > 0.0 and lights.depths.shape[0] > 0:
        start = plus(p, times(1.5 / lights.scale, n))
        side = -1.0 if back else 1.0
        lit = shadow(raise_point(p, start, corners, weights, side, scene.positions, scene.normals), n, lights)
    surface_light(albedo, n, view, lights, lit, free, scene.two_sided[m], out)


@kernel
def raise_point(
    p: Vector, start: Vector, corners: Any, weights: Vector, turn: float, x: Float, normals: Float
) -> Vector:
    """Return the start of rays from a point p of a triangle, raised to the smooth surface of its corners' normals;
    vertices x and normals (n, 3).

    A coarse mesh's flat faces shadow each other where the interpolated normal still sees the light, which shows as
    steps along the terminator. The point moves to the mean of its projections on the corners' tangent planes (Hanika,
    Hacking the shadow terminator, 2021).
    """
    for m in range(3):
        normal = row_at(normals, corners[m])
        below = turn * dot(minus(p, row_at(x, corners[m])), normal)
        if below < 0.0:
            start = minus(start, times(turn * weights[m] * below, normal))
    return start
