"""A torso with stumps of neck and arms to hang a shirt on, and a whole mannequin, each as one smooth closed mesh."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from nuno_contact.body_shapes.leg import RINGS, monotone, scales_of
from nuno_geometry.check import check_closed, crossing_notes
from nuno_geometry.isosurface import Field, find_isosurface
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

# A torso to hang a shirt on: chest, shoulders, and stumps of neck and upper arms, as one smooth closed mesh.
#
# Level rings of superellipses, between those of a table by monotone cubics, are the trunk and the neck; two
# ellipsoids are the breasts, and two cones with round ends the shoulders and upper arms. Their distance functions, the
# trunk's to first order, are blended (quadratic smooth minimum), and the zero level is drawn
# (nuno_geometry.isosurface). A tube of rings, as the leg is made, cannot branch; meshes put through each
# other would cut each other.
#
# Girths of waist and hip, and of the arm over the biceps, are the means to a millimetre of the 260 women in the data of
# Heinz et al. (2003) (nuno_contact.body_shapes.leg): 69.8, 95.7 and 28.1 cm. Bust (90 cm) and neck (33 cm), heights and
# profiles are chosen to look like a dress form of these girths, 164.9 cm tall were it whole.


class Level(NamedTuple):
    """Height of a ring [m], its reach forwards and backwards and half its width [m], power of the superellipse, and
    the name of its girth, if it has one.
    """

    height: float
    front: float
    back: float
    width: float
    power: float
    girth: str = ""


LEVELS = (
    Level(0.740, 0.080, -0.112, 0.172, 2.3),
    Level(0.850, 0.092, -0.122, 0.172, 2.2, "hip"),
    Level(0.940, 0.094, -0.104, 0.156, 2.2),
    Level(1.050, 0.090, -0.072, 0.118, 2.1, "waist"),
    Level(1.130, 0.098, -0.082, 0.128, 2.2),
    Level(1.200, 0.105, -0.094, 0.138, 2.2, "bust"),
    Level(1.270, 0.096, -0.102, 0.150, 2.2),
    Level(1.325, 0.070, -0.102, 0.150, 2.2),
    Level(1.365, 0.044, -0.092, 0.122, 2.1),
    Level(1.395, 0.036, -0.080, 0.080, 2.0),
    Level(1.420, 0.040, -0.068, 0.058, 2.0),
    Level(1.450, 0.046, -0.060, 0.052, 2.0, "neck"),
    Level(1.500, 0.048, -0.058, 0.052, 2.0),
)
"""the rings from the hips up"""
GIRTHS = {"bust": 0.900, "waist": 0.698, "hip": 0.957, "neck": 0.330, "arm": 0.281}
"""the default girths [m]"""
HEIGHTS = {level.girth: level.height for level in LEVELS if level.girth}
"""heights of the girths but the arm's [m]"""
BOTTOM, TOP = 0.780, 1.475
"""heights at which hips and neck are cut off [m]"""
JOINT = (0.152, 1.312, -0.012)
"""left shoulder joint, in the middle of a ball of radius SHOULDER [m]"""
SHOULDER, ARM, ALONG = 0.060, 0.220, 0.165
"""radius there, length of the stump from the joint, and the place along it where its girth is taken [m]"""
BREAST, BREAST_RADII = (0.068, 1.192, 0.078), (0.056, 0.062, 0.056)
"""middle of the left breast and its radii [m], before it is scaled with the bust"""
EDGE = 0.012
"""radius of the rounded rims [m]"""
BLEND_ARM, BLEND_BREAST = 0.050, 0.035
"""distances of two parts at which they begin to blend [m]"""
SMOOTH = 15
"""standard deviation of the weights that smooth profiles over heights [mm]"""
ROUNDS = 6
"""times that rings are scaled until all girths are right"""
TOLERANCE = 5e-3
"""error of a girth that is then allowed, as a share; a possible one is 1e-4 off"""
RAYS, FARTHEST = 180, 0.3
"""chords by which a girth is measured, and the reach of its section [m]"""
SECANTS = 5
"""steps that find where a ray leaves, from 5 mm on"""


