"""Bodies that are told where to be while a run goes on: what comes for them, and what of it they follow.

Whatever comes, each frame has one pose of each body, and a run goes on: what cannot be read is refused and told, what
jumps is gone to at the greatest speed, and where nothing comes bodies stay where they are, or the run ends.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import zenoh
from pydantic import ValidationError

from nuno.bus.pending_reply import WAITING_AFTER
from nuno.service import Context
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Float
from nuno_schemas.live import BodyPoses, Live
from nuno_schemas.messages import POSES

MOST = 10_000
"""Poses that may lie there for frames that wait for theirs; by the clock the newest alone is kept."""
BYTES = 1024
"""Of poses, besides as many for each joint: more is no pose, and would take long to read."""
FARTHEST, SHORTEST = 1e6, 1e-100
"""From the origin that a joint can be [m], and the least length of a quaternion that has a direction."""
LONGEST = 500
"""Characters of a refused message's error that are told."""


@dataclass
class Tally:
    """What came for a body, for the report.

    heard poses in all, of them used by a frame, refused, and left_out since others came before the frame; frames
    without any, frames after which the body was behind where it was told to be, and the longest silence [s].
    """

    heard: int = 0
    used: int = 0
    refused: int = 0
    left_out: int = 0
    without: int = 0
    behind: int = 0
    silence: float = 0.0


class Follower:
    """One body, what has come for it, and where it is told to be."""

    def __init__(self, body: str, joints: tuple[str, ...], live: Live, wake: Callable[[], None]) -> None:
        """`wake` is called where poses have come that a frame may wait for."""
        self.body, self.joints, self.live, self.wake = body, joints, live, wake
        self.goal = live.pose(0.0)
        self.tally, self.said = Tally(), set[str]()
        self.since = 0.0
        """Of the scene's time, since poses came last [s]."""
        self.heard = False
        """Whether it has its poses of the frame under way."""
        self._came: deque[bytes] = deque()
        self._lock = threading.Lock()
        self._too_large = 0

    def receive(self, sample: zenoh.Sample) -> None:
        """Keep what came, in a thread of zenoh's."""
        with self._lock:
            self.tally.heard += 1
            if len(sample.payload) > BYTES * (1 + len(self.joints)):
                self._too_large += 1
            elif not self.live.waits and self._came:
                self._came[0] = sample.payload.to_bytes()
                self.tally.left_out += 1
            elif len(self._came) < MOST:
                self._came.append(sample.payload.to_bytes())
            else:
                self.tally.left_out += 1
        if self.live.waits:
            self.wake()

    def take(self) -> bytes | None:
        """The next of what has come, or the newest; None where nothing has."""
        with self._lock:
            return self._came.popleft() if self._came else None

    def too_large(self) -> int:
        """How many came that were no poses for their size, since this was last asked."""
        with self._lock:
            number, self._too_large = self._too_large, 0
        return number


