"""Where a body has its bust, waist and hips, found on its mesh."""

from __future__ import annotations

import numpy as np

from nuno.fit.slices import Slice, cut
from nuno_schemas.fabric import Float, Int

LEVELS, LOW, HIGH = 120, 0.3, 0.9
"""Slices, between these shares of the body's height."""
LIMB = 0.2
"""A curve inside which is less than this share of the greatest area is no leg beside another, but a hand."""
JOINED = 0.1
"""Arms have joined the trunk where a tape grows by more than this share from one slice to the next."""


def trunk(piece: Slice) -> Slice | None:
    """Of the closed curves of a slice the one with most inside; None where there is none."""
    closed = [one for one in piece.curves() if abs(abs(one.turns(one.hull()[2])) - 1.0) < 1e-6]
    return max(closed, key=lambda one: one.hull()[1], default=None)


def find_heights(x: Float, faces: Int) -> dict[str, float]:
    """Heights of bust, waist and hip [m] of a body that stands with y up and faces +z; nothing for one without legs, or
    whose arms do not part from its trunk below the shoulders.

    The trunk is between the height where two legs become one, and that where arms join. Its hips are where a tape is
    longest below the middle, its waist where it is shortest above those, its bust where it reaches farthest forwards
    in the upper half from there.
    """
    middle = 0.5 * float(x[:, 0].min() + x[:, 0].max())
    floor, tall = float(x[:, 1].min()), float(np.ptp(x[:, 1]))
    heights = floor + tall * np.linspace(LOW, HIGH, LEVELS)
    slices = [cut(x, faces, float(h)) for h in heights]
    girth, forwards, legs = np.zeros(LEVELS), np.zeros(LEVELS), np.zeros(LEVELS, np.bool_)
    for i, one in enumerate(slices):
        hulls = [piece.hull() for piece in one.curves()]
        areas = np.sort([area for _, area, _ in hulls])[::-1]
        legs[i] = len(areas) > 1 and areas[1] > LIMB * areas[0] and _beside(hulls, middle)
        if (body := trunk(one)) is not None:
            girth[i], forwards[i] = body.hull()[0], float(body.ends[..., 0].max())
    half = int((0.5 - LOW) / (HIGH - LOW) * LEVELS)
    if not legs[:half].any():
        return {}
    crotch = int(np.flatnonzero(legs[:half])[-1]) + 1
    grown = girth[1:] > (1.0 + JOINED) * girth[:-1]
    joined = np.flatnonzero(grown[half:])
    if not len(joined):
        return {}
    armpit = half + int(joined[0]) + 1
    hip = crotch + int(girth[crotch : (crotch + armpit) // 2].argmax())
    waist = hip + int(girth[hip:armpit].argmin())
    chest = (waist + armpit) // 2
    bust = chest + int(forwards[chest:armpit].argmax())
    return {name: float(heights[i]) for name, i in (("bust", bust), ("waist", waist), ("hip", hip))}


def _beside(hulls: list[tuple[float, float, Float]], middle: float) -> bool:
    """Whether the two largest are on both sides of the body's middle, an x [m]."""
    first, second = sorted(hulls, key=lambda one: -one[1])[:2]
    return bool((first[2][1] - middle) * (second[2][1] - middle) < 0.0)
