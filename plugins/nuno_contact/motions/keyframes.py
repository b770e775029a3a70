"""A rigid body moved by keyframes that are written in the scene."""

from __future__ import annotations

import bisect
import itertools
import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.motions.rotations import ease, from_axis_angle, from_euler, slerp
from nuno_contact.quantities import Point, Spin, Time
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config, Files, Mover
from nuno_schemas.vectors import norm

TURN = 2.0 * math.pi * (1.0 - 1e-12)
"""A whole turn [rad], but for rounding."""
WIDTH = {"euler": 3, "axis_angle": 4, "quaternion": 4}


class KeyframesConfig(Config):
    """Poses of a body at given times.

    Between keys a body turns the shorter way round: a key at least every half turn.
    """

    times: list[Time] = Field(description="of the keys [s], increasing")
    positions: list[Point] | None = Field(
        default=None, description="of the body's origin [m], one for each time; at rest at the origin unless given"
    )
    rotations: list[list[Spin]] | None = Field(
        default=None,
        description="one for each time, in the given form: euler [x, y, z], angles [rad] about world x first, then y, "
        "then z; axis_angle [x, y, z, angle [rad]]; quaternion [w, x, y, z], normalised",
    )
    form: Literal["euler", "axis_angle", "quaternion"] = Field(default="euler", description="how rotations are written")
    between: Literal["linear", "ease"] = Field(
        default="linear", description="how the body moves from key to key; ease starts and stops softly at each"
    )
    end: Literal["hold", "loop"] = Field(
        default="hold", description="what follows the last key: hold it, or loop from the first"
    )


def check_keys(config: KeyframesConfig) -> None:
    """Raise BadInput for lists that are empty, out of order or of different lengths."""
    times = config.times
    if not times:
        raise BadInput("a motion needs at least one keyframe", field="times", value=times, limit="one time or more")
    for k, (before, after) in enumerate(itertools.pairwise(times)):
        if not float(after) > float(before):
            raise BadInput("times must increase", field=f"times[{k + 1}]", value=after, limit=f"> {before:g} s")
    for name in ("positions", "rotations"):
        values = getattr(config, name)
        if values is not None and len(values) != len(times):
            raise BadInput(f"{len(values)} {name} for {len(times)} times", field=name, limit="one for each time")
    for k, values in enumerate(config.rotations or []):
        if len(values) != WIDTH[config.form]:
            raise BadInput(
                f"a rotation as {config.form} has {WIDTH[config.form]} numbers", field=f"rotations[{k}]", value=values
            )
    for k, values in enumerate(config.rotations[1:] if config.rotations else [], 1):
        turned = turn_between(config, k)
        if turned > TURN:
            raise BadInput(
                f"{turned / (2.0 * math.pi):.3g} turns between two keys are lost: a body turns the shorter way",
                field=f"rotations[{k}]", value=values, limit="less than one turn from key to key",
                remedy="add a key for each half turn; a bare number is in radians, degrees are written '90 deg'",
            )  # fmt: skip


def turn_between(config: KeyframesConfig, k: int) -> float:
    """The largest angle [rad] written between a key and the one before it."""
    angles = {"euler": slice(3), "axis_angle": slice(3, 4), "quaternion": slice(0)}[config.form]
    one, other = (config.rotations or [])[k - 1 : k + 1]
    return max((abs(b - a) for a, b in zip(one[angles], other[angles], strict=True)), default=0.0)


def read_rotation(values: list[float], form: str, field: str) -> Float:
    """Return a unit quaternion (4,). Raises BadInput for an axis or quaternion of length 0."""
    numbers = np.array(values, np.float64)
    if form == "euler":
        return from_euler(numbers)
    turned = numbers[:3] if form == "axis_angle" else numbers
    length = float(norm(turned))
    if length == 0.0:
        raise BadInput(f"a rotation as {form} needs a direction", field=field, value=values, limit="not all zero")
    return from_axis_angle(turned, float(numbers[3])) if form == "axis_angle" else numbers / length


@dataclass(frozen=True)
class _Keys:
    times: list[float]
    position: Float
    rotation: Float
    ease: bool
    loop: bool

    def pose(self, t: float) -> tuple[Float, Float]:
        """Return rotation (1, 4) and translation (1, 3) at time t [s]."""
        first, last = self.times[0], self.times[-1]
        if self.loop and last > first and t > last:
            t = first + math.fmod(t - first, last - first)
        k = bisect.bisect_right(self.times, t) - 1
        if k < 0 or k + 1 >= len(self.times):
            k = min(max(k, 0), len(self.times) - 1)
            return self.rotation[k : k + 1], self.position[k : k + 1]
        s = (t - self.times[k]) / (self.times[k + 1] - self.times[k])
        if self.ease:
            s = ease(s)
        turn = slerp(self.rotation[k : k + 1], self.rotation[k + 1 : k + 2], s)
        return turn, (1.0 - s) * self.position[k : k + 1] + s * self.position[k + 1 : k + 2]


class Keyframes:
    """One joint, "body", interpolated between keys."""

    name: ClassVar[str] = "keyframes"
    Config: ClassVar[type[BaseModel]] = KeyframesConfig

    def prepare(self, config: KeyframesConfig, files: Files) -> Mover:
        """Check the keys. Raises BadInput for keys that define no motion."""
        check_keys(config)
        given, number = config.rotations or [], len(config.times)
        turns = [read_rotation(values, config.form, f"rotations[{k}]") for k, values in enumerate(given)]
        keys = _Keys(
            times=list(config.times),
            position=np.zeros((number, 3)) if config.positions is None else np.array(config.positions, np.float64),
            rotation=np.array(turns) if turns else np.tile([1.0, 0.0, 0.0, 0.0], (number, 1)),
            ease=config.between == "ease",
            loop=config.end == "loop",
        )
        return Mover(("body",), np.array([-1], np.int32), np.zeros((1, 3)), keys.pose)

    def doubts(self, config: KeyframesConfig, files: Files) -> list[str]:
        """Say of the first key that is more than half a turn from the one before it that it is turned the other way,
        and of a loop that ends elsewhere than it begins that it jumps.
        """
        turns = [turn_between(config, k) for k in range(1, len(config.rotations or []))]
        far = [k for k, turn in enumerate(turns, 1) if math.pi * (1.0 + 1e-9) < turn <= TURN]
        texts = [
            f"rotations[{k}]: it is {math.degrees(turns[k - 1]):.4g} deg from the key before, and a body turns the "
            f"shorter way{f' (so do {len(far) - 1:,} more keys)' if len(far) > 1 else ''}: add a key for each half turn"
            for k in far[:1]
        ]
        pose = self.prepare(config, files).pose
        (turn, place), (turned, moved) = pose(float(config.times[0])), pose(float(config.times[-1]))
        if config.end == "loop" and (abs(float((turn * turned).sum())) < 1.0 - 1e-9 or not np.allclose(place, moved)):
            away = f"{float(norm(moved - place)[0]):.3g} m away, or turned"
            texts.append(f"end: the loop jumps from its last key to its first, {away}: let it end as it begins")
        return texts
