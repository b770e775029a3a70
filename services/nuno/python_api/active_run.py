"""Runs that go on: their messages from the bus, and bodies that a program moves."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import zenoh
from numpy.typing import ArrayLike, NDArray

from nuno.bus.encodings import decode_arrays, decode_picture, decode_points
from nuno.bus.health import Watch
from nuno.bus.messages import ALL, Bus, Inbox, Message, pauses
from nuno.bus.sessions import spoke
from nuno.collision.messages import LIVE_BODIES_QUERY, read_poses
from nuno.python_api.scene import in_python
from nuno.runtime import runs
from nuno.runtime.driver import CONTROL
from nuno.runtime.service import SUPERVISOR
from nuno.runtime.supervisor import CONTROL_TIMEOUT
from nuno_schemas.errors import BadInput, RunFailed, nearest
from nuno_schemas.live import BodyPoses
from nuno_schemas.messages import MODELS, PICTURE, REPORT, STATE, TOPICS

TOKENS_SECONDS = 2.0
"""Longest wait for the liveliness tokens of the present services [s]."""
LISTENING = 0.2
"""Interval of the checks for the run's end while no message arrives [s]."""


@dataclass(frozen=True)
class Heard:
    """A message of a run.

    topic, frame and t [s] are from its header; skipped is the number of lost messages of this topic directly before it.
    value is its content: for `sim/state` positions (n, 3) [m], with float32's precision; for arrays a pair, arrays by
    name and a mapping of other fields; for a picture the bytes of a PNG; for others an object of nuno_schemas.messages:
    Status, DyeStatus, Penetration, Event or Ack.
    """

    topic: str
    frame: int
    t: float
    value: Any
    skipped: int


class Watching(AbstractContextManager["Watching"]):
    """An iterator of a run's messages, as `Heard`, from its construction to the run's end; it can be closed."""

    def __init__(self, run: str, endpoint: str, topics: tuple[str, ...], config: str | None, announced: bool) -> None:
        """announced: whether the run is on this machine, where its services may still be starting."""
        self._topics, self._stack, self._closed = topics, contextlib.ExitStack(), False
        with in_python():
            bus = Bus(self._stack.enter_context(spoke(endpoint, config)), run, "watch")
        self._stack.callback(bus.close)
        self._inbox = Inbox(bus, [ALL], newest_only=True)
        # After this reply, the hub knows the subscriber; a `Watch` in the session would reply itself, too early.
        present = bus.present()
        self._life = Watch(bus)
        self._life.wait_for(present, TOKENS_SECONDS)
        if not present and not announced:
            self.close()
            remedy = "check the run's id, as printed where it was started"
            raise BadInput("no such run is going on there", field="run", value=run, limit=endpoint, remedy=remedy)
        self._local_run = run if announced else ""

    def __iter__(self) -> Watching:
        return self

    def __next__(self) -> Heard:
        while not self._closed:
            item = self._inbox.get(LISTENING)
            if not isinstance(item, Message):
                if self._life.gone(SUPERVISOR) or not (self._life.alive() or self._local_run in runs.running()):
                    self.close()
            elif not self._topics or any(_below(item.topic, one) for one in self._topics):
                try:
                    value = _decoder(item.topic)(item.payload)
                except ValueError:  # BadMessage is one
                    self._inbox.refuse(item)
                    continue
                return Heard(item.topic, item.header.frame, item.header.t, value, item.skipped)
        raise StopIteration

    def close(self) -> None:
        """End the subscription."""
        self._closed = True
        self._stack.close()

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()


