"""Light on what each pixel sees, resolved from samples to a picture in linear light.

A pixel's samples are grouped by triangle; each group is shaded once, at the mean place of its
samples, and weighs as many as it has. That place lies inside the triangle, so nothing is
extrapolated at silhouettes (centroid sampling), and a smooth surface costs one shading a pixel.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from nuno_render.light_maps import shadow
from nuno_render.texture import look_up

# mypy: disable-error-code="no-untyped-def"

SHEEN_ROUGHNESS = 0.4
BACK_SIDE = 0.82
"""Albedo of the back of cloth relative to its front: the wrong side of most weaves is duller."""
BODY_GLOSS = 0.04


@njit(cache=True, nogil=True)
def corner_weights(clip, a, b, c, x, y, out):
    """Perspective-correct weights of a triangle's corners at pixel (x, y), into out (3,).

    A point sum b_i c_i of homogeneous corners projects to (x, y) where it is parallel to
    (x, y, 1); the weights are (c_j x c_k) . (x, y, 1), divided by their sum (Olano and Greer
    1997). No division by w: corners behind the eye do no harm. Returns False where degenerate.
    """
    total = 0.0
    for k in range(3):
        i, j = (b, c) if k == 0 else ((c, a) if k == 1 else (a, b))
        nx = clip[i, 1] * clip[j, 2] - clip[i, 2] * clip[j, 1]
        ny = clip[i, 2] * clip[j, 0] - clip[i, 0] * clip[j, 2]
        nz = clip[i, 0] * clip[j, 1] - clip[i, 1] * clip[j, 0]
        out[k] = nx * x + ny * y + nz
        total += out[k]
    if total == 0.0:
        out[0] = out[1] = out[2] = 1.0 / 3.0
        return False
    for k in range(3):
        out[k] /= total
    return True


@njit(cache=True, nogil=True)
def sky(up_part, sky_light, ground_light, k):
    """Irradiance / pi of a hemisphere sky, radiance blending from ground to sky with height:
    integral of (d.n)+ ((s + g) / 2 + (s - g) / 2 d.up) over directions = (s + g) / 2 + (s - g) n.up / 3."""
    return 0.5 * (sky_light[k] + ground_light[k]) + (sky_light[k] - ground_light[k]) * up_part / 3.0


@njit(cache=True, nogil=True)
def _interreflect(openness, albedo):
    """Sky light in a cavity of one colour, all bounces: o / (1 - albedo (1 - o))."""
    return openness / (1.0 - albedo * (1.0 - openness))


@njit(cache=True, nogil=True)
def _sheen(nl, nv, nh):
    """Charlie sheen (Estevez and Kulla 2017) with the visibility of Neubelt and Pettineo (2013)."""
    inverse = 1.0 / SHEEN_ROUGHNESS
    sine = np.sqrt(max(1.0 - nh * nh, 0.0))
    return (2.0 + inverse) * sine**inverse / (2.0 * np.pi) / (4.0 * (nl + nv - nl * nv) + 1e-6)


@njit(cache=True, nogil=True)
def surface_light(albedo, n, view, light, light_colour, lit, openness, up, sky_light, ground_light, cloth, sheen, out):
    """Radiance toward the viewer, into out (3,): diffuse key and sky light, and sheen or gloss.

    n, view, light (3,) unit vectors; lit: part of the key light, 0 to 1; openness: part of the
    sky. light_colour (3,) is the radiance of a white diffuse surface that faces the light.
    """
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
        tint = 0.4 + 0.6 * albedo[k]
        ambient = sky(up_part, sky_light, ground_light, k)
        out[k] = light_colour[k] * direct * (albedo[k] + highlight * tint)
        out[k] += ambient * (albedo[k] * _interreflect(openness, albedo[k]) + rim * tint * openness)


@njit(cache=True, nogil=True)
def shade_point(f, x, y, clip, scene, textures, eye, lights, maps, sheen, work, out):
    """Radiance of face f at pixel (x, y), into out (3,). The tuples are those of `shade`."""
    positions, normals, albedos, uv, faces, mesh, two_sided, openness = scene
    texels, levels, counts = textures
    light, light_colour, up, sky_light, ground_light, spread = lights
    depths, disc, basis, centre, scale = maps
    weight, albedo, n, view, texel = work[0], work[1], work[2], work[3], work[4]
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    corner_weights(clip, a, b, c, x, y, weight)
    cloth = two_sided[mesh[f]]
    p, g = work[5], work[6]
    length, facing = 0.0, 0.0
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        g[k] = (positions[b, i] - positions[a, i]) * (positions[c, j] - positions[a, j])
        g[k] -= (positions[b, j] - positions[a, j]) * (positions[c, i] - positions[a, i])
        p[k] = weight[0] * positions[a, k] + weight[1] * positions[b, k] + weight[2] * positions[c, k]
        n[k] = weight[0] * normals[a, k] + weight[1] * normals[b, k] + weight[2] * normals[c, k]
        albedo[k] = weight[0] * albedos[a, k] + weight[1] * albedos[b, k] + weight[2] * albedos[c, k]
        view[k] = eye[k] - p[k]
        length += view[k] * view[k]
        facing += view[k] * g[k]
    back = facing < 0.0
    normal_length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) + 1e-30
    side = 1 if back else 0
    turn = -1.0 if back else 1.0
    flat = np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]) + 1e-30
    for k in range(3):
        n[k] *= turn / normal_length
        g[k] *= turn / flat
        view[k] /= np.sqrt(length)
    free = weight[0] * openness[a, side] + weight[1] * openness[b, side] + weight[2] * openness[c, side]
    m = mesh[f]
    if counts[m] > 0:
        tu = weight[0] * uv[a, 0] + weight[1] * uv[b, 0] + weight[2] * uv[c, 0]
        tv = weight[0] * uv[a, 1] + weight[1] * uv[b, 1] + weight[2] * uv[c, 1]
        corner_weights(clip, a, b, c, x + 1.0, y, weight)
        ux = weight[0] * uv[a, 0] + weight[1] * uv[b, 0] + weight[2] * uv[c, 0] - tu
        vx = weight[0] * uv[a, 1] + weight[1] * uv[b, 1] + weight[2] * uv[c, 1] - tv
        corner_weights(clip, a, b, c, x, y + 1.0, weight)
        uy = weight[0] * uv[a, 0] + weight[1] * uv[b, 0] + weight[2] * uv[c, 0] - tu
        vy = weight[0] * uv[a, 1] + weight[1] * uv[b, 1] + weight[2] * uv[c, 1] - tv
        look_up(texels, levels[m], counts[m], tu, tv, ux, vx, uy, vy, texel)
        for k in range(3):
            albedo[k] *= texel[k]
        corner_weights(clip, a, b, c, x, y, weight)
    if back and cloth:
        for k in range(3):
            albedo[k] *= BACK_SIDE
    lit = 0.0
    nl = n[0] * light[0] + n[1] * light[1] + n[2] * light[2]
    if nl > 0.0:
        lit = 1.0
        if depths.shape[0] > 0:
            lit = _lit(
                p, g, n, a, b, c, weight, positions, normals, turn, light, depths, disc, basis, centre, scale, spread
            )
    surface_light(albedo, n, view, light, light_colour, lit, free, up, sky_light, ground_light, cloth, sheen, out)


@njit(cache=True, nogil=True)
def _lit(p, g, n, a, b, c, weight, positions, normals, turn, light, depths, disc, basis, centre, scale, spread):
    """Shadow at p, tested from a point on the smooth surface that the normals suggest.

    A coarse mesh's flat faces shadow each other where the interpolated normal still sees the
    light, which shows as steps along the terminator. The point is raised to the mean of its
    projections on the corners' tangent planes (Hanika 2021), then by 1.5 texels along n.
    """
    lift = 1.5 / scale
    x, y, z = p[0] + lift * n[0], p[1] + lift * n[1], p[2] + lift * n[2]
    for k in range(3):
        i = a if k == 0 else (b if k == 1 else c)
        below = 0.0
        for d in range(3):
            below += (p[d] - positions[i, d]) * normals[i, d] * turn
        if below < 0.0:
            x -= weight[k] * below * normals[i, 0] * turn
            y -= weight[k] * below * normals[i, 1] * turn
            z -= weight[k] * below * normals[i, 2] * turn
    return shadow(depths, disc, basis, centre, scale, x, y, z, n[0], n[1], n[2], spread)
