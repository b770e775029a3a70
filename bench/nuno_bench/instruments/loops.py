"""KES: tension, shear and bending of a specimen that is strained and bent the same everywhere, there and back."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from nuno_bench.instruments.rig import Rig, mount
from nuno_schemas.fabric import Float

STRAIN = 1e-4
"""Strain, and angle of shear [rad]: small, for presets are what cloth has at first."""
MOST, STEPS = 250.0, 200
"""KES bends to so much [1/m], here in so many steps from level."""
LOW, HIGH, AT = 50.0, 150.0, 100.0
"""B is the slope between these curvatures [1/m], 2HB the width of the loop here, as KES reads them."""
SIDE, EDGE = 5e-3, 2.5e-4
"""Side of the bent specimen, and length of its edges [m]."""


@dataclass(frozen=True)
class Loop:
    """curvature (c,) [1/m] and moment (c,) per width [N] on the way; B [N m], 2HB [N], the curvature [1/m] that is left
    without moment after the greatest, and the work [J/m^2] that a cycle takes.
    """

    curvature: Float
    moment: Float
    rigidity: float
    hysteresis: float
    left: float
    work: float

    @property
    def recovery(self) -> float:
        """Angle [deg] by which a fold of 180 degrees, bent to MOST all round, opens when it is let go of (ISO 2313)."""
        return 180.0 * (1.0 - self.left / MOST)


def stretch(fabric: object, angle: float, **model: Any) -> float:
    """Stiffness [N/m] along a strip whose warp makes an angle [rad] with it, its width held."""
    return _stiffness(np.array([[1.0, 0.0], [0.0, 0.0]]), fabric, angle, **model)


def shear(fabric: object, angle: float, **model: Any) -> float:
    """Stiffness against shear [N/m]."""
    return _stiffness(np.array([[0.0, 1.0], [0.0, 0.0]]), fabric, angle, **model)


def _stiffness(gradient: Float, fabric: object, angle: float, **model: Any) -> float:
    """Work per area and squared strain, twice, of a displacement with this gradient in the strip's plane."""
    rig = mount("cantilever", fabric, size=[0.05, 0.05], hold=None, edge=5e-3, angle=angle, **model)
    x, area = rig.fabric.position, float(rig.fabric.mass.sum()) / density(rig)
    way = np.zeros_like(x)
    way[:, [0, 2]] = x[:, [0, 2]] @ gradient.T
    pulls = [-(rig.put(x + sign * STRAIN * way) * way).sum() for sign in (1.0, -1.0)]
    return float((pulls[0] - pulls[1]) / (2.0 * STRAIN * area))


def density(rig: Rig) -> float:
    """Mass per area [kg/m^2]."""
    corners = rig.fabric.position[rig.fabric.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(rig.fabric.mass.sum() / (0.5 * np.linalg.norm(across, axis=1)).sum())


def bend(fabric: object, angle: float, **model: Any) -> Loop:
    """A strip rolled up to MOST, to -MOST and back again: what its forces do on the way is the moment's work."""
    rig = mount("cantilever", fabric, size=[SIDE, SIDE], hold=None, edge=EDGE, angle=angle, **model)
    area = float(rig.fabric.mass.sum()) / density(rig)
    there = np.linspace(0.0, MOST, STEPS + 1)
    path = np.concatenate([there, there[-2::-1], -there[1:], -there[-2::-1], there[1:]])
    moments = []
    for before, after in itertools.pairwise(path):
        way = roll(rig.fabric.position, after) - roll(rig.fabric.position, before)
        force = rig.put(roll(rig.fabric.position, 0.5 * (before + after)))
        moments.append(-(force * way).sum() / (after - before) / area)
    curvature, moment = 0.5 * (path[1:] + path[:-1]), np.array(moments)
    # Of the closed loop, from the first return to level on: down to -MOST, and up to MOST.
    down, up = np.arange(STEPS, 3 * STEPS), np.arange(3 * STEPS, 5 * STEPS)
    slopes = []
    for part, sign in itertools.product((down, up), (1.0, -1.0)):
        some = part[(sign * curvature[part] > LOW) & (sign * curvature[part] < HIGH)]
        slopes.append(np.polyfit(curvature[some], moment[some], 1)[0])
    width = _at(curvature[up], moment[up], AT) - _at(curvature[down], moment[down], AT)
    left = float(np.interp(0.0, moment[down][::-1], curvature[down][::-1]))
    work = float((moment[down].sum() * -1.0 + moment[up].sum()) * MOST / STEPS)
    return Loop(curvature, moment, float(np.mean(slopes)), width, left, work)


def roll(flat: Float, curvature: float) -> Float:
    """(n, 3) a flat piece on a cylinder, its length round it."""
    x = flat.copy()
    if curvature != 0.0:
        x[:, 0] = np.sin(curvature * flat[:, 0]) / curvature
        x[:, 1] = flat[:, 1] + (1.0 - np.cos(curvature * flat[:, 0])) / curvature
    return x


def _at(curvature: Float, moment: Float, where: float) -> float:
    order = np.argsort(curvature)
    return float(np.interp(where, curvature[order], moment[order]))
