"""Heights of a body's bust, waist and hips, from its mesh."""

from __future__ import annotations

import numpy as np

from nuno.fit.slices import Slice, cut
from nuno_schemas.fabric import Float, Int

LEVELS, LOW, HIGH = 120, 0.3, 0.9
"""Number of slices, and the shares of the body's height between which they are."""
LIMB = 0.2
"""A curve with less than this share of the largest area is a hand, not a second leg."""
JOINED = 0.1
"""Arms join the trunk where the girth grows by more than this share from one slice to the next."""


def trunk(piece: Slice) -> Slice | None:
    """Return the closed curve of a slice with the largest area, or None."""
    closed = [one for one in piece.curves() if abs(abs(one.turns(one.hull()[2])) - 1.0) < 1e-6]
    return max(closed, key=lambda one: one.hull()[1], default=None)


def find_heights(x: Float, faces: Int) -> dict[str, float]:
    """Return the heights of bust, waist and hip [m] of a body that stands with y up and faces +z; empty for a body
    without legs, or with arms that are not separate from its trunk below the shoulders.

    The trunk is between the height at which two legs join, and that at which the arms join. Its hips are at the largest
    girth below its middle, its waist at the smallest girth above the hips, its bust where it extends farthest forwards
    in the upper half above the waist.
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
    """Return whether the two largest are on opposite sides of the body's middle, an x [m]."""
    first, second = sorted(hulls, key=lambda one: -one[1])[:2]
    return bool((first[2][1] - middle) * (second[2][1] - middle) < 0.0)
