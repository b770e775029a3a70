"""The driver of a stepping service, cloth or dye: frames in lockstep with their subscribers, under control.

Where two services step, one leads: it takes control requests, and sets the pace. The other follows: it steps each frame
that the leader has finished, and acknowledges it like any lockstep subscriber, so that both pause together.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from statistics import median
from typing import Any, Protocol

import numpy as np
from pydantic import ValidationError

from nuno.bus.encodings import encode_arrays
from nuno.bus.messages import WAITING_AFTER, Inbox, Message, Query, Refused, pauses
from nuno.bus.sessions import PATIENCE
from nuno.plugin_contract import containment
from nuno.recording.reader import describe_changes
from nuno.recording.recorded import Arrays
from nuno.runtime.service import LOOK_SECONDS, Context, ack_topic, asks_to_finish
from nuno.runtime.stepper import FASTER, Stepped, Stepper
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import STATUSES, Ack, FrameStatus, Topic

# Frames paced to the clock: a simulated second a second of wall time.

LISTEN_EVERY = 0.5
"""Longest time between two checks of control requests while a frame waits [s]."""


class Clock:
    """Waits after each frame until it is due, counted from the first frame, without pauses.

    A frame is late if it ends after the next one is due. The frames after it do not wait until they have caught up.
    """

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._origin: float | None = None
        self.late, self.frames, self.most = 0, 0, 0.0

    def hold(self, began: float) -> None:
        """Wait until the frame that began at a wall time [s] is due; log a warning if the run falls behind."""
        driver, interval = self._driver, 1.0 / self._driver.scene.frame_rate
        if self._origin is None:  # the first is due an interval after it was begun
            self._origin = began - driver.paused_seconds - (driver.stepper.t - interval)
        self.frames += 1
        behind = -self._left()
        self.most = max(self.most, behind)
        if behind > interval:
            self.late += 1
            if self.late == 1:
                text = f"cannot keep up with the clock: frame {driver.stepper.frame} is {behind:.2g} s late"
                driver.context.event("warning", text, driver.stepper.frame, driver.stepper.t)
        while (left := self._left()) > 0.0 and driver.finish is None and driver.state == "running":
            driver.listen(min(left, LISTEN_EVERY))

    def _left(self) -> float:
        """Return the time until the present frame is due [s]."""
        assert self._origin is not None
        return self._origin + self._driver.stepper.t + self._driver.paused_seconds - time.perf_counter()

    def facts(self) -> dict[str, Any]:
        """Return the number of frames, the number of late ones, and the longest delay [s], for the report."""
        return {"frames": self.frames, "late": self.late, "most": max(0.0, self.most)}


# Watchdog of frames while they are stepped: it abandons a frame when the run is to end or to pause, or where the frame
# takes longer than the scene allows, and warns of one that takes long. The stepping thread is in compiled code
# meanwhile, and reads no messages.

LEAVE_AFTER = 0.3
"""Longest time that a frame, or the preparation, may go on once the run is to stop, or a frame once it is to pause [s].
"""
CHECK_INTERVAL = 0.1
"""Interval of the checks [s]."""
LONG, LEAST, KNOWN = 100.0, 5.0, 3
"""A frame takes too long beyond this multiple of the median of earlier frames, and this time [s]; the median needs at
least this many frames.
"""
LATEST = 50
"""Number of earlier frames in the median."""


class FrameWatchdog:
    """A thread that watches one service's steps, from its start to `close`."""

    def __init__(self, context: Context) -> None:
        self._context, self.leave = context, np.zeros(1, np.int64)
        """(1,) nonzero tells a solver to abandon its frame, as `nuno_schemas.system.System.leave`."""
        self._end_asked_at: float | None = None
        self._pause_asked_at: float | None = None
        self.limit = self._limit = math.inf
        """Longest time of a frame [s]."""
        self.exceeded: str | None = None
        """What delayed the present frame, in words, where it took longer; None where it has not."""
        self.returns: Callable[[], bool] = bool
        """Returns whether the present frame can be stepped again from its start."""
        self._began: float | None = time.monotonic()
        """Start of the present frame, at first of the preparation [s]; None between frames."""
        self._frame, self._warned, self._t = 0, True, 0.0
        self._durations: deque[float] = deque(maxlen=LATEST)
        self._lock, self._closed = threading.Lock(), threading.Event()
        self.holds: Callable[[], str] = str
        """Returns what delays the present frame, in words, as far as the solver knows."""
        threading.Thread(target=self._watch, name=f"{context.bus.service} watchdog", daemon=True).start()

    def note_query(self, query: Query) -> None:
        """Record a query that ends or pauses the run; any thread may call this."""
        action = "stop" if query.name.startswith("finish/") else query.json().get("action")
        if action == "stop":
            self._end_asked_at = self._end_asked_at or time.monotonic()
        elif action == "pause":
            self._pause_asked_at = time.monotonic()

    def paused(self) -> None:
        """Note that the query to pause has been heard: the next frame is stepped to its end."""
        self._pause_asked_at = None

    def prepared(self) -> None:
        """End the preparation: nothing is computed until the next frame."""
        with self._lock:
            self._began = None

    @contextmanager
    def frame(self, last: int, t: float) -> Iterator[None]:
        """Watch the frame after `last`, which ended at t [s], while it is stepped."""
        began = time.monotonic()
        self.exceeded, self.leave[0] = None, 0
        with self.measuring(self.limit):
            self._frame, self._t, self._warned = last, t, False
            yield
        self._durations.append(time.monotonic() - began)

    @contextmanager
    def measuring(self, limit: float = math.inf) -> Iterator[None]:
        """Have solvers leave what is computed meanwhile, after the limit [s] or where the run is to end."""
        with self._lock:
            self._began, self._limit, self._warned = time.monotonic(), limit, True
        try:
            yield
        finally:
            with self._lock:
                self._began = None

    def close(self) -> None:
        """End the thread."""
        self._closed.set()

    def _is_to_leave(self, now: float) -> bool:
        """Return whether what is computed has gone on for too long since the run was to end or to pause."""
        asked = [self._end_asked_at, self._pause_asked_at if self.returns() else None]
        return any(one is not None and now - max(one, self._began or 0.0) > LEAVE_AFTER for one in asked)

    def _watch(self) -> None:
        while not self._closed.wait(CHECK_INTERVAL):
            now = time.monotonic()
            if orphaned := self._context.orphaned():
                self._end_asked_at = self._end_asked_at or now
            with self._lock:
                elapsed = 0.0 if self._began is None else now - self._began
                if elapsed > self._limit and self.exceeded is None:
                    self.exceeded = self.holds()
                if self._began is not None and (self.exceeded is not None or self._is_to_leave(now)):
                    self.leave[0] = 1
                # Compiled code has had time to leave: a plugin that still goes on does so in Python.
                overdue = self._end_asked_at is not None and now - self._end_asked_at > 2.0 * LEAVE_AFTER
                if (
                    (overdue or elapsed > self._limit + 2.0 * LEAVE_AFTER)
                    and not containment.end_calls(self._context.bus.run, LEAVE_AFTER)
                    and (overdue and (orphaned or self.leave[0]))
                ):
                    return
                typical = median(self._durations) if len(self._durations) >= KNOWN else None
                if self._warned or typical is None or elapsed < max(LEAST, LONG * typical):
                    continue
                self._warned = True
            text = f"frame {self._frame + 1} has taken {elapsed:.3g} s so far, {elapsed / typical:.0f} times the usual"
            reason = self.holds()
            self._context.event("warning", text + (f": {reason}" if reason else ""), self._frame, self._t)


