"""Replay of a recording: its messages are published again, on their topics and in order."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from nuno.bus.health import Watch
from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.sessions import PATIENCE
from nuno.recording.reader import Recording
from nuno.recording.recorded import Recorded
from nuno.recording.writer import topic_of
from nuno.runtime.service import ack_topic
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import (
    BODIES,
    CHECKPOINTS,
    CLOTH,
    CONCENTRATION,
    DYE_STATUS,
    FABRIC,
    FRAMES,
    GEOMETRY,
    STATUSES,
    Topic,
)

WINDOW = 4
"""Frames that may be sent before they are acknowledged."""
DIGESTED = (*FRAMES, *STATUSES, *CHECKPOINTS)
"""Topics whose headers have the digest of the float64 state."""

Progress = Callable[[float], None]


@dataclass
class Replay:
    """A replay and its settings.

    rate      simulated seconds a second of wall time; None: as fast as the subscribers take it
    start     simulation time [s] to begin at; data that a viewer needs (cloth, bodies) comes first
    must_see  services that acknowledge every frame, and that the replay waits for
    """

    rate: float | None = 1.0
    start: float = 0.0
    must_see: tuple[str, ...] = ()
    stop: threading.Event = field(default_factory=threading.Event)
    """Set it (from any thread) to end the replay after the present message."""
    sent: dict[str, int] = field(default_factory=dict)
    """Number of sent messages by topic."""

    def run(self, bus: Bus, recording: Recording, progress: Progress | None = None) -> None:
        """Publish `recording` as the run of `bus`, until its end or `stop`.

        Headers are new: the run is the bus's, numbers count on from those of earlier passes, without the
        recording's gaps; frame and digest are those of `Recording.mark`. `progress` is called
        with each frame's time [s]. Raises BadInput for a rate or start out of range, RunFailed where
        a service in `must_see` dies or hangs.
        """
        span = self.check(recording)
        acks = _Acks(bus, self.must_see, self.frames)
        try:
            begin = time.perf_counter()
            for message in _from(recording, self.start):
                self._wait(message.t - max(self.start, span[0]), begin)
                if self.stop.is_set():
                    return
                self._publish(bus, message, *recording.mark(message))
                if message.topic in FRAMES:
                    acks.wait(self.frames - WINDOW, self.stop)
                    if progress is not None:
                        progress(message.t)
            acks.wait(self.frames, self.stop)
        finally:
            acks.close()

    @property
    def frames(self) -> int:
        """Number of sent frames."""
        return sum(self.sent.get(name, 0) for name in FRAMES)

    def check(self, recording: Recording) -> tuple[float, float]:
        """Return start and end of a recording [s]. Raises BadInput if it cannot be replayed."""
        if self.rate is not None and not 1e-6 <= self.rate <= 1e6:
            limit, remedy = "1e-6 to 1e6", "1 is real time"
            raise BadInput("no such rate", field="--rate", value=self.rate, limit=limit, remedy=remedy)
        for topic in recording.counts:
            if not re.fullmatch(r"[^/*$?#\x00-\x1f\x7f]+(/[^/*$?#\x00-\x1f\x7f]+)*", topic):
                problem, remedy = "a topic that no key can name", "write the recording anew without it"
                raise BadInput(problem, str(recording.path), value=topic, remedy=remedy)
        span = recording.span
        if not self.start <= span[1]:
            limit = f"the recording ends at {span[1]:g} s"
            raise BadInput("nothing to replay there", field="--start", value=self.start, limit=limit)
        for status in (DYE_STATUS.name, None):
            recording.marks(status)  # damage is refused before anything is published
        return span

    def _wait(self, elapsed: float, begin: float) -> None:
        """Sleep until `elapsed` simulated seconds are due; late messages are sent at once."""
        if self.rate is not None:
            due = begin + max(elapsed, 0.0) / self.rate - time.perf_counter()
            if due > 0:
                self.stop.wait(due)

    def _publish(self, bus: Bus, message: Recorded, frame: int, digest: str) -> None:
        topic = topic_of(message.topic) or Topic(message.topic, "json", "")
        bus.publisher(topic).put(message.payload, frame, message.t, digest if message.topic in DIGESTED else "")
        self.sent[message.topic] = self.sent.get(message.topic, 0) + 1


def _from(recording: Recording, start: float) -> Iterator[Recorded]:
    """Yield all messages from `start` [s] on, after the last ones that a viewer needs."""
    if start > recording.span[0]:
        rare = (recording.scene.get("record") or {}).get("dye_every") is not None
        for name in (FABRIC.name, GEOMETRY.name, BODIES.name, CLOTH.name, *([CONCENTRATION.name] if rare else [])):
            message = recording.last(name, before=start - 1e-9)
            if message is not None:
                yield message
        yield from recording.messages(start=start)
    else:
        yield from recording.messages()


class _Acks:
    """Counts acknowledgements from `frames` on; a count, not a frame number, since a loop sends frames again."""

    def __init__(self, bus: Bus, services: tuple[str, ...], frames: int) -> None:
        self._inbox = Inbox(bus, [ack_topic(name) for name in services])
        self._seen = {ack_topic(name).name: frames for name in services}
        self._watch = Watch(bus)
        missing = self._watch.wait_for(set(services), PATIENCE)
        if missing:
            raise RunFailed(f"not ready within {PATIENCE:g} s: {', '.join(sorted(missing))}")

    def wait(self, frames: int, stop: threading.Event) -> None:
        """Wait until every service has acknowledged this number of frames, or `stop`."""
        quiet = time.monotonic()
        while min(self._seen.values(), default=frames) < frames and not stop.is_set():
            item = self._inbox.get(timeout=0.2)
            if isinstance(item, Message):
                self._seen[item.topic] += 1
                quiet = time.monotonic()
                continue
            late = sorted(topic.removeprefix("ack/") for topic, seen in self._seen.items() if seen < frames)
            if gone := [name for name in late if name not in self._watch.alive()]:
                raise RunFailed(f"the {gone[0]} service died during the replay")
            if time.monotonic() - quiet > PATIENCE:
                raise RunFailed(f"{', '.join(late)} has not acknowledged a frame within {PATIENCE:g} s")

    def close(self) -> None:
        self._inbox.close()
