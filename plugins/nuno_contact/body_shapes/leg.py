"""A leg with heel and foot, from measurements, as a closed mesh of any resolution.

Rings of vertices follow the leg down from the thigh and the foot forward to the toes. Each reaches from a point of the
profile in front (shin, instep, top of the foot) to one behind (calf, heel, sole), so that the rings fan out about
the instep round the heel. A ring is a superellipse; rings between those of the table follow monotone
cubics, and those with a measured girth are scaled to it. Both ends are closed by caps.

Girths of thigh, knee, calf and ankle are the means, to a millimetre, of the 260 women in the data of G. Heinz,
L. J. Peterson, R. W. Johnson, C. J. Kerk: Exploring relationships in body dimensions, Journal of Statistics Education
11(2), 2003 (OpenIntro's data set `bdims`): 57.20, 35.26, 35.01 and 21.21 cm, with standard deviations of 4.6, 2.6, 2.6
and 1.4 cm. The heights of these girths, the profiles, and a foot of 24.5 cm are chosen to look like a leg of the
women's mean height of 164.9 cm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nuno_schemas.fabric import Float, Int
from nuno_schemas.vectors import norm


class Ring(NamedTuple):
    """Height and forward place of a ring's foremost and hindmost point [m], half width across [m], power of the
    superellipse, and measured girth [m], 0 for none.
    """

    front_height: float
    front: float
    back_height: float
    back: float
    width: float
    power: float
    girth: float


RINGS = (
    Ring(0.780, 0.095, 0.780, -0.098, 0.093, 2.1, 0.0),
    Ring(0.700, 0.092, 0.700, -0.088, 0.088, 2.1, 0.572),
    Ring(0.600, 0.084, 0.600, -0.066, 0.075, 2.1, 0.0),
    Ring(0.520, 0.074, 0.520, -0.053, 0.062, 2.2, 0.0),
    Ring(0.455, 0.068, 0.455, -0.044, 0.054, 2.3, 0.353),
    Ring(0.400, 0.055, 0.400, -0.053, 0.051, 2.2, 0.0),
    Ring(0.320, 0.042, 0.320, -0.072, 0.054, 2.1, 0.350),
    Ring(0.250, 0.037, 0.250, -0.066, 0.049, 2.1, 0.0),
    Ring(0.170, 0.033, 0.170, -0.048, 0.038, 2.1, 0.0),
    Ring(0.115, 0.032, 0.110, -0.042, 0.032, 2.1, 0.212),
    Ring(0.094, 0.038, 0.064, -0.048, 0.033, 2.2, 0.0),
    Ring(0.083, 0.050, 0.030, -0.051, 0.034, 2.2, 0.0),
    Ring(0.076, 0.063, 0.006, -0.038, 0.033, 2.2, 0.0),
    Ring(0.070, 0.079, 0.000, -0.004, 0.032, 2.3, 0.0),
    Ring(0.063, 0.099, 0.003, 0.036, 0.033, 2.3, 0.0),
    Ring(0.053, 0.126, 0.005, 0.078, 0.039, 2.3, 0.0),
    Ring(0.042, 0.152, 0.001, 0.118, 0.045, 2.4, 0.0),
    Ring(0.031, 0.174, 0.000, 0.152, 0.042, 2.4, 0.0),
    Ring(0.023, 0.187, 0.002, 0.176, 0.033, 2.4, 0.0),
)
"""the rings from thigh to toes"""
LANDMARKS = {"thigh": 0.700, "knee": 0.455, "calf": 0.320, "ankle": 0.1125}
"""Heights of the measured girths [m]."""
TOE, RIM = 0.012, 0.012
"""reach of the toes beyond the last ring, and the radius of the thigh's rounded rim [m]"""
CAP = 6
"""rings that round each end off"""
SPACING = 0.35
"""distance of rings times the vertices round them [m]: about the girth of a calf, so that quads are square there"""


