"""Bodies that are told where to be while a run goes on: what comes for them, and what of it they follow.

Whatever comes, each frame has one pose of each body, and a run goes on: what cannot be read is refused and told, what
jumps is gone to at the greatest speed, and where nothing comes bodies stay where they are, or the run ends.
"""

from __future__ import annotations

import contextlib
import queue
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zenoh
from pydantic import ValidationError

from nuno.service import Context
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Float
from nuno_schemas.live import BodyPoses, Live
from nuno_schemas.messages import POSES

LOOK = 0.1
"""How often whoever waits for poses looks whether the run is still wanted [s]."""
MOST = 10_000
"""Poses that may lie there; more come from no tracker."""
LONGEST = 500
"""Characters of a refused message's error that are told."""


@dataclass
class Told:
    """What came for a body, for the report.

    heard poses in all, of them used and refused; frames without any, frames in which the body was not where it was
    told to be, and the longest silence [s].
    """

    heard: int = 0
    used: int = 0
    refused: int = 0
    without: int = 0
    behind: int = 0
    silence: float = 0.0


@dataclass
class Follower:
    """One body, what has come for it, and where it is told to be."""

    body: str
    joints: tuple[str, ...]
    live: Live
    goal: tuple[Float, Float]
    came: queue.Queue[bytes] = field(default_factory=lambda: queue.Queue(MOST))
    told: Told = field(default_factory=Told)
    last: float = field(default_factory=time.monotonic)
    """When poses came last [s]."""
    said: set[str] = field(default_factory=set)

    def receive(self, sample: zenoh.Sample) -> None:
        """Keep what came, in a thread of zenoh's."""
        with contextlib.suppress(queue.Full):
            self.came.put_nowait(sample.payload.to_bytes())


class Followers:
    """All such bodies of a run."""

    def __init__(self, context: Context, bodies: Iterator[tuple[str, tuple[str, ...], Live]]) -> None:
        """`bodies` by name, with the joints of each. Raises BadInput for a key that zenoh does not take."""
        self.context = context
        self.each = [Follower(name, joints, live, live.pose(0.0)) for name, joints, live in bodies]
        bus = context.bus
        for one in self.each:
            key = one.live.key or bus.key(f"{POSES.name}/{one.body}")
            try:
                bus.offers.append(bus.session.declare_subscriber(key, one.receive))
            except zenoh.ZError as error:
                raise BadInput(f"the bus has no such key: {error}", field="key", value=key) from None

    def take_up(self, poses: Poses, frames: tuple[str, ...]) -> None:
        """Have all bodies where they were in a frame of a recording; `frames` are the names of its frames."""
        for one in self.each:
            rows = [frames.index(f"{one.body}/{joint}") for joint in one.joints]
            one.goal = one.live.rotation, one.live.translation = poses.rotation[rows], poses.translation[rows]

    def go_on(self, frame: int, dt: float) -> None:
        """Bring all bodies to where they are at the end of a frame of dt [s]. Raises RunFailed where silence ends the
        run.
        """
        for one in self.each:
            self._hear(one, frame)
            left = one.live.follow(*one.goal, dt)
            if left > 0.0:
                one.told.behind += 1
                limit = f"follows at {one.live.fastest:g} m/s and {one.live.fastest_turn:g} rad/s at most"
                self._say(
                    one, "jump", f"was told to be {left:.3g} m farther on than it gets in a frame: it {limit}", frame
                )

    def _hear(self, one: Follower, frame: int) -> None:
        """Take in what has come for a body: the next of it, or the newest."""
        fresh, waited = False, one.live.waits
        for payload in self._come(one):
            try:
                one.goal, fresh = read_poses(payload, one.joints), True
                one.told.used += 1
            except BadInput as error:
                one.told.refused += 1
                self._say(one, error.problem, f"was sent what cannot be followed: {error}"[:LONGEST], frame)
            if waited and fresh:
                break
        now = time.monotonic()
        if fresh:
            one.told.silence, one.last = max(one.told.silence, now - one.last), now
            one.said.discard("silence")
            return
        one.told.without += 1
        if (silent := now - one.last) > one.live.silence:
            one.told.silence = max(one.told.silence, silent)
            problem = f"has heard nothing for {silent:.2g} s"
            if one.live.stops:
                raise RunFailed(f"the body {one.body} {problem}, and its motion says silent: stop")
            self._say(one, "silence", f"{problem}: it stays where it is", frame)

    def _come(self, one: Follower) -> Iterator[bytes]:
        """What lies there; where a frame waits for poses of its own, what comes until the body has been silent for too
        long.
        """
        while True:
            try:
                left = one.last + one.live.silence - time.monotonic() if one.live.waits else 0.0
                payload = one.came.get(timeout=min(left, LOOK)) if left > 0.0 else one.came.get_nowait()
            except queue.Empty:
                if left <= 0.0:
                    return
                if self.context.orphaned():
                    raise RunFailed("the supervisor has gone") from None
                continue
            one.told.heard += 1
            yield payload

    def _say(self, one: Follower, what: str, text: str, frame: int) -> None:
        """Say each thing once, silence each time anew."""
        if what not in one.said:
            one.said.add(what)
            self.context.event("warning", f"the body {one.body} {text}", frame)

    def summary(self) -> dict[str, dict[str, Any]]:
        """What came for each body."""
        return {one.body: vars(one.told) for one in self.each}


def read_poses(payload: bytes, joints: tuple[str, ...]) -> tuple[Float, Float]:
    """Rotation (j, 4) and translation (j, 3) [m] of what was sent for these joints. Raises BadInput."""
    try:
        sent = BodyPoses.model_validate_json(payload)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        problem, remedy = "no poses, which are JSON", 'for example {"position": [0, 1, 0], "rotation": [1, 0, 0, 0]}'
        value = payload[:60].decode(errors="replace")
        raise BadInput(problem, field=place or None, value=value, limit=str(first["msg"]), remedy=remedy) from None
    rotation, translation = np.array(sent.rotations, np.float64), np.array(sent.positions, np.float64)
    if not len(rotation) == len(translation) == len(joints):
        value = f"{len(translation)} positions and {len(rotation)} rotations"
        raise BadInput("another skeleton", value=value, limit=f"{len(joints)} joints: {', '.join(joints[:8])}")
    for name, values in (("positions", translation), ("rotations", rotation)):
        if (bad := np.flatnonzero(~np.isfinite(values).all(axis=1))).size:
            raise BadInput("not finite", field=f"{name}[{bad[0]}]", value=values[bad[0]].tolist())
    length = np.sqrt((rotation**2).sum(axis=1))
    if (bad := np.flatnonzero(~((length > 0.0) & np.isfinite(length)))).size:
        raise BadInput("a rotation of no length", field=f"rotations[{bad[0]}]", value=rotation[bad[0]].tolist())
    return rotation / length[:, None], translation
