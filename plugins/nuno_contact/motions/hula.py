"""A procedural hula dancer: the hips circle and sway, knees and spine follow, the feet stay.

Joint positions are fractions of body height, read off horizontal sections of a real body of
1.666 m (its skin is a CC0 mesh): hip joints at 0.52, knees at 0.285, ankles at 0.045, waist
(narrowest) at 0.65, shoulders at 0.80, chin at 0.86. y is up, the dancer looks along +z, the soles
are at y = 0, and the left side is at x > 0.
"""

from __future__ import annotations

import math
from typing import ClassVar, cast

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.motions.rotations import (
    AXES,
    ease,
    from_axis_angle,
    from_euler,
    from_matrices,
    invert,
    multiply,
    pose_skeleton,
)
from nuno_contact.quantities import Point, Reach, Size, Span, Tempo, Tilt, Turn
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import Config, Files, Mover
from nuno_schemas.vectors import dot, norm, turn

_SPINE = [
    ("hips", "", (0.0, 0.55, 0.0)),
    ("spine", "hips", (0.0, 0.08, 0.0)),
    ("chest", "spine", (0.0, 0.10, 0.0)),
    ("neck", "chest", (0.0, 0.095, 0.0)),
    ("head", "neck", (0.0, 0.065, 0.01)),
    ("head_end", "head", (0.0, 0.095, 0.0)),
]
_SIDE = [
    ("arm", "chest", (0.105, 0.065, 0.0)),
    ("forearm", "{}_arm", (0.165, 0.0, 0.0)),
    ("hand", "{}_forearm", (0.145, 0.0, 0.0)),
    ("hand_end", "{}_hand", (0.09, 0.0, 0.0)),
    ("thigh", "hips", (0.052, -0.03, 0.0)),
    ("shin", "{}_thigh", (0.0, -0.235, 0.0)),
    ("foot", "{}_shin", (0.0, -0.24, 0.0)),
    ("foot_end", "{}_foot", (0.0, -0.025, 0.115)),
]
STILL = np.array([1.0, 0.0, 0.0, 0.0])
SIDES = (("left", 1.0), ("right", -1.0))
ANKLE = 0.045
STANCE = 0.065
"""distance of the ankles from the middle (fraction of height)"""
BEND = 0.022
"""lowering of the hips against straight legs (fraction of height), so that the knees stay bent wherever the hips go"""


def build_skeleton(height: float) -> tuple[list[str], Int, Float]:
    """Return names, parents and offsets [m] of a dancer's joints; parents come first."""
    rows = list(_SPINE)
    for side, sign in SIDES:
        rows += [(f"{side}_{name}", parent.format(side), (sign * x, y, z)) for name, parent, (x, y, z) in _SIDE]
    names = [name for name, _, _ in rows]
    parents = [names.index(parent) if parent else -1 for _, parent, _ in rows]
    return names, np.array(parents, np.int32), height * np.array([offset for _, _, offset in rows])


class HulaConfig(Config):
    """The dance."""

    height: Size = Field(default=1.65, description="of the body [m]")
    tempo: Tempo = Field(default=0.8, description="circles of the hips per second [Hz]")
    amplitude: Reach = Field(
        default=0.07, description="radius of the hips' circle [m]; refused where a foot would leave the floor"
    )
    sway: Tilt = Field(default=0.16, description="largest sideways tilt of the hips [rad]")
    twist: Turn = Field(default=0.2, description="largest turn of the hips about the vertical [rad]")
    ramp: Span = Field(default=2.0, description="time in which the dance grows from standing still [s]")
    position: Point = Field(default=(0.0, 0.0, 0.0), description="where the dancer stands [m]")


def aim(direction: Float, front: Float) -> Float:
    """Return the rotation (4,) that turns -y to `direction` and keeps z as near to `front` as that allows."""
    y = -direction / norm(direction)
    z = front - dot(front, y) * y
    z /= norm(z)
    return from_matrices(np.stack([np.cross(y, z), y, z], axis=1))


def bend_leg(hip: Float, ankle: Float, thigh: float, shin: float, front: Float) -> Float:
    """Return the knee (3,) between hip and ankle [m], bent towards `front` (law of cosines).

    The leg is stretched towards the ankle if it cannot reach it.
    """
    line = ankle - hip
    far = float(norm(line))
    unit = line / far
    far = min(far, (1.0 - 1e-9) * (thigh + shin))
    reach = (thigh**2 - shin**2 + far**2) / (2.0 * far)
    out = front - dot(front, unit) * unit
    out /= norm(out)
    return np.asarray(hip + reach * unit + math.sqrt(thigh**2 - reach**2) * out)


