"""Light on skin and on yarns.

A yarn is a bundle of fibres along its tangent T. Its highlight is that of Kajiya and Kay (Rendering fur with three
dimensional textures, SIGGRAPH 1989): light from L leaves it as a cone about T, and is seen from V with

    (sin(T, L) sin(T, V) - T.L T.V)^p = cos(angle between V and the cone)^p,

brightest where T is normal to L + V: on a hoop, where its normal plane contains the half vector. Seen round the yarn it
has the falloff cos(phi / 2) of a mirroring fibre (Marschner et al., Light scattering from human hair fibers, SIGGRAPH
2003), phi between L and V about T, so that light from behind makes no highlight. Their diffuse term sin(T, L) is
Lambert's law integrated over a round fibre; here the normal is known, without an integral.

Skin and yarns scatter light inside, which carries it beyond the terminator: (n.L + w) / (1 + w), w larger for red in
skin, which red light passes best.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_render.light.shade import sky
from nuno_schemas.fabric import Float

SKIN_WRAP = np.array([0.34, 0.20, 0.14])
YARN_WRAP = 0.45
GLOSS, SHARPNESS = 0.05, 18.0
"""Strength and exponent of the skin's highlight."""
BOUNCE = 0.55
"""Light of a surface that hides the sky, relative to the sky's, without its colour."""


class Look(NamedTuple):
    """The settings of a picture by rays.

    eye (3,)              [m]; direction, colour, up, sky, ground and spread as in nuno_render.light.light_maps.Lights
    share                 of the light that passes a yarn; keep: the most capsules along a ray
    highlight, sharpness  strength and exponent of the yarns' highlight
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
    share: float
    keep: int
    highlight: float
    sharpness: float
    shadows: bool
    occlusion: bool
    off: float
    flat: bool


@kernel
def wrapped(cosine: float, w: float) -> float:
    """Return Lambert's law with the terminator moved by w."""
    return max((cosine + w) / (1.0 + w), 0.0)


@kernel
def fibre_highlight(t: Float, light: Float, view: Float, sharpness: float) -> float:
    """Return Kajiya and Kay's highlight of a fibre along the unit vector t (3,), with the falloff about it; 0 to 1."""
    tl = t[0] * light[0] + t[1] * light[1] + t[2] * light[2]
    tv = t[0] * view[0] + t[1] * view[1] + t[2] * view[2]
    sl, sv = np.sqrt(max(1.0 - tl * tl, 0.0)), np.sqrt(max(1.0 - tv * tv, 0.0))
    cone = sl * sv - tl * tv
    if cone <= 0.0:
        return 0.0
    lv = light[0] * view[0] + light[1] * view[1] + light[2] * view[2]
    around = 1.0
    if sl * sv > 1e-9:
        around = min(max((lv - tl * tv) / (sl * sv), -1.0), 1.0)
    shine: float = cone**sharpness * np.sqrt(0.5 * (1.0 + around))
    return shine


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
def yarn_light(albedo: Float, n: Float, t: Float, view: Float, look: Look, lit: float, free: float, out: Float) -> None:
    """Write the radiance of a yarn with normal n and tangent t toward the viewer into out (3,)."""
    light, light_colour, up = look.direction, look.colour, look.up
    nl = n[0] * light[0] + n[1] * light[1] + n[2] * light[2]
    shine = look.highlight * fibre_highlight(t, light, view, look.sharpness)
    up_part = n[0] * up[0] + n[1] * up[1] + n[2] * up[2]
    for k in range(3):
        tint = 0.35 + 0.65 * albedo[k]
        out[k] = light_colour[k] * lit * (albedo[k] * wrapped(nl, YARN_WRAP) + shine * tint)
        out[k] += ambient_light(albedo, up_part, free, look, k)