def watch(run: str = "last", *topics: str, connect: str | None = None, config: str | None = None) -> Watching:
    """Iterate over a run's messages, decoded, until it ends: for heard in nuno.watch("last", "sim/state"). To leave
    earlier, close it: with nuno.watch("last") as heard.

    run: its id or the beginning of that; topics: only these, or those below them, as "run/event" (default: all);
    earlier messages are not repeated. connect and config: endpoint and zenoh configuration, for a run on another host.
    A subscriber never delays a run, and has gaps if it does not keep up. Raises BadInput for a run that does not go on
    and an unknown topic; RunFailed where the run cannot be reached.
    """
    with in_python():
        published = [name for name in TOPICS if name != REPORT.name]
        for topic in topics:
            if not isinstance(topic, str) or not any(_below(topic, name) for name in published):
                raise BadInput("no such topic", field="topics", value=topic, remedy=nearest(str(topic), published))
        if connect and run == runs.LAST:
            problem, remedy = "which run of another host is meant is not said", "give its id, as printed there"
            raise BadInput(problem, field="run", value=run, remedy=remedy)
        name, endpoint = (run, connect) if connect else runs.find(run)
    return Watching(name, endpoint, topics, config, announced=not connect)


def _below(topic: str, name: str) -> bool:
    return topic == name or topic.startswith(f"{name}/")


def _decoder(topic: str) -> Callable[[bytes], Any]:
    schema = next((listed.schema for name, listed in TOPICS.items() if _below(topic, name)), "")
    if schema in MODELS:
        return MODELS[schema].model_validate_json
    return {STATE.schema: decode_points, PICTURE.schema: decode_picture}.get(schema, decode_arrays)


# A live body: its poses come from a tracker, a robot's program, or a script, while the run goes on.

STILL = (1.0, 0.0, 0.0, 0.0)
LOOK = 0.1
"""Interval of the checks for an awaited run [s]."""
T = TypeVar("T")


class Driving(AbstractContextManager["Driving"]):
    """Moves one body, and attaches cloth to it; it can be closed, and used with `with`."""

    def __init__(self, run: str, body: str, endpoint: str, connect: bool, config: str | None, end: float) -> None:
        """connect: whether the run is on another host, without an entry here; end: monotonic time of the wait's end."""
        with contextlib.ExitStack() as stack, in_python():
            session = stack.enter_context(spoke(endpoint, config, max(0.0, end - time.monotonic()) if connect else 0.0))
            self._bus = Bus(session, run, "drive")

            def ready() -> None:
                if not connect:
                    runs.find(run)  # raises for a run that has ended
                self._bus.ask_json(CONTROL, {"action": "status"}, CONTROL_TIMEOUT)

            try:
                _retry_until(end, ready, RunFailed)
            except RunFailed as error:
                problem = f"{error}; to move a body takes an operator's certificate"
                raise RunFailed(problem if config else str(error), error.peer) from None
            live = _live_body(self._bus, body)
            self._body, self._joints, self._waits = body, tuple(live["joints"]), bool(live["waits"])
            self._publisher = session.declare_publisher(
                str(live["key"]),
                congestion_control=zenoh.CongestionControl.BLOCK,
                reliability=zenoh.Reliability.RELIABLE,
            )
            self._sent, self._stack, self._closed = 0, stack.pop_all(), False

    def send(self, position: ArrayLike, rotation: ArrayLike = STILL) -> None:
        """Send the body's next pose: position (3,) [m] and rotation (4,), a quaternion w, x, y, z, of any length except
        zero; for a skeleton (j, 3) and (j, 4), of all joints. Raises BadInput for poses of another shape, or not
        finite, and if this is closed.
        """
        self._require_open()
        positions, rotations = _rows("position", position, 3), _rows("rotation", rotation, 4)
        if len(positions) != len(rotations):
            value = f"{len(positions)} positions and {len(rotations)} rotations"
            raise BadInput("of another shape", field="rotation", value=value, limit="one of each joint")
        sent = BodyPoses.model_validate({"positions": positions.tolist(), "rotations": rotations.tolist()})
        payload = sent.model_dump_json().encode()
        read_poses(payload, self._joints)
        self._sent += 1
        self._publisher.put(payload, source_info=zenoh.SourceInfo(self._publisher.id, self._sent))

    def add(self, item: str) -> dict[str, Any]:
        """Change the cloth before the next frame, as `nuno control RUN add`: "attach: {body: hand}",
        "release: {body: hand}"; return the facts of the change, and `frame`, the last frame before it. Where frames
        wait for poses, that is the frame of the last sent pose, which this waits for, also in a paused run. Raises
        BadInput if the run refuses it, RunFailed if it does not answer.
        """
        self._require_open()
        if self._waits and self._sent:
            self._wait_for_frame()
        answer = self._bus.ask_json(CONTROL, {"action": "add", "item": item}, CONTROL_TIMEOUT)
        if answer.get("ok") is not True:
            refused = answer.get("refused") or {"problem": str(answer.get("error"))}
            raise BadInput(**refused)
        return {**(answer.get("new") or {}), "frame": answer["frame"]}

    def _wait_for_frame(self) -> None:
        """Wait until the run has stepped the frames of all sent poses. Raises RunFailed if it ends before."""
        sender, taken, frame = str(self._publisher.id.zid), False, -1
        for pause in pauses():
            if not taken:
                live = self._bus.ask_json(LIVE_BODIES_QUERY, {}, CONTROL_TIMEOUT)["told"][self._body]
                taken = live["taken"].get(sender, 0) >= self._sent
            elif frame < live["frame"]:
                frame = self._bus.ask_json(CONTROL, {"action": "status"}, CONTROL_TIMEOUT)["frame"]
            else:
                return
            time.sleep(pause)

    def _require_open(self) -> None:
        if self._closed:
            raise BadInput("this is closed", remedy="drive the body anew: with nuno.drive(...) as body")

    def close(self) -> None:
        """End the session; no pose can be sent afterwards."""
        self._closed = True
        self._stack.close()

    def __exit__(self, *exception: object) -> None:
        self.close()