def torso_mesh(
    around: int = 96, girths: Mapping[str, float] | None = None, arms: float = 0.25 * np.pi
) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] and triangles (f, 3) of a closed torso, about `around` vertices round its waist.

    girths: those of GIRTHS that are to be others [m]; arms: angle between arms and plumb line [rad]. y is up, the floor
    y = 0 of the body that it is part of, and it faces +z; it is its own mirror image in x. Raises BadInput for girths
    that leave no room between arms and trunk, or too little for these triangles.
    """
    scale = find_scales(girths or {}, arms)
    reach = JOINT[0] + ARM * np.sin(arms) + 2.0 * SHOULDER
    spacing = {**GIRTHS, **(girths or {})}["waist"] / around
    low, high = np.array([-reach, BOTTOM - 0.05, -0.4]), np.array([reach, TOP + 0.05, 0.4])
    return draw(lambda x, y, z: field_of(x, y, z, scale, arms), low, high, spacing)


def find_scales(girths: Mapping[str, float], arms: float) -> dict[str, float]:
    """Return the scales of parts, by their girths' names. Raises BadInput for girths that leave no room between arms
    and trunk.
    """
    wanted = {**GIRTHS, **girths}
    scale = dict.fromkeys(wanted, 1.0)
    scale["arm"] = wanted["arm"] / (2.0 * np.pi * SHOULDER)
    for _ in range(ROUNDS):
        found = _measure(scale, arms)
        scale = {name: scale[name] * wanted[name] / found[name] for name in wanted}
    off = {name: girth / wanted[name] - 1.0 for name, girth in _measure(scale, arms).items()}
    worst = max(off, key=lambda name: abs(off[name]))
    if abs(off[worst]) > TOLERANCE:
        raise BadInput(
            "arms and trunk of the torso would meet", field=f"girths.{worst}", value=f"{wanted[worst]:.3g} m",
            limit=f"less, with arms at {np.degrees(arms):.3g} deg", remedy="raise the arms, or choose smaller girths",
        )  # fmt: skip
    return scale


def draw(field: Field, low: Float, high: Float, spacing: float) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] and triangles (f, 3) of a figure that is its own mirror image, within low and high
    (3,) [m], with sides of about `spacing` [m]. Raises BadInput if two of its limbs are as near to each other.
    """
    half = (np.ceil(high[0] / spacing) + 0.5) * spacing
    x, faces = find_isosurface(field, np.array([-half, *low[1:]]), np.array([half, *high[1:]]), spacing)
    check_closed(x, faces)
    # Limbs that have merged make handles, or pass through each other.
    if len(x) - len(faces) // 2 != 2 or crossing_notes(x, faces):
        raise BadInput(
            "the mannequin's limbs come too near to each other for triangles of this size", field="resolution",
            remedy="a higher resolution, arms raised further, or smaller girths",
        )  # fmt: skip
    return x, faces


def field_of(x: Float, y: Float, z: Float, scale: Mapping[str, float], arms: float) -> Float:
    """Return about the signed distance [m] at places x, y, z [m] of a torso whose parts are scaled."""
    return cap(cap(upper_body(x, y, z, scale, arms, ARM), BOTTOM - y), y - TOP)


def upper_body(x: Float, y: Float, z: Float, scale: Mapping[str, float], arms: float, length: float = np.inf) -> Float:
    """Return the same, not cut off at hips and neck, with arms of this `length` [m], at most a round end longer than
    ARM.
    """
    x = np.abs(x)
    trunk = _trunk(x, y, z, scale)
    size = scale["bust"]
    dx, dy, dz = (x - size * BREAST[0], y - BREAST[1], z - size * BREAST[2])
    ball = np.sqrt((dx / BREAST_RADII[0]) ** 2 + (dy / BREAST_RADII[1]) ** 2 + (dz / BREAST_RADII[2]) ** 2)
    breast = (ball - size) * min(BREAST_RADII)
    return join(join(trunk, breast, BLEND_BREAST), _arm(x, y, z, scale["arm"], arms, length), BLEND_ARM)


def _trunk(x: Float, y: Float, z: Float, scale: Mapping[str, float]) -> Float:
    """Return the rings' own distance, to first order: off by the slope with which they widen."""
    heights, columns = _columns()
    known = [level for level in LEVELS if level.girth]
    sizes = smooth(np.interp(heights, [level.height for level in known], [scale[level.girth] for level in known]))
    front, back, width, power, slope, size = (np.interp(y, heights, column) for column in (*columns, sizes))
    middle, deep = 0.5 * (front + back), 0.5 * (front - back)
    ring = (np.abs(x / (size * width)) ** power + np.abs((z - middle) / (size * deep)) ** power) ** (1.0 / power)
    return np.asarray((ring - 1.0) * size * np.minimum(width, deep) / np.sqrt(1.0 + slope * slope))


@cache
def _columns() -> tuple[Float, Float]:
    """Return heights (h,) a millimetre apart, and front, back, width, power and slope of the width (5, h) there."""
    table = np.array([level[:5] for level in LEVELS])
    heights = np.linspace(table[0, 0], table[-1, 0], round((table[-1, 0] - table[0, 0]) * 1e3) + 1)
    columns = [smooth(monotone(table[:, 0], column, heights)) for column in table[:, 1:].T]
    return heights, np.array([*columns, np.gradient(columns[2], heights)])


def smooth(column: Float) -> Float:
    """Average values a millimetre apart over SMOOTH: light shows where the curvature of cubics jumps."""
    place = np.arange(-3 * SMOOTH, 3 * SMOOTH + 1)
    weight = np.exp(-0.5 * (place / SMOOTH) ** 2)
    padded = np.pad(column, 3 * SMOOTH, mode="edge")
    # np.convolve calls BLAS: see nuno_schemas.vectors.
    return np.asarray(sum(share * padded[k : k + len(column)] for k, share in enumerate(weight / weight.sum())))


