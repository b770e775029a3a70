"""Light on the surface at each pixel, resolved from samples to a picture in linear light.

A pixel's samples are grouped by triangle; each group is shaded once, at the mean place of its samples, and weighted by
their number. That place is inside the triangle, so nothing is extrapolated at silhouettes (centroid sampling), and a
smooth surface costs one shading a pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_kernels import kernel
from nuno_render.scene import DrawnScene, look_up
from nuno_render.shading.lighting import Lights, openness, shadow
from nuno_schemas.fabric import Float

SHEEN_ROUGHNESS = 0.4
BACK_SIDE = 0.82
"""Albedo of the back of cloth relative to its front: the wrong side of most weaves is duller."""
BODY_GLOSS = 0.04


@kernel
def corner_planes(clip: Float, a: int, b: int, c: int, out: Float) -> None:
    """Write the linear forms of the corners' weights at a pixel into out (3, 3).

    A point sum b_i c_i of homogeneous corners projects to (x, y) if it is parallel to (x, y, 1), so b_i is (c_j x c_k)
    . (x, y, 1), up to a common factor (Olano and Greer 1997). No division by w: corners behind the eye do no harm. Rows
    are the cross products.
    """
    for k in range(3):
        i = b if k == 0 else (c if k == 1 else a)
        j = c if k == 0 else (a if k == 1 else b)
        out[k, 0] = clip[i, 1] * clip[j, 2] - clip[i, 2] * clip[j, 1]
        out[k, 1] = clip[i, 2] * clip[j, 0] - clip[i, 0] * clip[j, 2]
        out[k, 2] = clip[i, 0] * clip[j, 1] - clip[i, 1] * clip[j, 0]


@kernel
def corner_weights(planes: Float, x: float, y: float) -> tuple[float, float, float]:
    """Return perspective-correct weights (b0, b1, b2) at pixel (x, y); thirds if degenerate."""
    b0 = planes[0, 0] * x + planes[0, 1] * y + planes[0, 2]
    b1 = planes[1, 0] * x + planes[1, 1] * y + planes[1, 2]
    b2 = planes[2, 0] * x + planes[2, 1] * y + planes[2, 2]
    total = b0 + b1 + b2
    if total == 0.0:
        return 1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0
    return b0 / total, b1 / total, b2 / total


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
    albedo: Float, n: Float, view: Float, lights: Lights, lit: float, free: float, cloth: bool, out: Float
) -> None:
    """Write radiance toward the viewer into out (3,): diffuse key and sky light, and sheen or gloss.

    n, view (3,) unit vectors; lit: part of the key light, 0 to 1; free: part of the sky.
    """
    light, light_colour, up, sheen = lights.direction, lights.colour, lights.up, lights.sheen
    sky_light, ground_light = lights.sky, lights.ground
    nl = n[0] * light[0] + n[1] * light[1] + n[2] * light[2]
    nv = max(n[0] * view[0] + n[1] * view[1] + n[2] * view[2], 0.02)
    hx, hy, hz = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    norm = np.sqrt(hx * hx + hy * hy + hz * hz) + 1e-12
    nh = max((n[0] * hx + n[1] * hy + n[2] * hz) / norm, 0.0)
    direct = lit * max(nl, 0.0)
    highlight, rim = 0.0, 0.0
    if nl > 0.0 and cloth:
        highlight = sheen * np.pi * _sheen(nl, nv, nh)
    elif nl > 0.0:
        highlight = BODY_GLOSS * 6.0 * nh**24
    if cloth:
        rim = 0.35 * sheen * (1.0 - nv) ** 3
    up_part = n[0] * up[0] + n[1] * up[1] + n[2] * up[2]
    for k in range(3):
        tint = 0.25 + 0.75 * albedo[k]
        ambient = sky(up_part, sky_light, ground_light, k)
        out[k] = light_colour[k] * direct * (albedo[k] + highlight * tint)
        out[k] += ambient * (albedo[k] * _interreflect(free, albedo[k]) + rim * tint * free)


@kernel
def _texel(planes: Float, corners: Any, scene: DrawnScene, mesh: int, x: float, y: float, out: Float) -> None:
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
def _place(
    weights: Any, corners: Any, scene: DrawnScene, eye: Float, p: Float, n: Float, g: Float, view: Float
) -> bool:
    """Write point p, smooth normal n, flat normal g and direction to the eye, each (3,), both normals turned toward the
    viewer. Return whether the back of the face is visible.
    """
    (a, b, c), positions, normals = corners, scene.positions, scene.normals
    facing = 0.0
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        g[k] = (positions[b, i] - positions[a, i]) * (positions[c, j] - positions[a, j])
        g[k] -= (positions[b, j] - positions[a, j]) * (positions[c, i] - positions[a, i])
        p[k] = weights[0] * positions[a, k] + weights[1] * positions[b, k] + weights[2] * positions[c, k]
        n[k] = weights[0] * normals[a, k] + weights[1] * normals[b, k] + weights[2] * normals[c, k]
        view[k] = eye[k] - p[k]
        facing += view[k] * g[k]
    turn = -1.0 if facing < 0.0 else 1.0
    ln = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) + 1e-30
    lg = np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]) + 1e-30
    lv = np.sqrt(view[0] * view[0] + view[1] * view[1] + view[2] * view[2]) + 1e-30
    for k in range(3):
        n[k] *= turn / ln
        g[k] *= turn / lg
        view[k] /= lv
    return facing < 0.0


@kernel
def shade_point(
    f: int, x: float, y: float, scene: DrawnScene, clip: Float, eye: Float, lights: Lights, work: Float, out: Float
) -> None:
    """Write the radiance of face f at pixel (x, y) into out (3,).

    clip (n, 3): the scene's vertices on the screen; eye (3,) [m]; `work` (9, 3) is scratch.
    """
    albedos, faces, light = scene.albedo, scene.faces, lights.direction
    planes, p, n, g, view, albedo, texel = work[0:3], work[3], work[4], work[5], work[6], work[7], work[8]
    a, b, c, m = faces[f, 0], faces[f, 1], faces[f, 2], scene.mesh[f]
    corner_planes(clip, a, b, c, planes)
    weights = corner_weights(planes, x, y)
    back = _place(weights, (a, b, c), scene, eye, p, n, g, view)
    dull = BACK_SIDE if back and scene.two_sided[m] else 1.0
    for k in range(3):
        albedo[k] = dull * (weights[0] * albedos[a, k] + weights[1] * albedos[b, k] + weights[2] * albedos[c, k])
    if scene.textures.number[m] > 0:
        _texel(planes, (a, b, c), scene, m, x, y, texel)
        for k in range(3):
            albedo[k] *= texel[k]
    free = openness(p[0], p[1], p[2], n[0], n[1], n[2], lights)
    lit = 1.0 if n[0] * light[0] + n[1] * light[1] + n[2] * light[2] > 0.0 else 0.0
    if lit > 0.0 and lights.depths.shape[0] > 0:
        start = work[8]
        for k in range(3):
            start[k] = p[k] + 1.5 / lights.scale * n[k]
        raise_point(p, (a, b, c), weights, -1.0 if back else 1.0, scene.positions, scene.normals, start)
        lit = shadow(lights, start[0], start[1], start[2], n[0], n[1], n[2])
    surface_light(albedo, n, view, lights, lit, free, scene.two_sided[m], out)


@kernel
def raise_point(p: Float, corners: Any, weights: Any, turn: float, x: Float, normals: Float, out: Float) -> None:
    """Raise out (3,), the start of rays from a point p (3,) of a triangle, to the smooth surface of its corners'
    normals; vertices x and normals (n, 3).

    A coarse mesh's flat faces shadow each other where the interpolated normal still sees the light, which shows as
    steps along the terminator. The point moves to the mean of its projections on the corners' tangent planes (Hanika,
    Hacking the shadow terminator, 2021).
    """
    for m in range(3):
        corner, weight = corners[m], weights[m]
        below = 0.0
        for k in range(3):
            below += (p[k] - x[corner, k]) * normals[corner, k] * turn
        if below < 0.0:
            for k in range(3):
                out[k] -= weight * below * normals[corner, k] * turn
