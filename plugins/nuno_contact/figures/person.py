"""A whole mannequin: the torso with legs, feet, arms, hands and a head without a face, as one smooth closed mesh.

It stands in an A-pose, feet apart, so that trousers have room between its legs. Trunk, breasts and upper arms are those
of nuno_contact.figures.torso, with its girths; legs have the rings of nuno_contact.figures.leg down to the ankle, and
so the girths of thigh, knee, calf and ankle. Feet, forearms and hands are cones and ellipsoids, chosen to look like
those of a woman of 164.9 cm.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import pairwise

import numpy as np

from nuno_contact.figures.leg import RINGS, monotone, scales_of
from nuno_contact.figures.torso import GIRTHS, JOINT, cap, draw, find_scales, join, smooth, upper_body
from nuno_schemas.fabric import Float, Int

HIPS = 0.775
"""height at which the trunk ends between the legs [m]"""
TOP = 0.80
"""height at which legs end inside of the trunk [m]"""
APART, OUTWARDS = 0.092, 0.075
"""distance of a leg from the middle at HIPS [m], and its outward slope downwards"""
LEG = (
    RINGS[0]._replace(width=0.085, front=0.082, back=-0.108),
    RINGS[1]._replace(front=0.086, back=-0.094),
    *RINGS[2:10],
)
"""from the thigh, above as the trunk is there, down to the ankle"""
ANKLE = 0.115
FOOT = (
    ((0.000, 0.130, -0.006), (0.004, 0.046, 0.080), 0.030, 0.034),
    ((0.000, 0.130, -0.006), (0.000, 0.040, -0.030), 0.029, 0.034),
    ((0.000, 0.036, -0.030), (0.010, 0.028, 0.130), 0.034, 0.030),
    ((-0.012, 0.024, 0.125), (-0.010, 0.020, 0.160), 0.026, 0.020),
    ((0.026, 0.022, 0.105), (0.026, 0.018, 0.135), 0.024, 0.018),
)
"""Cones from ankle to instep and to heel, of the sole, and of the toes: ends [m] from the leg's middle at the ankle, on
the left foot, and radii there [m]."""
FOREARM = ((0.210, 0.0395), (0.330, 0.0375), (0.520, 0.0255))
"""distances from the shoulder joint along the arm, and radii there [m]"""
HAND, FINGERS = ((0.540, 0.0190), (0.668, 0.0165)), (0.012, -0.012)
"""distances from the shoulder joint to its ends, with radii there [m], of two cones side by side [m]"""
HEAD, HEAD_RADII = (0.0, 1.545, 0.014), (0.070, 0.104, 0.086)
BLEND_LEG, BLEND_THIGHS, BLEND_ANKLE, BLEND_FOOT, BLEND_HAND, BLEND_HEAD = 0.006, 0.020, 0.012, 0.035, 0.020, 0.050
"""distances of two parts at which they begin to blend [m]"""


def person_mesh(
    around: int = 96, girths: Mapping[str, float] | None = None, arms: float = 0.25 * np.pi
) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] and triangles (f, 3) of a closed mannequin, about `around` vertices round its waist.

    girths: those of torso.GIRTHS that are to be others [m]; arms: angle between arms and plumb line [rad]. y is up, the
    floor is y = 0, and it faces +z; it is its own mirror image in x. Raises BadInput as torso_mesh does.
    """
    scale = find_scales(girths or {}, arms)
    spacing = {**GIRTHS, **(girths or {})}["waist"] / around
    reach = JOINT[0] + (HAND[1][0] + HAND[1][1]) * np.sin(arms) + 0.05
    low, high = np.array([-reach, -0.05, -0.3]), np.array([reach, HEAD[1] + HEAD_RADII[1] + 0.05, 0.3])
    return draw(lambda x, y, z: _field(x, y, z, scale, arms), low, high, spacing)


def _field(x: Float, y: Float, z: Float, scale: Mapping[str, float], arms: float) -> Float:
    """Return approximately the signed distance [m] at places x, y, z [m]."""
    x = np.abs(x)
    trunk = cap(cap(upper_body(x, y, z, scale, arms), HIPS - y), y - HEAD[1])
    head = [(c - m) / r for c, m, r in zip((x, y, z), HEAD, HEAD_RADII, strict=True)]
    body = join(trunk, (_size(*head) - 1.0) * min(HEAD_RADII), BLEND_HEAD)
    # Both legs, so that the narrow gap between the thighs closes where they begin to part.
    body = join(body, join(_leg(x, y, z), _leg(-x, y, z), BLEND_THIGHS), BLEND_LEG)
    return np.minimum(body, _forearm(x, y, z, arms))


