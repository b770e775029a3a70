"""The driver of a stepping service, cloth or dye: frames in lockstep with their subscribers, under control.

Where two services step, one leads: it takes control requests, and sets the pace. The other follows: it steps each frame
that the leader has finished, and acknowledges it like any lockstep subscriber, so that both pause together.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from pydantic import ValidationError

from nuno.bus.encodings import encode_arrays
from nuno.bus.messages import WAITING_AFTER, Inbox, Message, Query
from nuno.bus.sessions import PATIENCE
from nuno.recording.reader import describe_changes
from nuno.recording.recorded import Checkpoint
from nuno.runtime.service import LOOK_SECONDS, Context, FrameWatchdog, ack_topic, asks_to_finish
from nuno.runtime.stepper import Stepped, Stepper
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


WINDOW = 4
"""Frames that the steps may run ahead of a service that must see every frame."""
SAID_AGAIN_AFTER = 60.0
"""Shortest interval between two warnings of a run that waits repeatedly, as for a slow disk [s]."""
CONTROL = "control"
OF_FOLLOWERS = ("status", "add")
STATES = {"start": "running", "resume": "running", "pause": "paused", "stop": "stopped"}
"""State of a run after an action."""
LEFT = "left"
"""Status of a frame that was abandoned, since the run is to end."""
OVER = ("stopped", "failed")
"""States that end a run between two frames."""
ACTIONS = ("status", "pause", "resume", "step", "stop", "set", "add")


class Driver(ABC):
    """Steps cloth or dye frame by frame, publishes it and replies to control requests."""

    every = 1
    """Interval of frames whose arrays are published."""

    def __init__(
        self, context: Context, stepper: Stepper, watchdog: FrameWatchdog, follows: Topic | None = None
    ) -> None:
        """`follows` is the topic of the leader's statuses, None for the leader; `watchdog` has run since the
        preparation.
        """
        self.context, self.stepper = context, stepper
        self.seconds = {"steps": 0.0, "waiting": 0.0, "encoding": 0.0}
        self.digest = stepper.digest()
        """Digest of the last published frame."""
        self.shown = self.kept = -1
        """Numbers of the last frame with published arrays, and of that of the last checkpoint."""
        self.watchdog = watchdog
        self.watchdog.holds = stepper.holds
        self.watchdog.prepared()
        self.before: Checkpoint | None = None
        """State before an abandoned frame, if it was kept."""
        self.abandoned = False
        """Whether a frame was abandoned: the run cannot continue from the present state."""
        self.scene, self.follows = context.loaded.scene, follows
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

    @abstractmethod
    def publish_constant(self) -> None:
        """Publish the data that does not change from frame to frame."""

    @abstractmethod
    def status_of(self, frame: Stepped) -> dict[str, Any]:
        """Return the fields of a frame's status that only this service has."""

    @abstractmethod
    def facts(self, ended: str) -> dict[str, Any]:
        """Return the service's own part of `summary`, for the report."""

    def publish(self, frame: Stepped, show: bool) -> None:
        """Publish a frame's status, and before it its arrays if `show`."""
        if show:
            self.publish_arrays(frame.digest)
        self.digest = frame.digest
        start, report, topic = time.perf_counter(), frame.report, self.stepper.status
        status = STATUSES[topic.name](
            frame=frame.number, t=self.stepper.t, digest=frame.digest, steps=report.steps, step_seconds=frame.seconds,
            paused_seconds=self.paused_seconds,
            state="running" if report.status == "ok" else report.status, message=report.message,
            **self.status_of(frame),
        )  # fmt: skip
        self.seconds["encoding"] += time.perf_counter() - start
        self._put(topic, status.model_dump_json().encode(), frame.digest)

    def publish_arrays(self, digest: str) -> None:
        """Publish the present state as float32."""
        start, payload = time.perf_counter(), self.stepper.encode()
        self.shown = self.stepper.frame
        self.seconds["encoding"] += time.perf_counter() - start
        self._put(self.stepper.published, payload, digest)

    def _put(self, topic: Topic, payload: bytes, digest: str = "") -> None:
        self.context.bus.publisher(topic).put(payload, self.stepper.frame, self.stepper.t, digest)

    def keep(self, point: Checkpoint | None = None) -> None:
        """Publish a checkpoint, by default of the present frame: the whole float64 state, which continues to the same
        bits.

        The arrays of its frame are published, too: a resumed run then shows the same as an unbroken one.
        """
        arrays, text = (point.arrays, point.text) if point else self.stepper.whole()
        if self.shown != text["frame"]:
            self.publish_arrays(text["digest"])
        self._put(self.stepper.kept, encode_arrays(arrays, text), text["digest"])
        self.kept = text["frame"]

    def step_frame(self) -> Stepped:
        """Step one frame and publish it."""
        begin, stepper = time.perf_counter(), self.stepper
        before = stepper.copied()
        with self.watchdog.frame(stepper.frame, stepper.t):
            frame = stepper.step()
        if frame.report.status == LEFT:
            self.abandoned, self.before = True, before
            return frame
        self.seconds["steps"] += frame.seconds
        self.publish(frame, frame.number % self.every == 0 or frame.report.status != "ok")
        if self.clock is not None:
            self.clock.hold(begin)
        return frame

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
        if action == "start" and request.get("paused"):
            self.held = time.perf_counter()
        elif action in STATES:
            self.state, self.until = STATES[action], self.until if action == "start" else None
        elif action == "step":
            frames = request.get("frames", 1)
            if type(frames) is not int or not 1 <= frames <= self.scene.frames:
                problem = f"step takes a number of frames, 1 to {self.scene.frames}: {frames!r:.60}"
                return {"ok": False, "error": problem}
            self.state, self.until = "running", stepper.frame + frames
        elif action in ("set", "add"):
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
        return {"field": field, "old": old, "new": self.stepper.loaded.value(field)}

    def add(self, item: str) -> dict[str, Any]:
        """Add an item to the running scene; return the field, and its new value."""
        field = self.stepper.add(item)
        return {"field": field, "old": None, "new": self.stepper.loaded.value(field)}

    def repeat_changes(self) -> None:
        """Make the changes that the resumed recording has in the present frame, and record them again; warn of one that
        is refused, which other changes since the checkpoint may have made impossible.
        """
        for event in self.stepper.take_due():
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
                self.publish_constant()
                self.publish(self.stepper.first(), show=True)
                ended = self.follow() if self.follows else self.run()
            summary = self.summary(ended, time.perf_counter() - begin)
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
            if not self.ready():
                continue
            status = self.one_frame()
            if status == LEFT:
                self._await_end()
                break
            if status == "unconverged" and self.stepper.frame >= self.scene.frames:  # a longer run can resume
                self.keep()
                self.wait_for(self.stepper.frame)
            if status != "ok":
                return status
            if self.until is not None and self.stepper.frame >= self.until:
                self.state, self.until = "paused", None
        if self.before is not None or not self.abandoned:
            self.keep(self.before)  # also of an interrupted run, which can be resumed from there
        if self.finish is not None:
            return "failed"
        self.wait_for(self.stepper.frame)
        return self.state if self.state in OVER else "done"

    def _await_end(self) -> None:
        """Wait for the end that a frame was abandoned for."""
        while self.finish is None and self.state not in OVER:
            self.listen(LOOK_SECONDS)

    def ready(self) -> bool:
        """Wait for the inputs of the next frame, under control; return False if the run does not go on now."""
        return True

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
                    self._await_end()
                    continue
                if status != "ok":
                    raise RunFailed(self.message or "amounts are no longer finite")
                self.context.acknowledge(frame, self.stepper.t)
                self.listen(0)
            if self.finish is None:
                self.listen(0.5)
        if self.finish.json().get("error"):
            return "failed"
        if self.kept != self.stepper.frame and (self.before is not None or not self.abandoned):
            self.keep(self.before)
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
        self.wait_for((frame - WINDOW) // self.every * self.every)  # frames between are not all acknowledged
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
        digest = self.digest if self.abandoned else stepper.digest()
        rest = {"digest": digest, "paused_seconds": paused, "seconds": self.seconds, "clock": clock}
        rest |= {"steered": list(stepper.steered)}
        return result | times | steps | rest | self.facts(ended)
