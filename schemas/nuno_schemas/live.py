"""Joints steered from outside during a run: by a tracker, a robot, a game engine."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Strict, model_validator

from nuno_schemas.fabric import Float

ALL_BUT = 1.0 - 1e-9
"""A joint that has gone this share of the way has arrived."""


Number = Annotated[float, Strict()]  # no text, no truth value


class BodyPoses(BaseModel):
    """The sender steers a body of `motion: {plugin: topic}`: target poses of its joints, in their order.

    For a single joint, `position` and `rotation` may be given without lists, and a missing rotation is the identity.
    """

    model_config = ConfigDict(use_attribute_docstrings=True, extra="forbid")
    positions: list[tuple[Number, Number, Number]]
    """Positions of the joints' origins in the world [m]."""
    rotations: list[tuple[Number, Number, Number, Number]]
    """Quaternions w, x, y, z of any norm but zero."""

    @model_validator(mode="before")
    @classmethod
    def _of_one(cls, data: Any) -> Any:
        if isinstance(data, dict) and "position" in data:
            if both := sorted({"positions", "rotations"} & data.keys()):
                raise ValueError(f"position and {both[0]}: give position and rotation, or positions and rotations")
            one = {"positions": [data["position"]], "rotations": [data.get("rotation", (1.0, 0.0, 0.0, 0.0))]}
            return one | {name: data[name] for name in data.keys() - {"position", "rotation"}}
        return data


@dataclass
class Live:
    """Current poses of j joints, and how they follow their targets.

    rotation      (j, 4) unit quaternions w, x, y, z, and translation (j, 3) [m]: current, at first the initial poses
    key           bus key of the target poses; None: `poses/BODY` of the run
    waits         whether each frame waits for its own poses; else it takes the newest, by the clock
    silence       [s] without poses before a warning: of waiting in a frame, or by the clock of scene time
    stops         whether silence ends the run; else the joints stop where they are
    fastest       [m/s] largest speed of a joint, and fastest_turn [rad/s]
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
        """Return the current rotation (j, 4) and translation (j, 3) [m] for any t."""
        return self.rotation.copy(), self.translation.copy()

    def follow(self, rotation: Float, translation: Float, dt: float) -> float:
        """Move towards the target poses for dt [s], all joints by the same share of their ways so that bones stay
        joined. Return the share of the way that is left.
        """
        way = translation - self.translation
        length = float(np.sqrt((way**2).sum(axis=1)).max())
        dot = (self.rotation * rotation).sum(axis=1)
        half = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))[:, None]
        turn = 2.0 * float(half.max())
        share = min(1.0, _share(self.fastest * dt, length), _share(self.fastest_turn * dt, turn))
        if share > ALL_BUT:  # the target poses to the bit
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