def _arm(x: Float, y: Float, z: Float, scale: float, arms: float, length: float) -> Float:
    """Return the distance of a cone from the shoulder's ball down the arm, cut off at its end."""
    dx, dy, dz = x - JOINT[0], y - JOINT[1], z - JOINT[2]
    along = dx * np.sin(arms) - dy * np.cos(arms)
    t = np.clip(along / ALONG, 0.0, ARM / ALONG)
    away = np.sqrt((dx - t * ALONG * np.sin(arms)) ** 2 + (dy + t * ALONG * np.cos(arms)) ** 2 + dz**2)
    arm = away - SHOULDER * (1.0 + (scale - 1.0) * t)
    return cap(arm, along - length) if np.isfinite(length) else np.asarray(arm)


def join(a: Float, b: Float, blend: float) -> Float:
    """Return the union of two parts, rounded where they meet."""
    h = np.maximum(blend - np.abs(a - b), 0.0)
    return np.asarray(np.minimum(a, b) - h * h / (4.0 * blend))


def cap(a: Float, b: Float) -> Float:
    """Return the intersection of two parts, with the rim between them rounded."""
    h = np.maximum(EDGE - np.abs(a - b), 0.0)
    return np.asarray(np.maximum(a, b) + h * h / (4.0 * EDGE))


def _measure(scale: Mapping[str, float], arms: float) -> dict[str, float]:
    """Measure the girths of the torso by RAYS chords."""
    angle = np.linspace(0.0, 2.0 * np.pi, RAYS + 1)
    sine, cosine = np.sin(angle), np.cos(angle)
    found = {}
    for name, height in HEIGHTS.items():
        level = next(level for level in LEVELS if level.girth == name)
        middle = np.array([0.0, height, 0.5 * (level.front + level.back)])
        found[name] = _girth(middle, np.stack([sine, 0.0 * angle, cosine], axis=1), scale, arms)
    way, side = np.array([np.sin(arms), -np.cos(arms), 0.0]), np.array([np.cos(arms), np.sin(arms), 0.0])
    across = sine[:, None] * side + cosine[:, None] * np.array([0.0, 0.0, 1.0])
    found["arm"] = _girth(np.array(JOINT) + ALONG * way, across, scale, arms)
    return found


def _girth(middle: Float, ways: Float, scale: Mapping[str, float], arms: float) -> float:
    """Return the length round the section that rays (r, 3) from a place inside of it first leave."""
    reach = np.linspace(0.0, FARTHEST, 61)
    value = _at(middle + reach[:, None, None] * ways, scale, arms)
    out = np.argmax(value >= 0.0, axis=0)
    a, b = reach[out - 1], reach[out]
    fa, fb = (np.take_along_axis(value, index[None], axis=0)[0] for index in (out - 1, out))
    for _ in range(SECANTS):
        with np.errstate(divide="ignore", invalid="ignore"):
            c = np.where(fb == fa, b, b - fb * (b - a) / (fb - fa))
        a, fa, b = b, fb, c
        fb = _at(middle + c[:, None] * ways, scale, arms)
    edge = middle + b[:, None] * ways
    return float(np.linalg.norm(np.diff(edge, axis=0), axis=1).sum())


def _at(places: Float, scale: Mapping[str, float], arms: float) -> Float:
    """Return the field at places (..., 3) [m]."""
    return field_of(places[..., 0], places[..., 1], places[..., 2], scale, arms)


# A whole mannequin: the torso with legs, feet, arms, hands and a head without a face, as one smooth closed mesh.
#
# It stands in an A-pose, feet apart, so that trousers have room between its legs. Trunk, breasts and upper arms are
# the torso's, with its girths; legs have the rings of nuno_contact.body_shapes.leg down to the
# ankle, and so the girths of thigh, knee, calf and ankle. Feet, forearms and hands are cones and ellipsoids, chosen to
# look like those of a woman of 164.9 cm.

HIPS = 0.775
"""height at which the trunk ends between the legs [m]"""
LEG_TOP = 0.80
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
    heights, columns = _tube_columns()
    front, back, width, power, slope, tilt = (np.interp(y, heights, column) for column in columns)
    middle, deep, aside = 0.5 * (front + back), 0.5 * (front - back), x - _middle(y)
    ring = (np.abs(aside / width) ** power + np.abs((z - middle) / deep) ** power) ** (1.0 / power)
    tube = (ring - 1.0) * np.minimum(width, deep) / np.sqrt(1.0 + slope * slope + tilt * tilt)
    leg = cap(cap(tube, ANKLE - y), y - LEG_TOP)
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
def _tube_columns() -> tuple[Float, Float]:
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