WINDOW = 4
"""Frames that the steps may run ahead of a service that must see every frame."""
SAID_AGAIN_AFTER = 60.0
"""Shortest interval between two warnings of a run that waits repeatedly, as for a slow disk [s]."""
CONTROL = "control"
OF_FOLLOWERS = ("status", "add")
STATES = {"start": "running", "resume": "running", "pause": "paused", "stop": "stopped"}
"""State of a run after an action."""
LEFT = "left"
"""Status of a frame that was abandoned, since the run is to end or to pause, or the frame took too long."""
OVER = ("stopped", "failed")
"""States that end a run between two frames."""
ACTIONS = ("status", "pause", "resume", "step", "stop", "set", "add")
FOLLOWER_TIMEOUT = 20.0
"""Timeout for the reply of a service that follows [s], which finishes its frame first: shorter than that of the
client's own query, and than that of the run's end."""


class Account(Protocol):
    """The account of cloth or dye while it is stepped: its own messages, fields of statuses, entries of the report."""

    warnings: list[str]
    """About the start and the run so far; those that are added become events."""
    every: int
    """Interval of frames whose arrays are published."""

    @property
    def version(self) -> int:
        """Number of changes so far of what `constant` describes."""
        ...

    def constant(self, frame: int) -> tuple[Topic, Arrays, dict[str, Any]]:
        """Return topic, arrays and text of the data that hold from a frame on, until a change."""
        ...

    def status_of(self, frame: Stepped) -> dict[str, Any]:
        """Return the fields of a frame's status that only this part has, and note them for the report."""
        ...

    def loads(self) -> Iterable[tuple[Topic, bytes]]:
        """Return the messages with the forces on bodies, which a scene may ask for in each frame."""
        ...

    def takes(self, item: str) -> bool:
        """Return whether an added item is for this part, and not for the one that follows."""
        ...

    def facts(self, ended: str, seconds: float) -> dict[str, Any]:
        """Return this part's own entries of `summary`; `seconds` is the time of all steps."""
        ...


