"""The colour of cloth from its amounts of dye.

One dye's colour is interpolated linearly in HSV between three colours measured on dyed cloth: undyed, half and full
(dye paper, section 4.3.1). Several dyes mix subtractively: each transmits a share of the light, per channel of linear
sRGB, that is its colour at its amount over its colour without dye, and shares multiply,

    light = ground  product over dyes of  colour_k(a_k) / colour_k(0),

which is Beer and Lambert's law for three bands. A single dye on its own ground keeps its measured colours exactly.
The cloth's texture multiplies the result, in linear light too.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np

from nuno_schemas.colour import to_linear
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.look import DyeColour


def colour_of(amount: Float, colours: DyeColour, v_max: float = 1.0) -> Float:
    """Return the linear light (..., 3) of amounts (...), interpolated in HSV, the short way around the circle of hues.
    A grey has no hue and gets its neighbour's, so that colour fades without passing through others.
    """
    knots = np.array([_to_hsv(text) for text in (colours.light, colours.mid, colours.dark)])
    grey = knots[:, 1] == 0.0
    if grey[1]:
        knots[1, 0] = knots[2, 0] if grey[0] else knots[0, 0]
    knots[0, 0] = knots[1, 0] if grey[0] else knots[0, 0]
    knots[2, 0] = knots[1, 0] if grey[2] else knots[2, 0]
    for near, far in ((1, 0), (1, 2)):
        knots[far, 0] -= np.round(knots[far, 0] - knots[near, 0])
    share = np.clip(np.asarray(amount) / (colours.full * v_max), 0.0, 1.0)
    h, s, v = (np.interp(share, (0.0, 0.5, 1.0), knots[:, k]) for k in range(3))
    return to_linear(_from_hsv(h, s, v))


def mix(amounts: Float, dyes: Sequence[DyeColour], v_max: float = 1.0, ground: Float | None = None) -> Float:
    """Return the linear light (2, ny, nx, 3) of cells with amounts (dyes, 2, ny, nx).

    `ground` is the undyed cloth's linear light, (3,) or for every cell; the first dye's `light` unless given.
    """
    if len(amounts) != len(dyes):
        raise BadInput("one colour a dye", field="colours", value=len(dyes), limit=f"{len(amounts)} dyes")
    base = to_linear(_to_rgb(dyes[0].light)) if ground is None else ground
    light = np.broadcast_to(base, (*amounts.shape[1:], 3)).copy()
    for amount, dye in zip(amounts, dyes, strict=True):
        undyed = to_linear(_to_rgb(dye.light))
        # In a channel where undyed cloth is black, dye changes nothing.
        light *= np.divide(colour_of(amount, dye, v_max), undyed, out=np.ones_like(light), where=undyed > 0.0)
    return np.minimum(light, 1.0)


def _to_rgb(text: str) -> Float:
    return np.frombuffer(bytes.fromhex(text[1:]), np.uint8) / 255.0


def _to_hsv(text: str) -> tuple[float, float, float]:
    r, g, b = (float(channel) for channel in _to_rgb(text))
    return colorsys.rgb_to_hsv(r, g, b)


def _from_hsv(h: Float, s: Float, v: Float) -> Float:
    """Return sRGB (..., 3): a channel is v less v s times the hue's distance from its third of the circle."""
    place = (np.array([5.0, 3.0, 1.0]) + 6.0 * h[..., None]) % 6.0
    distance = np.clip(np.minimum(place, 4.0 - place), 0.0, 1.0)
    return np.asarray(v[..., None] * (1.0 - s[..., None] * distance))