class Followers:
    """All such bodies of a run."""

    def __init__(
        self, context: Context, bodies: Iterator[tuple[str, tuple[str, ...], Live]], wake: Callable[[], None]
    ) -> None:
        """`bodies` by name, with the joints of each; `wake` is called where poses come that a frame may wait for.
        Raises BadInput for a key that zenoh does not take.
        """
        self.context, self.rate = context, context.loaded.scene.frame_rate
        self.each = [Follower(*one, wake) for one in bodies]
        self._began: float | None = None
        """When the frame under way was asked for [s]."""
        bus = context.bus
        for one in self.each:
            try:
                bus.offers.append(bus.session.declare_subscriber(self._key(one), one.receive))
            except zenoh.ZError as error:
                raise BadInput(f"the bus has no such key: {error}", field="key", value=self._key(one)) from None
        self._strange: set[str] = set()
        if self.each:
            bus.offers.append(bus.session.declare_subscriber(bus.key(f"{POSES.name}/*"), self._doubt))

    def _doubt(self, sample: zenoh.Sample) -> None:
        """Say once of each name that poses come for that it is of no body which is told where to be."""
        key = str(sample.key_expr)
        name = key.rsplit("/", 1)[-1]
        if name not in self._strange and all(key != self._key(one) for one in self.each):
            self._strange.add(name)
            own = ", ".join(f"{one.body} by {self._key(one)}" for one in self.each)
            self.context.event("warning", f"poses come for {name!r:.60}, and no body follows them: {own}")

    def _key(self, one: Follower) -> str:
        return one.live.key or self.context.bus.key(f"{POSES.name}/{one.body}")

    def told(self) -> dict[str, dict[str, Any]]:
        """Of each body its joints, and the key by which its poses come."""
        return {one.body: {"joints": one.joints, "key": self._key(one)} for one in self.each}

    def take_up(self, poses: Poses, frames: tuple[str, ...]) -> None:
        """Have all bodies where they were in a frame of a recording; `frames` are the names of its frames."""
        for one in self.each:
            rows = [frames.index(f"{one.body}/{joint}") for joint in one.joints]
            one.goal = one.live.rotation, one.live.translation = poses.rotation[rows], poses.translation[rows]

    def wait(self, frame: int) -> float:
        """How much longer [s] the next poses of a frame are to be waited for: 0 where they are there, or none waits."""
        now = time.monotonic()
        self._began = now if self._began is None else self._began
        left = 0.0
        for one in self.each:
            one.heard = one.heard or (one.live.waits and self._next(one, frame))
            if one.live.waits and not one.heard:
                left = max(left, self._began + one.live.silence - now)
                if now - self._began > WAITING_AFTER:
                    text = (
                        f"is waited for: there are no poses of frame {frame} by {self._key(one)} yet "
                        f"(for {one.live.silence:g} s at most); has the program that sends them ended?"
                    )
                    self._say(one, "wait", text, frame - 1)
        return left

    def go_on(self, frame: int, dt: float) -> None:
        """Bring all bodies to where they are at the end of a frame of dt [s]. Raises RunFailed where silence ends the
        run.
        """
        for one in self.each:
            self._hear(one, frame, dt)
            left = one.live.follow(*one.goal, dt)
            if left > 0.0:
                one.tally.behind += 1
                limit = f"{one.live.fastest:g} m/s and {one.live.fastest_turn:g} rad/s at most"
                text = f"is told to be farther on than it gets in a frame, by {left:.0%} of the way"
                self._say(one, "jump", f"{text}: it follows at {limit}", frame)
        self._began = None

    def _hear(self, one: Follower, frame: int, dt: float) -> None:
        """Take in what has come for a body: the next of it, or the newest."""
        heard, one.heard = one.heard or self._next(one, frame), False
        if one.tally.left_out and one.live.waits:
            self._say(one, "full", f"was sent more than {MOST:,} poses ahead: those beyond are left out", frame)
        one.since = 0.0 if heard else one.since + dt
        # A frame that waits is silent for as long as it does; by the clock pauses and compiling are not counted.
        silent = time.monotonic() - (self._began or 0.0) if one.live.waits else one.since
        one.tally.silence = max(one.tally.silence, silent)
        if heard:
            one.said -= {"silence", "wait"}
            return
        one.tally.without += 1
        if silent >= one.live.silence:
            problem = f"has heard nothing for {silent:.2g} s"
            # By the clock nobody has begun yet where nothing has ever come.
            if one.live.stops and (one.live.waits or one.tally.used):
                raise RunFailed(f"the body {one.body} {problem}, and its motion says silent: stop")
            each = f", and each frame waits {one.live.silence:g} s for it" if one.live.waits else ""
            self._say(one, "silence", f"{problem} by {self._key(one)}: it stays where it is{each}", frame)

    def _next(self, one: Follower, frame: int) -> bool:
        """Have the next poses that can be followed as the goal; whether there were any."""
        while True:
            payload = one.take()
            if number := one.too_large():
                one.tally.refused += number
                self._say(one, "size", f"was sent what is too large for poses of {len(one.joints)} joints", frame)
            if payload is None:
                return False
            try:
                one.goal = read_poses(payload, one.joints)
            except BadInput as error:
                one.tally.refused += 1
                self._say(one, error.problem, f"was sent what cannot be followed: {error}"[:LONGEST], frame)
                continue
            one.tally.used += 1
            return True

    def _say(self, one: Follower, what: str, text: str, frame: int) -> None:
        """Say each thing once, silence each time anew."""
        if what not in one.said:
            one.said.add(what)
            self.context.event("warning", f"the body {one.body} {text}", frame, frame / self.rate)

    def summary(self) -> dict[str, dict[str, Any]]:
        """What came for each body."""
        return {one.body: vars(one.tally) for one in self.each}


def read_poses(payload: bytes, joints: tuple[str, ...]) -> tuple[Float, Float]:
    """Rotation (j, 4) and translation (j, 3) [m] of what was sent for these joints. Raises BadInput."""
    try:
        sent = BodyPoses.model_validate_json(payload)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place, said = ".".join(map(str, first["loc"])), str(first["msg"])
        problem = f"no poses: {place}: {said}" if place else f"no poses, which are JSON: {said}"
        remedy, value = (
            'for example {"position": [0, 1, 0], "rotation": [1, 0, 0, 0]}',
            payload[:60].decode(errors="replace"),
        )
        raise BadInput(problem, value=value, remedy=remedy) from None
    rotation, translation = np.array(sent.rotations, np.float64), np.array(sent.positions, np.float64)
    if not len(rotation) == len(translation) == len(joints):
        value = f"{len(translation)} positions and {len(rotation)} rotations"
        raise BadInput("another skeleton", value=value, limit=f"{len(joints)} joints: {', '.join(joints[:8])}")
    for name, values in (("positions", translation), ("rotations", rotation)):
        if (bad := np.flatnonzero(~np.isfinite(values).all(axis=1))).size:
            raise BadInput("not finite", field=f"{name}[{bad[0]}]", value=values[bad[0]].tolist())
    if (bad := np.flatnonzero((np.abs(translation) > FARTHEST).any(axis=1))).size:
        value, limit = translation[bad[0]].tolist(), f"{FARTHEST:g} m from the origin"
        raise BadInput("out of this world", field=f"positions[{bad[0]}]", value=value, limit=limit)
    largest = np.abs(rotation).max(axis=1, keepdims=True)
    if (bad := np.flatnonzero(largest[:, 0] < SHORTEST)).size:
        raise BadInput("a rotation of no length", field=f"rotations[{bad[0]}]", value=rotation[bad[0]].tolist())
    rotation = rotation / largest
    return rotation / np.sqrt((rotation**2).sum(axis=1, keepdims=True)), translation
