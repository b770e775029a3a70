"""What frames tell on the bus: their status, their arrays, and checkpoints."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from typing import Any

from nuno.recording.recorded import Checkpoint
from nuno.service import Context
from nuno.stepping.stepped import Stepped, Stepper
from nuno.wire.arrays import encode_arrays
from nuno_schemas.messages import STATUSES, Topic


class Teller(ABC):
    """Publishes what is stepped."""

    def __init__(self, context: Context, stepper: Stepper) -> None:
        self.context, self.stepper = context, stepper
        self.seconds = {"steps": 0.0, "waiting": 0.0, "encoding": 0.0}
        self.digest = stepper.digest()
        """Of the last frame that was told."""
        self.shown = self.kept = -1
        """Frames of the last arrays that were published, and of the last checkpoint."""

    @abstractmethod
    def publish_constant(self) -> None:
        """Tell what does not change from frame to frame."""

    @abstractmethod
    def status_of(self, frame: Stepped) -> dict[str, Any]:
        """What the status says of a frame beside what every one says."""

    def publish(self, frame: Stepped, show: bool) -> None:
        """A frame's status, and before it, where it is to be shown, its arrays."""
        if show:
            self.publish_arrays(frame.digest)
        self.digest = frame.digest
        start, report, topic = time.perf_counter(), frame.report, self.stepper.status
        status = STATUSES[topic.name](
            frame=frame.number, t=self.stepper.t, digest=frame.digest, steps=report.steps, step_seconds=frame.seconds,
            state="running" if report.status == "ok" else report.status, message=report.message,
            **self.status_of(frame),
        )  # fmt: skip
        self.seconds["encoding"] += time.perf_counter() - start
        self._put(topic, status.model_dump_json().encode(), frame.digest)

    def publish_arrays(self, digest: str) -> None:
        """The present state as float32."""
        start, payload = time.perf_counter(), self.stepper.encode()
        self.shown = self.stepper.frame
        self.seconds["encoding"] += time.perf_counter() - start
        self._put(self.stepper.published, payload, digest)

    def _put(self, topic: Topic, payload: bytes, digest: str = "") -> None:
        self.context.bus.publisher(topic).put(payload, self.stepper.frame, self.stepper.t, digest)

    def keep(self, point: Checkpoint | None = None) -> None:
        """Publish a checkpoint, that of the present frame unless it is given: the whole float64 state, enough to go on
        from in the same bits.

        The arrays of this frame are shown, too: a resumed run then shows what an unbroken one does.
        """
        arrays, text = (point.arrays, point.text) if point else self.stepper.whole()
        if self.shown != text["frame"]:
            self.publish_arrays(text["digest"])
        self._put(self.stepper.kept, encode_arrays(arrays, text), text["digest"])
        self.kept = text["frame"]
