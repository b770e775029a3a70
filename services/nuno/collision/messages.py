"""Bodies on the bus: geometry once, poses a frame, and poses that come from outside during the run.

Each frame has one pose of each body, and the run goes on with any input: unreadable poses are refused with a warning,
bodies follow jumps at their greatest speed, and without input they stay in place, or the run ends.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import zenoh
from numpy.typing import NDArray
from pydantic import ValidationError

from nuno.bus.encodings import BadMessage, arrays_of, decode_arrays, encode_arrays
from nuno.bus.messages import WAITING_AFTER
from nuno.plugin_contract.values import ContractError, check_layout, check_skins
from nuno.runtime.service import Context
from nuno_schemas.bodies import SKIN, STILL, Geometry, Poses, Skin, all_rotations
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Float
from nuno_schemas.live import BodyPoses, Live
from nuno_schemas.messages import POSES

MOST = 10_000
"""Most queued poses of a body whose frames wait for theirs; a body that follows the clock keeps only the newest."""
BYTES = 1024
"""Most bytes of a message, besides as many for each joint: a larger one is no pose, and would take long to read."""
FARTHEST, SHORTEST = 1e6, 1e-100
"""Largest distance of a joint from the origin [m], and least length of a quaternion with a direction."""
LONGEST = 500
"""Most characters of a refused message's error in a warning."""


@dataclass
class Tally:
    """Counts of a live body's poses, for the report.

    heard poses in all, of them used by a frame, refused, and left_out since newer ones came before the frame; frames
    without any, frames after which the body was behind its goal, and the longest silence [s]; mixed is how often an
    earlier sender went on after another one: two programs move the body.
    """

    heard: int = 0
    used: int = 0
    refused: int = 0
    left_out: int = 0
    without: int = 0
    behind: int = 0
    mixed: int = 0
    silence: float = 0.0


class Follower:
    """One live body, its queued poses, and its goal."""

    def __init__(self, body: str, joints: tuple[str, ...], live: Live, wake: Callable[[], None]) -> None:
        """`wake` is called when poses arrive that a frame may wait for."""
        self.body, self.joints, self.live, self.wake = body, joints, live, wake
        self.goal = live.pose(0.0)
        self.tally, self.warned = Tally(), set[str]()
        self.since = 0.0
        """Time of the scene since the last poses [s]."""
        self.heard = False
        """Whether the body has its poses of the present frame."""
        self.frame = 0
        """Last frame that has taken poses."""
        self._received: dict[str, int] = {}
        """Number of the latest poses of each session."""
        self._queue: deque[bytes] = deque()
        self._lock = threading.Lock()
        self._too_large = 0
        self._senders: list[str] = []
        """Sessions that have sent poses, the latest last; "" for those without a name."""

    def receive(self, sample: zenoh.Sample) -> None:
        """Queue a message, in a thread of zenoh."""
        sender = str(sample.source_info.source_id.zid) if sample.source_info else ""
        with self._lock:
            self.tally.heard += 1
            if sample.source_info:
                self._received[sender] = sample.source_info.source_sn
            if sender not in self._senders[-1:]:
                self.tally.mixed += sender in self._senders
                self._senders = [*(other for other in self._senders if other != sender), sender]
            if len(sample.payload) > BYTES * (1 + len(self.joints)):
                self._too_large += 1
            elif not self.live.waits and self._queue:
                self._queue[0] = sample.payload.to_bytes()
                self.tally.left_out += 1
            elif len(self._queue) < MOST:
                self._queue.append(sample.payload.to_bytes())
            else:
                self.tally.left_out += 1
        if self.live.waits:
            self.wake()

    def take(self) -> bytes | None:
        """Return the next queued message, or the newest; None if there is none."""
        with self._lock:
            return self._queue.popleft() if self._queue else None

    def taken(self) -> dict[str, int]:
        """Return the number of the latest poses of each session; nothing while poses are queued."""
        with self._lock:
            return {} if self._queue else dict(self._received)

    def too_large(self) -> int:
        """Return the number of messages that were too large since the last call."""
        with self._lock:
            number, self._too_large = self._too_large, 0
        return number