class _Dancer:
    """Poses of the joints as a function of time alone."""

    def __init__(self, config: HulaConfig) -> None:
        self.config = config
        self.names, self.parents, self.offsets = build_skeleton(config.height)
        self.index = {name: j for j, name in enumerate(self.names)}

    def circle(self, level: float, phase: float) -> Float:
        """Return the hips' offset (3,) from their middle [m]; flatter to the front than to the side."""
        return np.asarray(level * self.config.amplitude * np.array([math.cos(phase), 0.0, 0.75 * math.sin(phase)]))

    def turns(self, level: float, phase: float) -> dict[str, Float]:
        """Return the rotation of the upper joints against their parents, at a level of the dance in [0, 1].

        Spine and chest undo most of the hips' tilt and twist, and the spine leans against their
        circle, so that the chest stays calm.
        """
        c = self.config
        tilt = level * c.sway * math.sin(phase)
        twist = level * c.twist * math.sin(phase - 0.5 * math.pi)
        rock = level * 0.4 * c.sway * math.cos(phase)
        undo = from_euler(np.array([-0.45 * rock, -0.45 * twist, -0.45 * tilt]))
        lean = 0.7 / (0.195 * c.height) * self.circle(level, phase)
        wave = 0.18 * level * math.sin(phase + 0.4)
        found = {"hips": from_euler(np.array([rock, twist, tilt])), "chest": undo}
        found["spine"] = multiply(undo, from_euler(np.array([-lean[2], 0.0, lean[0]])))
        found["neck"] = found["head"] = from_euler(np.array([0.0, 0.0, -0.05 * level * math.sin(phase)]))
        for side, sign in SIDES:
            raise_arm = from_axis_angle(AXES[2], sign * (0.12 + sign * wave))
            found[f"{side}_arm"] = multiply(from_axis_angle(AXES[1], -0.35 * sign), raise_arm)
            bend = from_axis_angle(AXES[2], sign * (0.25 - sign * wave))
            found[f"{side}_forearm"] = multiply(from_axis_angle(AXES[1], -0.5 * sign), bend)
            found[f"{side}_hand"] = from_axis_angle(AXES[2], -sign * 0.25 + 1.2 * wave)
        return found

    def legs(self, hips: Float, rotation: Float, place: Float) -> dict[str, Float]:
        """Return the rotation of thighs, shins and feet against their parents: ankles stay on the floor.

        `hips` (3,) and `rotation` (4,) are the hips' place and rotation in the world.
        """
        height, tilt = self.config.height, rotation_matrices(rotation[None])[0]
        found = {}
        for side, sign in SIDES:
            front = np.array([0.35 * sign, 0.0, 1.0])
            joint = {part: self.offsets[self.index[f"{side}_{part}"]] for part in ("thigh", "shin", "foot")}
            hip = hips + turn(tilt, joint["thigh"])
            ankle = place + height * np.array([sign * STANCE, ANKLE, 0.0])
            knee = bend_leg(hip, ankle, -float(joint["shin"][1]), -float(joint["foot"][1]), front)
            thigh, shin = aim(knee - hip, front), aim(ankle - knee, front)
            found[f"{side}_thigh"] = multiply(invert(rotation), thigh)
            found[f"{side}_shin"] = multiply(invert(thigh), shin)
            found[f"{side}_foot"] = multiply(invert(shin), from_axis_angle(AXES[1], 0.3 * sign))
        return found

    def stretch(self) -> float:
        """Return the largest distance from hip to ankle in a full dance, over the length of the leg."""
        height, most = self.config.height, 0.0
        for phase in np.linspace(0.0, 2.0 * math.pi, 73):
            tilt = rotation_matrices(self.turns(1.0, phase)["hips"][None])[0]
            for side, sign in SIDES:
                thigh, shin, foot = (self.offsets[self.index[f"{side}_{part}"]] for part in ("thigh", "shin", "foot"))
                hip = height * np.array([0.0, 0.55 - BEND, 0.0]) + self.circle(1.0, phase) + turn(tilt, thigh)
                ankle = height * np.array([sign * STANCE, ANKLE, 0.0])
                most = max(most, float(norm(ankle - hip) / -(shin[1] + foot[1])))
        return most

    def pose(self, t: float) -> tuple[Float, Float]:
        """Return rotation (j, 4) and translation (j, 3) [m] in the world."""
        c = self.config
        level, phase = ease(max(t, 0.0) / c.ramp) if t < c.ramp else 1.0, 2.0 * math.pi * c.tempo * t
        place = np.array(c.position)
        hips = place + np.array([0.0, c.height * (0.55 - BEND), 0.0]) + self.circle(level, phase)
        turns = self.turns(level, phase)
        turns |= self.legs(hips, turns["hips"], place)
        local = np.array([turns.get(name, STILL) for name in self.names])
        return pose_skeleton(self.parents, self.offsets, local, hips)


class Hula:
    """The hula: a skeleton of 22 joints, moved by a formula; periodic after `ramp`."""

    name: ClassVar[str] = "hula"
    Config: ClassVar[type[BaseModel]] = HulaConfig

    def prepare(self, config: BaseModel, files: Files) -> Mover:
        """Raise BadInput for a circle, sway and twist so wide that the legs cannot reach the floor."""
        dancer = _Dancer(cast(HulaConfig, config))
        if dancer.stretch() > 1.0:
            raise BadInput(
                "the hips go further than the legs reach", field="amplitude", value=dancer.config.amplitude,
                limit=f"legs stretched to {dancer.stretch():.3f} of their length", remedy="lower amplitude or sway",
            )  # fmt: skip
        return Mover(tuple(dancer.names), dancer.parents, dancer.offsets, dancer.pose)
