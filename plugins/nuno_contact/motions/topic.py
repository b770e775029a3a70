"""A body whose poses arrive on the bus during the run: from a tracker, a robot or a game engine."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field, field_validator
from pydantic_core import PydanticCustomError

from nuno_contact.motions.bvh import BVH, BvhConfig
from nuno_contact.motions.keyframes import read_rotation
from nuno_contact.motions.rotations import multiply
from nuno_contact.quantities import Number, Point, Silence, Size, Speed, TurnRate
from nuno_schemas.bodies import LARGEST, SMALLEST, rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.live import Live
from nuno_schemas.plugin import Config, Files, Mover
from nuno_schemas.vectors import turn

KEY = re.compile(r"[^/*$?#\s]+(/[^/*$?#\s]+)*")
"""a zenoh key without wildcards"""


class TopicConfig(Config):
    """The source of poses, and the response to late, missing or jumping ones."""

    key: str | None = Field(
        default=None,
        description="under which they are published on the bus, as `robot/hand`; nuno/RUN/poses/BODY unless given",
    )
    frames: Literal["clock", "poses"] = Field(
        default="clock",
        description="clock: frames wait for the clock and take the newest poses; poses: each frame waits for the next "
        "ones and none is left out, as with a robot's simulator that goes on in step",
    )
    silence: Silence = Field(
        default=1.0, description="after this time without poses that is said; a frame waits no longer for them [s]"
    )
    silent: Literal["hold", "stop"] = Field(
        default="hold",
        description="what follows, by the clock once poses have come: the body stays where it is, or the run ends",
    )
    fastest: Speed = Field(
        default=5.0, description="most that it follows at: what jumps is gone to at this speed [m/s]"
    )
    fastest_turn: TurnRate = Field(default=30.0, description="the same of its turning [rad/s]")
    position: Point = Field(default=(0.0, 0.0, 0.0), description="where it waits for the first poses [m]")
    rotation: tuple[Number, Number, Number, Number] = Field(
        default=(1.0, 0.0, 0.0, 0.0), description="how it waits for them, a quaternion w, x, y, z"
    )
    skeleton: str | None = Field(
        default=None,
        description="a BVH file whose joints it has, and waits at the start of; one joint, `body`, unless given",
    )
    scale: Size | None = Field(
        default=None, description="length of one of the skeleton file's units [m]; the metre unless given"
    )

    @field_validator("key")
    @classmethod
    def _one_key(cls, key: str | None) -> str | None:
        if key is not None and not KEY.fullmatch(key):
            problem = "must be names between slashes, without wildcards, such as robot/hand"
            raise PydanticCustomError("not_a_key", problem)
        return key


class Topic:
    """One joint, "body", or those of a skeleton, at the poses that arrive on a topic."""

    name: ClassVar[str] = "topic"
    Config: ClassVar[type[BaseModel]] = TopicConfig

    def paced(self, config: TopicConfig) -> bool:
        """See nuno_schemas.plugin.Motion."""
        return config.frames == "clock"

    def prepare(self, config: TopicConfig, files: Files) -> Mover:
        """Prepare the motion. Raises BadInput for a bad skeleton, one without a unit, and a rotation of length 0."""
        rotation = read_rotation(list(config.rotation), "quaternion", "rotation")[None]
        translation = np.array([config.position], np.float64)
        rest = Mover(("body",), np.array([-1], np.int32), np.zeros((1, 3)), lambda t: (rotation, translation))
        if config.skeleton is not None:
            # Poses arrive in the world, so neither the file's rate nor its vertical axis matters.
            scale = config.scale or 1.0
            file = BvhConfig(file=config.skeleton, position=config.position, frame_rate=1.0, up="y", scale=scale)
            rest = BVH().prepare(file, files)
            turns, places = rest.pose(0.0)
            size = float(np.ptp(places, axis=0).max())
            if config.scale is None and not SMALLEST <= size <= LARGEST:
                limit, remedy = f"{SMALLEST} to {LARGEST} m", f"scale: 1cm or 1mm; scale: 1m if it is {size:.3g} m long"
                value = f"{size:.3g} units"
                raise BadInput("it may not be in metres", config.skeleton, None, "scale", value, limit, remedy)
            translation = translation + turn(rotation_matrices(rotation)[0], places - translation)
            rotation = multiply(rotation, turns)
        elif config.scale is not None:
            raise BadInput("no skeleton to scale", field="scale", remedy="give skeleton, or leave it out")
        live = Live(
            rotation, translation, config.key, config.frames == "poses", config.silence, config.silent == "stop",
            config.fastest, config.fastest_turn,
        )  # fmt: skip
        return replace(rest, pose=live.pose, live=live)