class Followers:
    """All live bodies of a run."""

    def __init__(
        self, context: Context, bodies: Iterator[tuple[str, tuple[str, ...], Live]], wake: Callable[[], None]
    ) -> None:
        """`bodies` by name, with the joints of each; `wake` is called when poses arrive that a frame may wait for.
        Raises BadInput for a key that zenoh does not take.
        """
        self.context, self.rate = context, context.loaded.scene.frame_rate
        self.each = [Follower(*follower, wake) for follower in bodies]
        self._began: float | None = None
        """Time of the query for the present frame [s]."""
        bus = context.bus
        for follower in self.each:
            try:
                bus.offers.append(bus.session.declare_subscriber(self._key(follower), follower.receive))
            except zenoh.ZError as error:
                raise BadInput(f"the bus has no such key: {error}", field="key", value=self._key(follower)) from None
        self._unknown_names: set[str] = set()
        if self.each:
            bus.offers.append(bus.session.declare_subscriber(bus.key(f"{POSES.name}/*"), self._warn_of_unknown))

    def _warn_of_unknown(self, sample: zenoh.Sample) -> None:
        """Warn once of each name that poses arrive for and that is not a live body."""
        key = str(sample.key_expr)
        name = key.rsplit("/", 1)[-1]
        if name not in self._unknown_names and all(key != self._key(follower) for follower in self.each):
            self._unknown_names.add(name)
            followed = ", ".join(f"{follower.body} by {self._key(follower)}" for follower in self.each)
            self.context.event("warning", f"poses come for {name!r:.60}, and no body follows them: {followed}")

    def _key(self, follower: Follower) -> str:
        return follower.live.key or self.context.bus.key(f"{POSES.name}/{follower.body}")

    def describe(self) -> dict[str, dict[str, Any]]:
        """Return of each body the joints and the key of its poses, whether frames wait for them, the last frame that
        took any, and the number of each sender's latest poses once none is queued.
        """
        return {
            follower.body: {
                "joints": follower.joints, "key": self._key(follower), "waits": follower.live.waits,
                "frame": follower.frame, "taken": follower.taken(),
            }
            for follower in self.each
        }  # fmt: skip

    def take_up(self, poses: Poses, frames: tuple[str, ...]) -> None:
        """Move all bodies to their poses in a recording; `frames` are the names of its body frames."""
        for body in self.each:
            rows = [frames.index(f"{body.body}/{joint}") for joint in body.joints]
            body.goal = body.live.rotation, body.live.translation = (poses.rotation[rows], poses.translation[rows])

    def wait(self, frame: int) -> float:
        """Return the longest further wait for a frame's poses [s]: 0 if they have arrived, or no body waits."""
        now = time.monotonic()
        self._began = now if self._began is None else self._began
        left = 0.0
        for follower in self.each:
            follower.heard = follower.heard or (follower.live.waits and self._next(follower, frame))
            if follower.live.waits and not follower.heard:
                left = max(left, self._began + follower.live.silence - now)
                if now - self._began > WAITING_AFTER:
                    text = (
                        f"is waited for: there are no poses of frame {frame} by {self._key(follower)} yet "
                        f"(for {follower.live.silence:g} s at most); has the program that sends them ended?"
                    )
                    self._say(follower, "wait", text, frame - 1)
        return left

    def go_on(self, frame: int, dt: float) -> None:
        """Move all bodies to the end of a frame of dt [s]. Raises RunFailed where silence ends the run."""
        for follower in self.each:
            self._hear(follower, frame, dt)
            left = follower.live.follow(*follower.goal, dt)
            if left > 0.0:
                follower.tally.behind += 1
                limit = f"{follower.live.fastest:g} m/s and {follower.live.fastest_turn:g} rad/s at most"
                text = f"has a goal farther on than it gets in a frame, by {left:.0%} of the way"
                self._say(follower, "jump", f"{text}: it follows at {limit}", frame)
        self._began = None

    def _hear(self, follower: Follower, frame: int, dt: float) -> None:
        """Take the poses of a body for a frame: the next queued ones, or the newest."""
        heard, follower.heard = follower.heard or self._next(follower, frame), False
        if follower.tally.mixed:
            text = f"is moved by several programs at once, which all send to {self._key(follower)}: end all but one"
            self._say(follower, "senders", text, frame)
        if follower.tally.left_out and follower.live.waits:
            self._say(follower, "full", f"was sent more than {MOST:,} poses ahead: those beyond are left out", frame)
        follower.since = 0.0 if heard else follower.since + dt
        # The silence of a waiting frame is its wait; by the clock, pauses and compilation do not count.
        silent = time.monotonic() - (self._began or 0.0) if follower.live.waits else follower.since
        follower.tally.silence = max(follower.tally.silence, silent)
        if heard:
            follower.warned -= {"silence", "wait"}
            return
        follower.tally.without += 1
        if silent >= follower.live.silence:
            problem = f"has heard nothing for {silent:.2g} s"
            # By the clock, the sender has not begun yet if nothing has ever arrived.
            if follower.live.stops and (follower.live.waits or follower.tally.used):
                raise RunFailed(f"the body {follower.body} {problem}, and its motion says silent: stop")
            each = f", and each frame waits {follower.live.silence:g} s for it" if follower.live.waits else ""
            self._say(follower, "silence", f"{problem} by {self._key(follower)}: it stays where it is{each}", frame)

    def _next(self, body: Follower, frame: int) -> bool:
        """Make the next valid poses the goal; return whether there were any."""
        while True:
            payload = body.take()
            if number := body.too_large():
                body.tally.refused += number
                self._say(body, "size", f"was sent what is too large for poses of {len(body.joints)} joints", frame)
            if payload is None:
                return False
            try:
                body.goal = read_poses(payload, body.joints)
            except BadInput as error:
                body.tally.refused += 1
                self._say(body, error.problem, f"was sent what cannot be followed: {error}"[:LONGEST], frame)
                continue
            body.tally.used += 1
            body.frame = frame
            return True

    def _say(self, follower: Follower, kind: str, text: str, frame: int) -> None:
        """Log a warning of each kind once, of silence each time."""
        if kind not in follower.warned:
            follower.warned.add(kind)
            self.context.event("warning", f"the body {follower.body} {text}", frame, frame / self.rate)

    def summary(self) -> dict[str, dict[str, Any]]:
        """Return the counts of each body."""
        return {follower.body: vars(follower.tally) for follower in self.each}


