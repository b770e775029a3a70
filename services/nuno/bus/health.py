"""Health of each service of a run, measured on demand (without a query it costs nothing), and liveliness of all."""

from __future__ import annotations

import os
import platform
import threading
import time

import psutil
import zenoh
from pydantic import BaseModel, ValidationError

from nuno.bus.messages import Bus, Query
from nuno.bus.sessions import direct
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import FRAMES, STATUSES

# Liveliness of the services of a run.


class Watch:
    """Tracks which services of a run are alive, by their liveliness tokens."""

    def __init__(self, bus: Bus) -> None:
        self._alive: set[str] = set()
        self._seen: set[str] = set()
        self._changed = threading.Condition()
        note, key = direct(self._note), bus.key("alive/*")
        self._subscriber = bus.session.liveliness().declare_subscriber(key, note, history=True)

    def _note(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).rsplit("/", 1)[-1]
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._alive.add(name)
                self._seen.add(name)
            else:
                self._alive.discard(name)
            self._changed.notify_all()

    def alive(self) -> set[str]:
        with self._changed:
            return set(self._alive)

    def gone(self, name: str) -> bool:
        """Return whether a service was alive once and is not now."""
        with self._changed:
            return name in self._seen and name not in self._alive

    def wait_for(self, names: set[str], timeout: float) -> set[str]:
        """Wait until all services are alive; return those still missing after `timeout` [s]."""
        with self._changed:
            self._changed.wait_for(lambda: names <= self._alive, timeout)
            return names - self._alive


HEALTH = "health"


class Published(BaseModel):
    """Messages of a service on one topic since its start, and the bytes of their payloads."""

    topic: str
    encoding: str
    type: str
    sent: int
    sent_bytes: int


class Health(BaseModel):
    """Counts of one service since its start; processor time and memory are those of its process.

    frame is the last that it has received, or published if it receives none; waiting counts queued messages.
    """

    service: str
    host: str
    pid: int
    time: float
    """Monotonic clock of its host [s], for rates."""
    leads: bool
    """Whether it publishes frames and receives none."""
    frame: int
    frames: int
    """Passed frames, for rates: a loop counts them again."""
    t: float
    """Simulation time of the last published message [s]."""
    sent: int
    sent_bytes: int
    received: int
    received_bytes: int
    waiting: int
    missing: int
    refused: int
    processor: float
    """[s]"""
    memory: int
    """Resident [bytes]."""
    topics: list[Published]


def measure(bus: Bus) -> Health:
    """Return the present counts of a service on the bus."""
    # Copies: the service goes on meanwhile, in another thread.
    publishers, inboxes = list(bus.publishers.values()), list(bus.inboxes)
    process = psutil.Process()
    with process.oneshot():
        processor, memory = process.cpu_times(), process.memory_info().rss

    def total(name: str) -> int:
        return sum(sum(list(getattr(inbox.counts, name).values())) for inbox in inboxes)

    leading = [p for p in publishers if p.topic.name in (*FRAMES, *STATUSES)]  # others may rest while a loop goes on
    published_frame = max((p.frame for p in leading), default=-1)
    received_frame = max((inbox.frame for inbox in inboxes), default=-1)
    return Health(
        service=bus.service,
        host=platform.node(),
        pid=os.getpid(),
        time=time.monotonic(),
        leads=received_frame < 0 <= published_frame,
        frame=received_frame if received_frame >= 0 else published_frame,
        frames=received_frame if received_frame >= 0 else max((p.frames for p in leading), default=0),
        t=max((p.t for p in leading or publishers), default=0.0),
        sent=sum(p.sent for p in publishers),
        sent_bytes=sum(p.payload_bytes for p in publishers),
        received=total("received"),
        received_bytes=sum(inbox.payload_bytes for inbox in inboxes),
        waiting=sum(inbox.waiting for inbox in inboxes),
        missing=total("missing"),
        refused=total("refused"),
        processor=processor.user + processor.system,
        memory=memory,
        topics=[
            Published(topic=t.name, encoding=t.encoding, type=t.schema, sent=p.sent, sent_bytes=p.payload_bytes)
            for p in publishers
            for t in [p.topic]
        ],
    )


def offer_health(bus: Bus) -> None:
    """Answer queries for the health, also while the service works on a frame: in the session's thread, in a fraction of
    a millisecond.
    """
    key = bus.key(f"{HEALTH}/{bus.service}")

    def answer(query: zenoh.Query) -> None:
        Query(HEALTH, key, query).answer(measure(bus).model_dump_json().encode())

    bus.offers.append(bus.session.declare_queryable(key, answer))


def ask_health(bus: Bus, services: set[str]) -> dict[str, Health]:
    """Return the health of each service that answers within 2 s."""
    # One query for each service: access control lets a service answer only for itself.
    replies = {name: bus.ask_ahead(f"{HEALTH}/{name}", timeout=2.0) for name in sorted(services)}
    health = {}
    for name, reply in replies.items():
        try:
            health[name] = Health.model_validate_json(reply.answer())
        except (RunFailed, ValidationError):
            continue
    return health
