"""How each service of a run is doing, told when it is asked: who does not ask costs the run nothing."""

from __future__ import annotations

import os
import platform
import time

import psutil
import zenoh
from pydantic import BaseModel, ValidationError

from nuno.bus.messages import Bus
from nuno.bus.query import Query
from nuno_schemas.errors import RunFailed

HEALTH = "health"


class Published(BaseModel):
    """What a service has published on one topic since its start: messages, and the bytes of their payloads."""

    topic: str
    encoding: str
    type: str
    sent: int
    sent_bytes: int


class Health(BaseModel):
    """What one service counts, since its start; processor time and memory are those of its process.

    frame is the last that it published, or, of one that takes frames in, has taken in; waiting are
    messages that have come and are not taken in yet.
    """

    service: str
    host: str
    pid: int
    time: float
    """Of its host's monotonic clock [s]: differences give rates."""
    leads: bool
    """Whether it publishes frames and takes none in."""
    frame: int
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
    """The counts of a service's place on the bus, at this moment."""
    # Copies: the service goes on meanwhile, in another thread.
    publishers, inboxes = list(bus.publishers.values()), list(bus.inboxes)
    process = psutil.Process()
    with process.oneshot():
        used, memory = process.cpu_times(), process.memory_info().rss

    def total(name: str) -> int:
        return sum(sum(list(getattr(inbox.counts, name).values())) for inbox in inboxes)

    published = max((p.frame for p in publishers), default=-1)
    taken = max((inbox.frame for inbox in inboxes), default=-1)
    return Health(
        service=bus.service,
        host=platform.node(),
        pid=os.getpid(),
        time=time.monotonic(),
        leads=taken < 0 <= published,
        frame=taken if taken >= 0 else published,
        t=max((p.t for p in publishers), default=0.0),
        sent=sum(p.sent for p in publishers),
        sent_bytes=sum(p.payload_bytes for p in publishers),
        received=total("received"),
        received_bytes=sum(inbox.payload_bytes for inbox in inboxes),
        waiting=sum(inbox.waiting for inbox in inboxes),
        missing=total("missing"),
        refused=total("refused"),
        processor=used.user + used.system,
        memory=memory,
        topics=[
            Published(topic=t.name, encoding=t.encoding, type=t.schema, sent=p.sent, sent_bytes=p.payload_bytes)
            for p in publishers
            for t in [p.topic]
        ],
    )


def offer_health(bus: Bus) -> None:
    """Answer whoever asks, also while the service works on a frame: in the session's thread, in a fraction of a
    millisecond, which nobody pays who is not asked.
    """
    key = bus.key(f"{HEALTH}/{bus.service}")

    def answer(query: zenoh.Query) -> None:
        Query(HEALTH, key, query).answer(measure(bus).model_dump_json().encode())

    bus.offers.append(bus.session.declare_queryable(key, answer))


def ask_health(bus: Bus, services: set[str], timeout: float = 2.0) -> dict[str, Health]:
    """Of each service that answers in time [s]."""
    # Each by its own name: access control lets a service answer for itself only.
    questions = {name: bus.ask_ahead(f"{HEALTH}/{name}", timeout=timeout) for name in sorted(services)}
    found = {}
    for name, asked in questions.items():
        try:
            found[name] = Health.model_validate_json(asked.answer())
        except (RunFailed, ValidationError):
            continue
    return found