def read_poses(payload: bytes, joints: tuple[str, ...]) -> tuple[Float, Float]:
    """Read rotations (j, 4) and translations (j, 3) [m] of these joints from a message. Raises BadInput."""
    try:
        sent = BodyPoses.model_validate_json(payload)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place, message = ".".join(map(str, first["loc"])), str(first["msg"]).removeprefix("Value error, ")
        kind = "no poses, which are JSON" if first["type"] == "json_invalid" else "no poses"
        problem = ": ".join(filter(None, (kind, place, message)))
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


# Bodies on the bus: geometry once, poses per frame.

DRAWN_QUERY = "collision/ask/drawn"
POSES_QUERY = "collision/ask/poses"
LIVE_BODIES_QUERY = "collision/ask/told"
"""Names of the queries; the reply about live bodies is JSON, `Followers.describe` by body."""


def encode_geometry(geometry: Geometry) -> bytes:
    """Encode a geometry for drawing, without distance fields."""
    arrays, text = arrays_of(geometry), {"bodies": geometry.bodies, "frames": geometry.frames}
    for number, skin in enumerate(geometry.skins):
        arrays |= arrays_of(skin, f"skin{number}.")
    return encode_arrays(arrays, text)


def decode_geometry(payload: bytes) -> Geometry:
    """Decode a geometry. Raises BadMessage."""
    arrays, text = decode_arrays(payload)
    try:
        plain: dict[str, Any] = {name: values for name, values in arrays.items() if "." not in name}
        skins = tuple(Skin(**_part(arrays, f"skin{i}.")) for i in range(int((plain["kind"] == SKIN).sum())))
        geometry = Geometry(tuple(text["bodies"]), tuple(text["frames"]), **plain, skins=skins)
        check_layout("", geometry)  # kernels do not check shapes and indices
        check_skins(geometry)
        return geometry
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        raise BadMessage(f"geometry without {error}") from None
    except ContractError as error:
        raise BadMessage(f"geometry of which {error}") from None


def _part(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, Any]:
    """Return the arrays whose names have a prefix, without it."""
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}


def encode_poses(poses: Poses, frame: int) -> bytes:
    """Encode poses; frames at the end that do not turn, as the vertices of an animated surface, without rotation."""
    turned = int(np.flatnonzero((poses.rotation != STILL).any(axis=1)).max(initial=-1)) + 1
    arrays = {"rotation": poses.rotation[:turned], "translation": poses.translation}
    return encode_arrays(arrays, {"t": poses.t, "frame": frame})


def decode_poses(payload: bytes, frames: int | None = None) -> Poses:
    """Decode poses. Raises BadMessage, also for another number of `frames` if that is given."""
    arrays, text = decode_arrays(payload)
    try:
        rotation = all_rotations(arrays["rotation"], len(arrays["translation"]))
        poses = Poses(float(text["t"]), rotation, arrays["translation"])
        check_layout("", poses, None if frames is None else {"f": frames})
        return poses
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadMessage(f"poses without {error}") from None
    except ContractError as error:
        raise BadMessage(f"poses of which {error}") from None
