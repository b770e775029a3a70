"""What is published of whatever is stepped: each frame's status and arrays, and checkpoints."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from typing import Any

from nuno.service import Context
from nuno.stepping.stepped import Stepped, Stepper
from nuno.wire.arrays import encode_arrays
from nuno_schemas.messages import STATUSES, Topic

WINDOW = 4
"""Frames that the steps may run ahead of a service that must see every one."""


class Publishing(ABC):
    """Publishes the frames of one stepper."""

    every = 1
    """Frames from one whose arrays are published to the next."""

    def __init__(self, context: Context, stepper: Stepper) -> None:
        self.context, self.stepper, self.scene = context, stepper, context.loaded.scene
        self.seconds = {"steps": 0.0, "waiting": 0.0, "encoding": 0.0}
        self.shown: list[int] = []
        """Frames whose arrays were published, the last few."""
        self.kept = -1
        """Frame of the last checkpoint."""

    @abstractmethod
    def publish_constant(self) -> None:
        """Tell what does not change from frame to frame."""

    @abstractmethod
    def status_of(self, frame: Stepped) -> dict[str, Any]:
        """What the status says of a frame beside what every one says."""

    def publish_start(self) -> None:
        """What does not change, and the state before the first step."""
        self.publish_constant()
        self.publish(self.stepper.present(), show=True)

    def publish(self, frame: Stepped, show: bool) -> None:
        """A frame's status, and before it, where it is to be shown, its arrays."""
        if show:
            self.publish_arrays(frame.digest)
        start, report, topic = time.perf_counter(), frame.report, self.stepper.status
        said = {
            "frame": frame.number,
            "t": self.stepper.t,
            "digest": frame.digest,
            "state": "running" if report.status == "ok" else report.status,
            "steps": report.steps,
            "step_seconds": frame.seconds,
            "message": report.message,
        }
        status = STATUSES[topic.name].model_validate(said | self.status_of(frame))
        self.seconds["encoding"] += time.perf_counter() - start
        self._put(topic, status.model_dump_json().encode(), frame.digest)

    def publish_arrays(self, digest: str) -> None:
        """The present state as float32."""
        start = time.perf_counter()
        payload = self.stepper.encode()
        self.shown = [*self.shown[-WINDOW:], self.stepper.frame]
        self.seconds["encoding"] += time.perf_counter() - start
        self._put(self.stepper.published, payload, digest)

    def _put(self, topic: Topic, payload: bytes, digest: str = "") -> None:
        self.context.bus.publisher(topic).put(payload, self.stepper.frame, self.stepper.t, digest)

    def keep(self) -> None:
        """Publish a checkpoint: the whole float64 state, enough to go on from in the same bits.

        The arrays of this frame are shown, too: a resumed run then shows what an unbroken one does.
        """
        point = self.stepper.keep()
        if self.shown[-1] != point.frame:
            self.publish_arrays(point.digest)
        self._put(self.stepper.kept, encode_arrays(point.arrays, point.text), point.digest)
        self.kept = point.frame

    def shown_until(self, frame: int) -> int:
        """The last frame up to `frame` that was published whole, and is acknowledged; below 0 for none."""
        return next((shown for shown in reversed(self.shown) if shown <= frame), -1)