def leg_mesh(around: int = 96) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] and triangles (f, 3) of a closed leg, `around` (at least 12) vertices to a ring.

    y is up, the toes point along +z and the sole stands on y = 0; the ankle is above the origin.
    """
    front, back, width, power, scale = _sections(around)
    angle = 2.0 * np.pi * np.arange(around) / around
    x, z = _outline(angle, power)
    middle, deep = 0.5 * (front + back), 0.5 * (front - back)
    offset = (x * width[:, None])[..., None] * np.array([1.0, 0.0, 0.0]) + z[..., None] * deep[:, None]
    rings = _cap(middle[:, None] + scale[:, None, None] * offset, deep[-1])
    ends = np.stack([rings[0].mean(axis=0), rings[-1].mean(axis=0)])
    vertices = np.concatenate([rings.reshape(-1, 3), ends])
    vertices[:, 1] -= vertices[:, 1].min()
    return vertices, _faces(len(rings), around)


def _outline(angle: Float, power: Float) -> tuple[Float, Float]:
    """Return (r, a) x and z of superellipses |x|^p + |z|^p = 1 at angles (a,)."""
    share = 2.0 / power[:, None]
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.sign(cosine) * np.abs(cosine) ** share, np.sign(sine) * np.abs(sine) ** share


def _sections(around: int) -> tuple[Float, Float, Float, Float, Float]:
    """Return, for every ring, the foremost and hindmost point (r, 3), half width, power and scale (r,)."""
    table = np.array(RINGS)
    steps = np.diff(table[:, :4], axis=0)
    along = np.concatenate(
        [[0.0], np.cumsum(0.5 * (np.hypot(steps[:, 0], steps[:, 1]) + np.hypot(steps[:, 2], steps[:, 3])))]
    )
    place = np.linspace(0.0, along[-1], max(len(RINGS), round(along[-1] * around / SPACING)))
    columns = [monotone(along, column, place) for column in table[:, :6].T]
    scale = np.interp(place, along, scales_of(RINGS))
    front = np.stack([0.0 * place, columns[0], columns[1]], axis=1)
    back = np.stack([0.0 * place, columns[2], columns[3]], axis=1)
    return front, back, columns[4], columns[5], scale


def scales_of(rings: Sequence[Ring]) -> Float:
    """Return the factors (r,) that give rings their measured girths; 1 for others."""
    table = np.array(rings)
    return np.where(table[:, 6] > 0.0, table[:, 6] / _girths(table), 1.0)


def _girths(table: Float) -> Float:
    """Return the girths (r,) of the table's rings as they stand, by 720 chords."""
    x, z = _outline(2.0 * np.pi * np.arange(721) / 720, table[:, 5])
    depth = 0.5 * np.hypot(table[:, 0] - table[:, 2], table[:, 1] - table[:, 3])
    return np.asarray(np.hypot(np.diff(x * table[:, 4:5]), np.diff(z * depth[:, None])).sum(axis=1))


def _cap(rings: Float, deep: Float) -> Float:
    """Return rings (r, a, 3) with further ones that round off the thigh's rim and the toes.

    `deep` (3,) points from the middle of the last ring to its foremost point, and so upwards.
    """
    turn = 0.5 * np.pi * np.arange(1, CAP + 1) / (CAP + 1)
    top, toe = rings[0].mean(axis=0), rings[-1].mean(axis=0)
    wide, narrow = rings[0] - top, rings[-1] - toe
    radius = float(norm(wide).mean())
    up = np.array([0.0, 1.0, 0.0])
    onward = np.array([0.0, -deep[2], deep[1]]) / norm(deep)
    rim = [top + RIM * np.sin(t) * up + (1.0 - RIM / radius * (1.0 - np.cos(t))) * wide for t in turn[::-1]]
    lid = [rim[0].mean(axis=0) + share * (rim[0] - rim[0].mean(axis=0)) for share in (0.25, 0.5, 0.75)]
    toes = [toe + TOE * np.sin(t) * onward + np.cos(t) * narrow for t in turn]
    return np.concatenate([np.stack(lid + rim), rings, np.stack(toes)])


def _faces(rows: int, around: int) -> Int:
    """Return the triangles of a tube of rings from the top down, and of the fans that close it."""
    row, column = np.divmod(np.arange((rows - 1) * around), around)
    a, b = row * around + column, row * around + (column + 1) % around
    c, d = a + around, b + around
    here, after = np.arange(around), (np.arange(around) + 1) % around
    n = rows * around
    top = np.stack([np.full(around, n), after, here], axis=1)
    toe = np.stack([np.full(around, n + 1), n - around + here, n - around + after], axis=1)
    tube = np.stack([a, b, c, b, d, c], axis=1).reshape(-1, 3)
    return np.concatenate([tube, top, toe]).astype(np.int32)


def monotone(x: Float, y: Float, at: Float) -> Float:
    """Interpolate y (n,) at ascending x (n,) by a piecewise cubic that does not overshoot: slopes are weighted harmonic
    means of the neighbours', 0 at an extreme (F. N. Fritsch, J. Butland, SIAM J. Sci. Stat. Comput. 5, 1984).
    """
    h, slope = np.diff(x), np.diff(y) / np.diff(x)
    w0, w1 = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (w0 + w1) / (w0 / slope[:-1] + w1 / slope[1:])
    inner = np.where(slope[:-1] * slope[1:] > 0.0, mean, 0.0)
    m = np.concatenate([slope[:1], inner, slope[-1:]])
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(h) - 1)
    s = (at - x[k]) / h[k]
    rise = (1.0 + 2.0 * s) * (1.0 - s) ** 2 * y[k] + s * s * (3.0 - 2.0 * s) * y[k + 1]
    return np.asarray(rise + h[k] * s * (1.0 - s) * ((1.0 - s) * m[k] - s * m[k + 1]))