def _leg(x: Float, y: Float, z: Float) -> Float:
    """Return the distance of a tube of rings from trunk to ankle, and the foot's cones, cut off at the floor."""
    heights, columns = _columns()
    front, back, width, power, slope, tilt = (np.interp(y, heights, column) for column in columns)
    middle, deep, aside = 0.5 * (front + back), 0.5 * (front - back), x - _middle(y)
    ring = (np.abs(aside / width) ** power + np.abs((z - middle) / deep) ** power) ** (1.0 / power)
    tube = (ring - 1.0) * np.minimum(width, deep) / np.sqrt(1.0 + slope * slope + tilt * tilt)
    leg = cap(cap(tube, ANKLE - y), y - TOP)
    foot: Float | None = None
    for a, b, thick, thin in FOOT:
        cone = _cone(x - _middle(np.array(ANKLE)), y, z, a, b, thick, thin)
        foot = cone if foot is None else join(foot, cone, BLEND_FOOT)
    assert foot is not None
    return cap(join(leg, foot, BLEND_ANKLE), -y)


def _middle(y: Float) -> Float:
    """Return the distance of a leg's middle from the body's [m]."""
    return np.asarray(APART + OUTWARDS * np.maximum(HIPS - y, 0.0))


@cache
def _columns() -> tuple[Float, Float]:
    """Return heights (h,) a millimetre apart; front, back, width, power, slopes of the width and the middle (6, h)."""
    table = np.array(LEG)[::-1]
    low, high = float(table[0, 0]), float(table[-1, 0])
    heights = np.linspace(low, high, round((high - low) * 1e3) + 1)
    size = smooth(np.interp(heights, table[:, 0], scales_of(LEG)[::-1]))
    front, back, width, power = (smooth(monotone(table[:, 0], table[:, k], heights)) for k in (1, 3, 4, 5))
    middle, deep, width = 0.5 * (front + back), 0.5 * (front - back) * size, width * size
    steep = np.where(heights < HIPS, OUTWARDS, 0.0)
    return heights, np.array([middle + deep, middle - deep, width, power, np.gradient(width, heights), steep])


def _forearm(x: Float, y: Float, z: Float, arms: float) -> Float:
    """Return the distance of the forearm, from above the elbow down to the wrist, and the hand."""
    dx, dy, dz = x - JOINT[0], y - JOINT[1], z - JOINT[2]
    along, across = dx * np.sin(arms) - dy * np.cos(arms), dx * np.cos(arms) + dy * np.sin(arms)
    arm: Float | None = None
    for (start, thick), (end, thin) in pairwise(FOREARM):
        cone = _cone(along, across, dz, (start, 0.0, 0.0), (end, 0.0, 0.0), thick, thin)
        # One begins as thick as the other ends: blended, they would swell.
        arm = cone if arm is None else np.minimum(arm, cone)
    assert arm is not None
    (start, thick), (end, thin) = HAND
    for aside in FINGERS:
        cone = _cone(along, across, dz, (start, 0.0, aside), (end, 0.0, aside), thick, thin)
        arm = join(arm, cone, BLEND_HAND)
    return arm


def _cone(x: Float, y: Float, z: Float, a: tuple[float, ...], b: tuple[float, ...], thick: float, thin: float) -> Float:
    """Return the distance of a round cone between two places, whose radius goes from `thick` to `thin`."""
    way = np.subtract(b, a)
    share = ((x - a[0]) * way[0] + (y - a[1]) * way[1] + (z - a[2]) * way[2]) / float((way * way).sum())
    share = np.clip(share, 0.0, 1.0)
    away = _size(x - a[0] - share * way[0], y - a[1] - share * way[1], z - a[2] - share * way[2])
    return np.asarray(away - (thick + share * (thin - thick)))


def _size(x: Float, y: Float, z: Float) -> Float:
    return np.asarray(np.sqrt(x * x + y * y + z * z))
