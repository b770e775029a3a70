"""Ends of a stream of messages, each a process of its own: `python -m soak.traffic ROLE JSON`.

The publisher sends numbered frames and waits for their acknowledgements as a simulation does. The recorder is the
real service; told a rate, on a disk that takes no more. A subscriber takes its time over each message, or never
comes back from the first.
"""

from __future__ import annotations

import io
import json
import signal
import sys
import time
from collections.abc import Callable
from typing import IO, Any, cast

import numpy as np

from nuno.bus.encodings import encode_points
from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.sessions import PATIENCE, identity, spoke
from nuno.cli import main as nuno_main
from nuno.recording import writer
from nuno.runtime.driver import WINDOW
from nuno.runtime.service import ack_topic
from nuno_schemas.messages import STATE, Ack

POINT_BYTES = 12
COUNTER = b"[counter]..."
"""What the number of a message stands in for: as long as a point."""


def template(size: int) -> tuple[bytes, bytes]:
    """What comes before and after the counter in a `sim/state` message of about `size` bytes."""
    rng = np.random.default_rng(0)
    mark = np.frombuffer(COUNTER, np.float32).astype(np.float64)
    points = bytes(encode_points(np.vstack([rng.random((max(1, size // POINT_BYTES - 11), 3)), mark]), 0.0))
    head, _, tail = points.partition(COUNTER)
    return head, tail


def payload_of(number: int, head: bytes, tail: bytes) -> bytes:
    return head + number.to_bytes(len(COUNTER), "little") + tail


def publish(endpoint: str, run: str, size: int, count: int) -> dict[str, Any]:
    """Send `count` frames, never more than WINDOW ahead of the recorder; how long it took, and the longest wait [s]."""
    head, tail = template(size)
    with spoke(endpoint, patience=20.0, own=identity(run, "simulation")) as session:
        bus = Bus(session, run, "simulation")
        acks = Inbox(bus, [ack_topic("recorder")])
        sender, acked, longest, begin = bus.publisher(STATE), -1, 0.0, time.perf_counter()
        for number in range(count):
            start = time.perf_counter()
            sender.put(payload_of(number, head, tail), number, number / 50)
            last = number == count - 1
            while acked < (number if last else number - WINDOW):
                message = acks.get(PATIENCE)
                if not isinstance(message, Message):
                    raise TimeoutError(f"frame {number} was not acknowledged within {PATIENCE:g} s")
                acked = max(acked, Ack.model_validate_json(message.payload).frame)
            longest = max(longest, time.perf_counter() - start)
        seconds = time.perf_counter() - begin
        return {"sent": sender.sent, "seconds": seconds, "longest": longest, "bytes": count * (len(head + tail) + 12)}


def record(endpoint: str, run: str, path: str, rate: float | None = None) -> None:
    """The recorder, as `nuno serve` starts it; `rate` [bytes/s] is that of its disk."""
    if rate is not None:
        slow, real = rate, writer._open
        setattr(writer, "_open", lambda target: SlowFile(real(target), slow))  # noqa: B010
    sys.exit(nuno_main(["serve", "recorder", "hanging-sheet", "--run", run, "--connect", endpoint, "--record", path]))


class SlowFile(io.BufferedWriter):
    """A file that takes `rate` bytes a second and no more."""

    def __init__(self, stream: IO[bytes], rate: float) -> None:
        super().__init__(cast(io.RawIOBase, _Throttled(stream, rate)), 1 << 16)


class _Throttled(io.FileIO):
    def __init__(self, stream: IO[bytes], rate: float) -> None:
        path = stream.name
        stream.close()
        super().__init__(path, "r+b")
        self._rate = rate

    def write(self, data: Any) -> int:
        time.sleep(memoryview(data).nbytes / self._rate)
        return super().write(data)


def subscribe(endpoint: str, run: str, seconds: float) -> None:
    """Someone else who listens, and takes `seconds` for each message."""
    with spoke(endpoint, patience=20.0) as session:
        kept = session.declare_subscriber(f"nuno/{run}/**", lambda sample: time.sleep(seconds))
        print("ready", flush=True)
        signal.pause()
        kept.undeclare()


if __name__ == "__main__":
    ends: dict[str, Callable[..., object]] = {"publisher": publish, "recorder": record, "subscriber": subscribe}
    print(json.dumps(ends[sys.argv[1]](**json.loads(sys.argv[2]))), flush=True)
