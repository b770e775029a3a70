"""Joints that are told where to be while a run goes on: by a tracker, a robot, a game engine."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, model_validator

from nuno_schemas.fabric import Float

ALL_BUT = 1.0 - 1e-9
"""Who has come so much of the way has arrived."""


class BodyPoses(BaseModel):
    """Whoever moves a body of `motion: {plugin: topic}`: where each of its joints is to be, in their order.

    Of one joint `position` and `rotation` may be given without a list around them, and a rotation that is left out is
    none.
    """

    model_config = ConfigDict(use_attribute_docstrings=True)
    positions: list[tuple[float, float, float]]
    """Of the joints' origins in the world [m]."""
    rotations: list[tuple[float, float, float, float]]
    """Quaternions w, x, y, z, of any length but zero."""

    @model_validator(mode="before")
    @classmethod
    def _of_one(cls, data: Any) -> Any:
        if isinstance(data, dict) and "position" in data:
            return {"positions": [data["position"]], "rotations": [data.get("rotation", (1.0, 0.0, 0.0, 0.0))]}
        return data


@dataclass
class Live:
    """Where j joints are, and how they follow what they are told.

    rotation      (j, 4) unit quaternions w, x, y, z, and translation (j, 3) [m]: now, at first where they wait
    key           under which poses are published on the bus; None: `poses/BODY` of the run
    waits         whether each frame waits for poses of its own; else it takes the newest, by the clock
    silence       [s] after which it is said that nothing comes: of waiting in a frame; by the clock of the scene's
    stops         whether silence ends the run; else the joints stay where they are
    fastest       [m/s] most that a joint follows at, and fastest_turn [rad/s]
    """

    rotation: Float
    translation: Float
    key: str | None = None
    waits: bool = False
    silence: float = 1.0
    stops: bool = False
    fastest: float = 5.0
    fastest_turn: float = 30.0

    def pose(self, t: float) -> tuple[Float, Float]:
        """Rotation (j, 4) and translation (j, 3) now, whatever the time."""
        return self.rotation.copy(), self.translation.copy()

    def follow(self, rotation: Float, translation: Float, dt: float) -> float:
        """Go towards poses for dt [s], all joints by the same share of their ways so that bones keep together; the
        share of the way that is left.
        """
        way = translation - self.translation
        length = float(np.sqrt((way**2).sum(axis=1)).max())
        dot = (self.rotation * rotation).sum(axis=1)
        half = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))[:, None]
        turn = 2.0 * float(half.max())
        share = min(1.0, _share(self.fastest * dt, length), _share(self.fastest_turn * dt, turn))
        if share > ALL_BUT:  # to the bit where they were told to be
            self.rotation, self.translation = rotation.copy(), translation.copy()
            return 0.0
        near = np.where(dot[:, None] < 0.0, -rotation, rotation)
        turned = np.sin((1.0 - share) * half) * self.rotation + np.sin(share * half) * near
        turned = np.where(half > 0.0, turned, near)
        self.rotation = turned / np.sqrt((turned**2).sum(axis=1, keepdims=True))
        self.translation = self.translation + share * way
        return 1.0 - share


def _share(most: float, way: float) -> float:
    return most / way if way > 0.0 else math.inf