def drive(run: str, body: str, *, wait: float = 0.0, connect: str | None = None, config: str | None = None) -> Driving:
    """Move a body of a run whose motion is `{plugin: topic}`: with nuno.drive("last", "hand") as hand: hand.send(...).

    run: its id, the beginning of that, or "last" of this folder; body: its name in the scene; wait: longest wait until
    the run exists, and is ready for its first frame [s]; connect and config: endpoint and zenoh configuration, for a
    run on another host, whose full id is then needed. Raises BadInput for a run that does not go on, and a body that
    does not exist or has another motion, RunFailed where the run cannot be reached.
    """
    end = time.monotonic() + wait
    with in_python():
        name, endpoint = (run, connect) if connect else _retry_until(end, lambda: runs.find(run, here=True), BadInput)
    return Driving(name, body, endpoint, connect is not None, config, end)


def _live_body(bus: Bus, body: str) -> dict[str, Any]:
    """Return what `Followers.describe` says of a body with a live motion. Raises BadInput for any other."""
    if "collision" not in bus.present():
        raise BadInput("the run has no bodies", field="body", value=body, remedy="give its scene the body")
    reply = bus.ask_json(LIVE_BODIES_QUERY, {}, CONTROL_TIMEOUT)
    bodies, live = reply["bodies"], reply["told"]
    if body not in bodies:
        raise BadInput("the run has no such body", field="body", value=body, remedy=nearest(body, bodies))
    if body not in live:
        problem, hint = (f"{body} has no motion: {{plugin: topic}}", f"or take {' or '.join(live)}" if live else "")
        raise BadInput(problem, field="body", value=body, remedy=f"give it one in the scene{', ' * bool(live)}{hint}")
    return dict(live[body])


def _rows(name: str, numbers: ArrayLike, width: int) -> NDArray[np.float64]:
    """Return numbers (j, width) of all joints. Raises BadInput for anything else."""
    limit = f"{width} numbers, or as many of each joint"
    try:
        values = np.atleast_2d(np.asarray(numbers, np.float64))
    except (TypeError, ValueError):
        raise BadInput("no numbers", field=name, value=numbers, limit=limit) from None
    if values.shape[1:] != (width,):
        raise BadInput("of another shape", field=name, value=f"shape {values.shape}", limit=limit)
    if not np.isfinite(values).all():
        raise BadInput("not finite", field=name, value=values.tolist())
    return values


def _retry_until(end: float, ask: Callable[[], T], refusal: type[Exception]) -> T:
    """Repeat `ask` until it succeeds; raise its `refusal` after the end of the time."""
    while True:
        try:
            return ask()
        except refusal:
            if time.monotonic() >= end:
                raise
        time.sleep(LOOK)
