"""How fabrics scatter light: their weave or stitches as textures, and a material of Mitsuba from them."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from nuno_schemas.fabric import Float


class Look(NamedTuple):
    """A weave (plain, twill, satin, jersey or rib), the pitch of its yarns or wales [m], the share of light that yarns
    reflect (gloss), its roughness along and across them, the strength of the velvet-like sheen, the share of diffuse
    light that passes (thin), that of white in the colour of the weft, which in denim is not dyed, and the standard
    deviation of the yarns' brightness (slub).
    """

    weave: str = "plain"
    pitch: float = 0.4e-3
    gloss: float = 0.03
    along: float = 0.35
    across: float = 0.55
    sheen: float = 0.3
    thin: float = 0.1
    weft: float = 0.0
    slub: float = 0.04


LOOKS = {
    "denim": Look("twill", 0.55e-3, 0.01, 0.5, 0.7, 0.15, 0.0, 0.45, 0.2),
    "interlock": Look("jersey", 0.9e-3, 0.01, 0.5, 0.6, 0.8, 0.1, 0.0, 0.02),
    "rib-knit": Look("rib", 1.1e-3, 0.01, 0.5, 0.6, 0.8, 0.05, 0.0, 0.03),
    "polyester": Look("plain", 0.3e-3, 0.08, 0.25, 0.45, 0.15, 0.1, 0.0, 0.02),
    "jacket": Look("plain", 0.3e-3, 0.1, 0.25, 0.45, 0.1, 0.1, 0.0, 0.02),
    "trousers": Look("twill", 0.4e-3, 0.02, 0.4, 0.6, 0.35, 0.0, 0.0, 0.05),
    "swimwear": Look("jersey", 0.3e-3, 0.12, 0.28, 0.4, 0.1, 0.05, 0.0, 0.0),
    "silk": Look("satin", 0.12e-3, 0.4, 0.14, 0.32, 0.1, 0.15, 0.0, 0.01),
    "chiffon": Look("plain", 0.2e-3, 0.08, 0.25, 0.45, 0.1, 0.5, 0.0, 0.02),
    "wool": Look("twill", 0.9e-3, 0.01, 0.5, 0.7, 0.9, 0.0, 0.0, 0.07),
    "linen": Look("plain", 0.6e-3, 0.04, 0.3, 0.5, 0.2, 0.1, 0.0, 0.12),
    "canvas": Look("plain", 0.8e-3, 0.02, 0.5, 0.6, 0.25, 0.0, 0.0, 0.06),
    "leather": Look("plain", 0.2e-3, 0.12, 0.35, 0.35, 0.0, 0.0, 0.0, 0.0),
}
"""By the names of presets. Weaves and pitches are usual for such cloth; the rest, which no source has, was chosen by
eye."""

YARNS, PIXELS = 120, 6
"""Yarns along a side of a repeating texture, which all weaves divide, and its pixels a yarn."""
RELIEF, CAVITY = 0.35, 0.4
"""Height of yarns over the places between them, in pitches, and the share of light that does not reach these."""


@functools.cache
def draw_tile(weave: str, slub: float) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return the texture of a weave, or of the stitches of a knit, whose wales are warps: 1 where the warp is on top,
    height [pitches] and brightness, of mean 1, each (p, p).
    """
    y, x = (np.mgrid[: YARNS * PIXELS, : YARNS * PIXELS] + 0.5) / PIXELS
    random, row, column = np.random.default_rng(0), np.floor(y).astype(int), np.floor(x).astype(int)
    # Each yarn has its own brightness, and thick places a few cm long.
    places = uniform_filter1d(random.standard_normal((2, YARNS, YARNS)), YARNS // 3, axis=1, mode="wrap")
    spun = 1.0 + 0.7 * slub * (random.standard_normal((2, 1, YARNS)) + np.sqrt(YARNS // 3) * places)
    warps, wefts = spun[0][row, column], spun[1][column, row]
    if weave in ("jersey", "rib"):
        # The two legs of a stitch lean outwards, and end under those of the next course.
        rise, side = 1.0 - y % 1.0, np.abs(x % 1.0 - 0.5)
        height = np.maximum(*(_round((side - 0.1 - 0.13 * (rise + k)) / 0.14) - 0.9 * k * rise for k in (0, 1)))
        height, warp = height + 1.5 * (weave == "rib") * np.sin(2.0 * np.pi * x / 4.0), np.ones_like(x)
    else:
        step, float_of = {"plain": (1, 2), "twill": (1, 4), "satin": (2, 5)}[weave]
        up = ((row + step * column) % float_of != 0).astype(float)
        # Yarns bend between above and below over a pitch: the mean of what is on top along the yarn.
        warp_top, weft_top = (
            uniform_filter1d(on_top, PIXELS, axis=axis, mode="wrap") + 0.6 * _round(2.0 * (across % 1.0) - 1.0)
            for on_top, across, axis in ((up, x, 0), (1.0 - up, y, 1))
        )
        height, warp = np.maximum(warp_top, weft_top), np.where(warp_top > weft_top, 1.0, 0.0)
    bright = np.where(warp > 0.5, warps, wefts) * (1.0 - CAVITY * (height.max() - height) / np.ptp(height))
    warp, height, bright = (part.astype(np.float32) for part in (warp, height, bright / bright.mean()))
    return warp, height, bright


def _round(x: Float) -> Float:
    """Return the height of a yarn of radius 1 at x from its axis."""
    return np.asarray(np.sqrt(np.maximum(1.0 - x * x, 0.0)))


def cloth_material(mi: Any, look: Look, colour: Any, unit: tuple[float, float] | None, pixel: float) -> dict[str, Any]:
    """Return the material of a cloth of a colour, a texture of Mitsuba, of which yarns vary one that is plain.

    unit   length [m] of a unit of u and of v, None for cloth without texture coordinates, which shows no yarns
    pixel  side of a pixel at the cloth [m]: finer yarns are drawn by their mean, which has no grain

    The dull part scatters and, where it is thin, transmits light, with sheen. The surface of yarns reflects in two
    lobes, narrow along warp and along weft, each where its yarns are on top.
    """
    on_top, height, bright = draw_tile(look.weave, look.slub)
    seen = min(max(look.pitch / pixel - 0.4, 0.0), 1.0) if unit else 0.0
    plain = np.asarray(colour["value"] if colour["type"] == "rgb" else (0.6, 0.6, 0.6), np.float64)

    def texture(values: NDArray[np.float32]) -> dict[str, Any]:
        scale = mi.ScalarTransform4f().scale([side / (YARNS * look.pitch) for side in unit or ()] + [1.0])
        return {"type": "bitmap", "bitmap": mi.Bitmap(np.atleast_3d(values)), "raw": True, "to_uv": scale}

    if unit and colour["type"] == "rgb":
        # Some of the weft's colour is white; the mean of all yarns stays.
        warp = float(on_top.mean())
        white = plain + look.weft * (0.8 - plain)
        dyed = np.maximum((plain - (1.0 - warp) * white) / max(warp, 0.1), 0.3 * plain)
        yarns = np.where(on_top[..., None] < 0.5, white, dyed) * bright[..., None]
        colour = texture(np.clip(yarns, 0.0, 1.0).astype(np.float32))
    scatter = {
        "type": "principledthin", "base_color": colour, "roughness": 0.7, "spec_trans": 0.0, "sheen": look.sheen,
        "sheen_tint": 0.5, "diff_trans": look.thin,
    }  # fmt: skip
    ends = {"weft": (look.along, look.across), "warp": (look.across, look.along)}
    lobes = {
        name: {"type": "roughconductor", "distribution": "ggx", "alpha_u": u, "alpha_v": v,
               "specular_reflectance": rgb(0.3 + 0.7 * plain)} for name, (u, v) in ends.items()
    }  # fmt: skip
    weight: Any = texture(on_top) if seen else float(on_top.mean())
    shine = {"type": "twosided", "one": {"type": "blendbsdf", "weight": weight, **lobes}}
    material = {"type": "blendbsdf", "weight": look.gloss, "dull": scatter, "shine": shine}
    if not seen:
        return material
    return {"type": "bumpmap", "height": texture(height), "scale": RELIEF * look.pitch * seen, "one": material}


def rgb(colour: Float) -> dict[str, Any]:
    """Return one colour (3,) as a texture of Mitsuba."""
    return {"type": "rgb", "value": [float(value) for value in colour]}