class Inputs(Protocol):
    """What a frame waits for from outside: the poses of live bodies."""

    def arrived(self, frame: int) -> bool:
        """Return whether the inputs of a frame have arrived. Raises Refused where none will come."""
        ...


class Driver:
    """Steps cloth or dye frame by frame, publishes it and replies to control requests."""

    def __init__(
        self, context: Context, stepper: Stepper, account: Account, watchdog: FrameWatchdog,
        follows: Topic | None = None, inputs: Inputs | None = None,
    ) -> None:  # fmt: skip
        """`follows` is the topic of the leader's statuses, None for the leader; `watchdog` has run since the
        preparation.
        """
        self.context, self.stepper, self.account, self.inputs = context, stepper, account, inputs
        scene = context.loaded.scene
        timed = {"bodies": inputs is not None, "contact forces": scene.record.contact_forces}
        self.seconds = dict.fromkeys(("steps", "waiting", "encoding", *(name for name in timed if timed[name])), 0.0)
        self.version = -1
        """Version of the published constant data, -1 before the start."""
        self.warned = len(account.warnings) if stepper.frame else 0
        """Number of warnings that are events already, in this run or in the one that it resumes."""
        self.digest = stepper.digest()
        """Digest of the present state."""
        self.shown = self.kept = -1
        """Numbers of the last frame with published arrays, and of that of the last checkpoint."""
        self.watchdog = watchdog
        self.watchdog.holds = stepper.holds
        self.watchdog.prepared()
        self.watchdog.returns = lambda: stepper.begun is not None
        self.watchdog.limit = scene.frame_limit or math.inf
        self.abandoned = False
        """Whether a frame was abandoned: the run cannot continue from the present memory of the solver."""
        self.scene, self.follows = scene, follows
        self.follower = "dye" if not follows and scene.moves and scene.dye is not None else ""
        self.due: list[int] = []
        """Frames that the leader has finished and this service has not."""
        self.state = "paused"
        self.until: int | None = None
        """Frame at which a run pauses again after the action `step`."""
        self.finish: Query | None = None
        self.acked = dict.fromkeys(() if follows else context.options.must_see, -1)
        self.totals: dict[str, int] = {}
        self.message, self.begin, self.paused_seconds = "", stepper.t, 0.0
        self.held: float | None = None
        """Wall time since which all services are ready and the run waits before its first frame [s]."""
        self.clock = Clock(self) if (context.options.real_time or context.loaded.paced) and not follows else None
        self.inbox = Inbox(context.bus, [follows or ack_topic("*")], on_query=self.watchdog.note_query)
        self.inbox.answer(f"{CONTROL}/{context.bus.service}" if follows else CONTROL)
        self.inbox.answer(f"finish/{context.bus.service}")
        self.silent_until = 0.0
        """Time of the next allowed warning that the run waits."""
        self.answers: dict[str, Callable[[], bytes]] = {}
        """Further queries that are answered between frames, by name."""

    def publish_constant(self, frame: int) -> bool:
        """Publish the data that hold from a frame on, if they have changed; return whether they have."""
        if self.account.version == self.version:
            return False
        self.version = self.account.version
        topic, arrays, text = self.account.constant(frame)
        self.context.bus.publisher(topic).put(encode_arrays(arrays, text), frame, frame / self.scene.frame_rate)
        return True

    def publish_warnings(self) -> None:
        """Publish new warnings as events."""
        for text in self.account.warnings[self.warned :]:
            self.context.event("warning", text, self.stepper.frame, self.stepper.t)
        self.warned = len(self.account.warnings)

    def publish(self, frame: Stepped, show: bool) -> None:
        """Publish a frame's status, before it its arrays if `show`, and after it the forces on bodies, if wanted."""
        if show:
            self.publish_arrays(frame.digest)
        self.digest = frame.digest
        start, report, topic = time.perf_counter(), frame.report, self.stepper.status
        status = STATUSES[topic.name](
            frame=frame.number, t=self.stepper.t, digest=frame.digest, steps=report.steps, step_seconds=frame.seconds,
            paused_seconds=self.paused_seconds,
            state="running" if report.status == "ok" else report.status, message=report.message,
            **self.account.status_of(frame),
        )  # fmt: skip
        self.seconds["encoding"] += time.perf_counter() - start
        self._put(topic, status.model_dump_json().encode(), frame.digest)
        self.publish_warnings()
        if self.scene.record.contact_forces:
            start = time.perf_counter()
            loads = self.account.loads()
            self.seconds["contact forces"] += time.perf_counter() - start
            for topic, payload in loads:
                self._put(topic, payload)

    def publish_arrays(self, digest: str) -> None:
        """Publish the present state as float32."""
        start, payload = time.perf_counter(), self.stepper.encode()
        self.shown = self.stepper.frame
        self.seconds["encoding"] += time.perf_counter() - start
        self._put(self.stepper.published, payload, digest)

    def _put(self, topic: Topic, payload: bytes | bytearray, digest: str = "") -> None:
        self.context.bus.publisher(topic).put(payload, self.stepper.frame, self.stepper.t, digest)

    def keep(self) -> None:
        """Publish a checkpoint: the whole float64 state, which continues to the same bits. An abandoned frame has that
        of its start, or none.

        The arrays of its frame are published, too: a resumed run then shows the same as an unbroken one.
        """
        begun = self.stepper.begun
        if self.abandoned and begun is None:
            return
        arrays, text = (begun.arrays, begun.text) if self.abandoned and begun else self.stepper.whole()
        text |= {"digest": self.digest}
        if self.shown != text["frame"]:
            self.publish_arrays(self.digest)
        self._put(self.stepper.kept, encode_arrays(arrays, text), self.digest)
        self.kept = text["frame"]

    def step_frame(self) -> Stepped:
        """Step one frame and publish it, after cloth that a due operation changes."""
        begin, stepper = time.perf_counter(), self.stepper
        if stepper.alter_due():
            self.digest = stepper.digest()
            self.publish_constant(stepper.frame + 1)
        stepper.begun = None
        with self.watchdog.frame(stepper.frame, stepper.t):
            frame = stepper.step()
        if frame.report.status == LEFT:
            self.abandoned = True
            if (held := self.watchdog.exceeded) is not None:
                self.state, self.message = "failed", self._too_slow(frame.seconds, held)
            return frame
        self.seconds["steps"] += frame.seconds
        self.publish(frame, frame.number % self.account.every == 0 or frame.report.status != "ok")
        if self.clock is not None:
            self.clock.hold(begin)
        return frame

    def _too_slow(self, seconds: float, held: str) -> str:
        """Return why an abandoned frame that took so long [s] has ended the run, what `held` it, and the remedy."""
        self.watchdog.exceeded, self.watchdog.leave[0] = None, 0
        with self.watchdog.measuring(2.0 * seconds):  # new memory of the solver takes some of it
            parts = ", ".join(f"{name} {share:.0%}" for name, share in self.stepper.divide_left(seconds).items())
        number, limit = self.stepper.frame + 1, self.scene.frame_limit
        took = f"frame {number} was given up after {seconds:.3g} s, and frame_limit is {limit:g} s"
        room = "; more room there, or thinner cloth, makes it faster" if held else ""
        remedy = f"{FASTER}; a larger frame_limit lets nuno run --resume go on from the frame before"
        return "; ".join(filter(None, (took, parts and f"of its time took {parts}", held + room, remedy)))

    def listen(self, timeout: float) -> None:
        """Handle one item, if one arrives in time: acknowledgements, control and the end share one ordered queue."""
        item = self.inbox.get(timeout)
        if isinstance(item, Message):
            try:
                if self.follows:
                    self.due.append(FrameStatus.model_validate_json(item.payload).frame)
                else:
                    self._note(Ack.model_validate_json(item.payload), item)
            except ValidationError:
                self.inbox.refuse(item)
        elif isinstance(item, Query) and item.name.startswith(CONTROL):
            item.answer_json(self.control(item.json()))
        elif isinstance(item, Query) and item.name in self.answers:
            item.answer(self.answers[item.name]())
        elif isinstance(item, Query) and asks_to_finish(self.inbox, item):
            self.finish = item
        elif timeout > 0:
            self.context.require_supervisor()

    def _note(self, ack: Ack, message: Message) -> None:
        if message.topic != ack_topic(ack.service).name or ack.frame > self.stepper.frame:
            self.inbox.refuse(message)
        elif ack.service in self.acked:
            self.acked[ack.service] = max(self.acked[ack.service], ack.frame)

    def control(self, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out one control request; return the result, and the number of frames `left`."""
        action, stepper = str(request.get("action")), self.stepper
        before, change = self.state, {}
        if self.follows and action not in OF_FOLLOWERS:
            return {"ok": False, "error": f"{self.context.bus.service} follows; known: {', '.join(OF_FOLLOWERS)}"}
        if action == "add" and self.follower and not self.account.takes(str(request.get("item"))):
            return self._forward(request)
        if action == "start" and request.get("paused"):
            self.held = time.perf_counter()
        elif action in STATES:
            self.state, self.until = STATES[action], self.until if action == "start" else None
            if action == "pause":
                self.watchdog.paused()
        elif action == "step":
            frames = request.get("frames", 1)
            if type(frames) is not int or not 1 <= frames <= self.scene.frames:
                problem = f"step takes a number of frames, 1 to {self.scene.frames}: {frames!r:.60}"
                return {"ok": False, "error": problem}
            self.state, self.until = "running", stepper.frame + frames
        elif action in ("set", "add"):
            self._step_back()
            try:
                change = (self.change if action == "set" else self.add)(str(request.get("item")))
            except BadInput as error:
                return {"ok": False, "error": str(error), "refused": error.told()}
        elif action != "status":
            return {"ok": False, "error": f"unknown action {action!r}; known: {', '.join(ACTIONS)}"}
        if action not in ("start", "status"):
            args = {name: request[name] for name in ("item", "frames") if name in request}
            args |= {name: change.pop(name) for name in ("item",) if name in change}
            event = self.context.event("control", action, stepper.frame, stepper.t, **args)
            stepper.steered += tuple(describe_changes([event]))
        answer = {"ok": True, "state": self.state, "before": before, "left": self.left}
        return answer | {"frame": stepper.frame, "frames": self.scene.frames, "t": stepper.t} | change

    @property
    def left(self) -> int:
        """Frames until a run pauses again after the action `step`, 0 otherwise."""
        return self.until - self.stepper.frame if self.until is not None else 0

    def change(self, item: str) -> dict[str, Any]:
        """Set a field of the running scene; return its name, and its old and new value."""
        field = item.partition("=")[0]
        old = self.stepper.loaded.value(field)
        self.stepper.set(item)
        self.digest = self.stepper.digest()
        return {"field": field, "old": old, "new": self.stepper.loaded.value(field)}

    def add(self, item: str) -> dict[str, Any]:
        """Add an item to the running scene; return the fields of the control event.

        A checkpoint follows new cloth, so that a run resumed at this frame has it.
        """
        change = self.stepper.add(item)
        self.digest = self.stepper.digest()
        if self.version >= 0 and self.publish_constant(self.stepper.frame + 1) and self.stepper.part == "cloth":
            self.keep()
        return {"old": None} | change

    def _forward(self, request: dict[str, Any]) -> dict[str, Any]:
        """Pass an addition to the service that follows; return its answer, with the state of the run."""
        try:
            answer = self.context.bus.ask_json(f"{CONTROL}/{self.follower}", request, FOLLOWER_TIMEOUT)
        except RunFailed as error:  # no reply; if it is dead, the supervisor ends the run
            return {"ok": False, "error": f"{error}; it may still do what it was asked for"}
        return answer | ({"state": self.state, "before": self.state, "left": self.left} if answer["ok"] else {})

    def repeat_changes(self) -> None:
        """Make the changes that the resumed recording has in the present frame, and record them again; warn of one that
        is refused, which other changes since the checkpoint may have made impossible.
        """
        for event in self.stepper.take_due() if self.stepper.ahead else ():
            answer = self.control({"action": event.text, "item": event.args.get("item")})
            if not answer["ok"]:
                text = f"a recorded change is not made again: {answer['error']}"
                self.context.event("warning", text, self.stepper.frame, self.stepper.t)

    def serve(self) -> None:
        """Declare the service alive, wait for the start, step all frames, reply to the query for the end."""
        with self.context.bus.alive():
            while self.state == "paused" and self.finish is None and not self.due:
                self.listen(0.5)
            now, ended = time.perf_counter(), "failed"
            begin = now if self.held is None else self.held
            self.paused_seconds = now - begin
            if self.finish is None:
                self.publish_warnings()
                self.publish_constant(self.stepper.frame)
                self.publish(self.stepper.first(), show=True)
                if not self.follows:
                    # With it services compile what they look at frames by, which is no time of the run's.
                    start = time.perf_counter()
                    self.wait_for(self.stepper.frame)
                    self.seconds["waiting"], begin = 0.0, begin + time.perf_counter() - start
                ended = self.follow() if self.follows else self.run()
            seconds = time.perf_counter() - begin
            with self.watchdog.measuring():
                summary = self.summary(ended, seconds)
            if not self.follows:
                self.context.event("end", ended, self.stepper.frame, self.stepper.t, summary=summary)
            self.watchdog.close()
            while self.finish is None:
                self.listen(0.5)
            self.finish.answer_json(self.context.counts(self.inbox) | {"summary": summary})

    def run(self) -> str:
        """Step all frames; return the end: done, stopped, diverged, unconverged or (asked to finish early) failed."""
        while not self.stepper.finished:
            self.listen(0)
            self.context.require_supervisor()  # nobody else would end the run, or receive its result
            start = time.perf_counter()
            while self.state == "paused" and self.finish is None:
                self.listen(0.5)
            self.paused_seconds += time.perf_counter() - start
            if self.finish is not None or self.state in OVER:
                break
            self._step_back()
            if not self.ready():
                continue
            status = self.one_frame()
            if status == LEFT:
                self._await_request()
                continue
            if status == "unconverged" and self.stepper.frame >= self.scene.frames:  # a longer run can resume
                self.keep()
                self.wait_for(self.stepper.frame)
            if status != "ok":
                return status
            if self.until is not None and self.stepper.frame >= self.until:
                self.state, self.until = "paused", None
        self.keep()  # also of an interrupted run, which can be resumed from there
        if self.finish is not None:
            return "failed"
        self.wait_for(self.stepper.frame)
        return self.state if self.state in OVER else "done"

    def _step_back(self) -> None:
        """Go back to the start of a frame that was abandoned for a pause."""
        if self.abandoned and self.stepper.begun is not None:
            self.stepper.step_back()
            self.abandoned = False

    def _await_request(self) -> None:
        """Wait for the end or the pause that a frame was abandoned for."""
        while self.finish is None and self.state == "running":
            self.listen(LOOK_SECONDS)

    def ready(self) -> bool:
        """Wait for the inputs of the next frame, under control; return False if the run does not go on now. It fails if
        they do not come in time.
        """
        if self.inputs is None:
            return True
        start, pause, frame = time.perf_counter(), pauses(), self.stepper.frame + 1
        try:
            while not self.inputs.arrived(frame) and self.finish is None and self.state == "running":
                self.listen(next(pause))
        except Refused as error:
            self.state, self.message = "failed", error.reason
        self.seconds["bodies"] += time.perf_counter() - start
        return self.finish is None and self.state == "running"

    def follow(self) -> str:
        """Step each frame of the leader until the end; return how it ended. Raises RunFailed for a missing frame."""
        self.state = "running"
        while self.finish is None:
            while self.due and self.finish is None:
                frame = self.due.pop(0)
                if frame not in (self.stepper.frame, self.stepper.frame + 1):
                    raise RunFailed(f"frame {frame} came after frame {self.stepper.frame}")
                status = self.one_frame() if frame > self.stepper.frame else "ok"
                if status == LEFT:
                    if self.message:
                        raise RunFailed(self.message)
                    self._await_request()
                    continue
                if status != "ok":
                    raise RunFailed(self.message or "amounts are no longer finite")
                self.context.acknowledge(frame, self.stepper.t)
                self.listen(0)
            if self.finish is None:
                self.listen(0.5)
        if self.finish.json().get("error"):
            return "failed"
        if self.kept != self.stepper.frame:
            self.keep()
        return "done"

    def one_frame(self) -> str:
        """Step and publish one frame, after its recorded changes; wait for lockstep subscribers that are behind; return
        its status.
        """
        self.repeat_changes()
        report = self.step_frame().report
        if report.status == LEFT:
            return LEFT
        for name, value in report.totals.items():
            self.totals[name] = self.totals.get(name, 0) + value
        self.message = report.message
        frame = self.stepper.frame
        if frame % self.scene.checkpoint_frames == 0 and report.status == "ok" and frame < self.scene.frames:
            self.keep()
        every = self.account.every
        self.wait_for((frame - WINDOW) // every * every)  # frames between are not all acknowledged
        return str(report.status)

    def wait_for(self, frame: int) -> None:
        """Wait until every lockstep service has acknowledged `frame`. Raises RunFailed for one that hangs."""
        start, waited, reported = time.perf_counter(), 0.0, ""
        while self.finish is None and (late := [name for name, seen in self.acked.items() if seen < frame]):
            self.listen(0.5)
            if "viewer" in late and "viewer" not in self.context.watch.alive():
                del self.acked["viewer"]  # the run goes on without a view
                continue
            waited, names = time.perf_counter() - start, " and ".join(late)
            if waited > PATIENCE:
                text = f"the {names} service has not acknowledged frame {frame} within {PATIENCE:g} s"
                raise RunFailed(text, peer=late[0])
            if waited > WAITING_AFTER and not reported and start > self.silent_until:
                reported, text = names, f"frame {frame} is not acknowledged yet (given up after {PATIENCE:g} s)"
                text = f"waiting for the {names} service: {text}"
                self.context.event("warning", text, self.stepper.frame, self.stepper.t)
        if reported and self.finish is None:
            self.context.event("warning", f"the {reported} service goes on after {waited:.3g} s")
            self.silent_until = time.perf_counter() + SAID_AGAIN_AFTER
        self.seconds["waiting"] += time.perf_counter() - start

    def summary(self, ended: str, wall: float) -> dict[str, Any]:
        """Return the service's part of the report."""
        stepper, paused = self.stepper, self.paused_seconds
        result = {"state": ended, "message": self.message, "frame": stepper.frame, "t": stepper.t}
        times = {"began": self.begin, "simulated_seconds": stepper.t - self.begin, "wall_seconds": wall - paused}
        steps = {"steps_per_frame": stepper.steps, "dt": stepper.dt, "threads": stepper.about(), "totals": self.totals}
        clock = None if self.clock is None else self.clock.facts()
        rest = {"digest": self.digest, "paused_seconds": paused, "seconds": self.seconds, "clock": clock}
        rest |= {"steered": list(stepper.steered)}
        return result | times | steps | rest | self.account.facts(ended, self.seconds["steps"])
