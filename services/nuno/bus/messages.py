"""The message bus: numbered messages, checked inboxes, queries, liveliness."""

from __future__ import annotations

import json
import math
import queue
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import zenoh
from pydantic import ValidationError

from nuno.bus.sessions import direct
from nuno_schemas import SCHEMA_VERSION
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import POSES, Header, Topic

ALL = Topic("**", "json", "")
"""All topics in one subscription, since messages of several subscriptions overtake each other."""
FURTHEST = 100_000
"""A message whose number is this far ahead is refused as foreign: accepting it would refuse all others."""

SENT: dict[bytes, Header] = {}
"""Headers of the last messages sent from this process, by their JSON: its other threads read none."""
KEPT_HEADERS = 256
_SENDING = threading.Lock()


@dataclass
class Message:
    """One message as it arrived."""

    topic: str
    header: Header
    payload: bytes
    skipped: int = 0
    """Number of messages missing directly before this one."""


@dataclass
class Publisher:
    """Numbers and sends the messages of one topic; blocks rather than drops."""

    bus: Bus
    topic: Topic
    handle: zenoh.Publisher
    sent: int = 0
    seconds: float = 0.0
    payload_bytes: int = 0
    frame: int = -1
    """Last published frame."""
    frames: int = 0
    """Published frames, also those that a loop publishes again."""
    t: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock)

    def put(self, payload: bytes | bytearray, frame: int = -1, t: float = 0.0, digest: str = "") -> None:
        with self.lock:
            start = time.perf_counter()
            header = Header(run=self.bus.run, service=self.bus.service, seq=self.sent, frame=frame, t=t, digest=digest)
            attachment = header.model_dump_json().encode()
            with _SENDING:  # threads that send at once would change the mapping while its first one is looked for
                SENT[attachment] = header
                if len(SENT) > KEPT_HEADERS:
                    del SENT[next(iter(SENT))]
            self.handle.put(payload, attachment=attachment)
            self.sent += 1
            self.payload_bytes += len(payload)
            if frame >= 0:
                self.frames += max(0, frame - self.frame)
                self.frame, self.t = frame, t
            self.seconds += time.perf_counter() - start


@dataclass
class Counts:
    """Counts of an inbox by topic: received, missing and refused messages."""

    received: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    missing: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    refused: dict[str, int] = field(default_factory=lambda: defaultdict(int))

    def nonzero(self) -> dict[str, dict[str, int]]:
        """Return the counts by name and topic, without zeros."""
        return {name: {topic: n for topic, n in counts.items() if n} for name, counts in vars(self).items()}


class Inbox:
    """A queue of messages of some topics, and of queries, which are checked and counted.

    Order holds within a subscription; zenoh keeps none between separate subscriptions.

    A callback only enqueues: work there would delay every message behind it in the session.
    Malformed, foreign, repeated and out-of-order messages are dropped and counted; a gap in the
    numbers is counted as missing. The queue is bounded by the lockstep, not by a limit here. An inbox
    with `newest_only` observes a run from outside, and a program may end without closing it.
    """

    def __init__(
        self, bus: Bus, topics: list[Topic], newest_only: bool = False,
        on_query: Callable[[Query], None] = lambda query: None,
    ) -> None:  # fmt: skip
        """`on_query` is called with each arriving query, in the thread that delivers it."""
        self.counts = Counts()
        self.payload_bytes = 0
        self.frame = -1
        """Last received frame."""
        self.failure = ""
        """Reason of the run's failure, from the query that ended it."""
        self._bus = bus
        self._next: dict[str, int] = {}
        self._queue: queue.SimpleQueue[zenoh.Sample | Query | None] = queue.SimpleQueue()
        self._newest_only, self._on_query = newest_only, on_query
        bus.inboxes.append(self)
        self._closing = threading.Lock()
        self._closed = False
        enqueue = direct(self._queue.put) if newest_only else self._queue.put
        self._handles: list[Any] = [bus.session.declare_subscriber(bus.key(t.name), enqueue) for t in topics]

    def answer(self, name: str) -> None:
        """Accept queries to `name`, too."""
        key = self._bus.key(name)
        self._handles.append(self._bus.session.declare_queryable(key, lambda query: self._ask(Query(name, key, query))))

    def _ask(self, query: Query) -> None:
        """Enqueue a query; drop one that arrives while the inbox closes, like those in the queue."""
        with self._closing:
            if not self._closed:
                self._on_query(query)  # before it is queued: the thread that takes it may answer and drop it at once
                self._queue.put(query)
                return
        query.query.drop()

    def wake(self) -> None:
        """Return None to a waiting `get`."""
        self._queue.put(None)

    def get(self, timeout: float) -> Message | Query | None:
        """Return the next query or valid message, or None after `timeout` [s] or a `wake`."""
        end = time.monotonic() + timeout
        while True:
            try:
                item = self._queue.get(timeout=max(0.0, end - time.monotonic()))
            except queue.Empty:
                return None
            if item is None or isinstance(item, Query):
                return item
            message = self._check(item)
            if message is not None:
                return message

    @property
    def waiting(self) -> int:
        """Number of queued items."""
        return self._queue.qsize()

    def refuse(self, item: Message | Query) -> None:
        """Drop an item that violates its topic's format, and count it.

        A message's number is expected again: the genuine one may still come.
        """
        if isinstance(item, Query):
            self.counts.refused[item.name] += 1
            return
        self.counts.refused[item.topic] += 1
        self.counts.received[item.topic] -= 1
        self.counts.missing[item.topic] -= item.skipped
        self._next[item.topic] = item.header.seq - item.skipped

    def close(self) -> None:
        """Accept nothing more; the senders of queued queries learn at once that there will be no reply."""
        while self._handles:
            self._handles.pop().undeclare()
        with self._closing:
            self._closed = True
        while not self._queue.empty():
            item = self._queue.get_nowait()
            if isinstance(item, Query):
                item.query.drop()

    def _check(self, sample: zenoh.Sample) -> Message | None:
        topic = str(sample.key_expr).removeprefix(self._bus.key(""))
        if topic.startswith(f"{POSES.name}/"):  # from outside, only for the collision service
            return None
        try:
            if sample.attachment is None:
                raise ValueError("no header")
            attachment = sample.attachment.to_bytes()
            header = SENT.get(attachment) or Header.model_validate_json(attachment)
        except (ValidationError, ValueError):
            self.counts.refused[topic] += 1
            return None
        expected = self._next.get(topic, header.seq if self._newest_only else 0)
        of_this_run = header.run == self._bus.run and header.schema_version == SCHEMA_VERSION
        if not of_this_run or not math.isfinite(header.t) or not expected <= header.seq < expected + FURTHEST:
            self.counts.refused[topic] += 1
            return None
        skipped = header.seq - expected
        self.counts.missing[topic] += skipped
        self._next[topic] = header.seq + 1
        self.counts.received[topic] += 1
        payload = sample.payload.to_bytes()
        self.payload_bytes += len(payload)
        if not topic.startswith("ack/"):
            self.frame = max(self.frame, header.frame)
        return Message(topic, header, payload, skipped)


class Bus:
    """One service's access to the bus of one run."""

    def __init__(self, session: zenoh.Session, run: str, service: str) -> None:
        self.session, self.run, self.service = session, run, service
        self.publishers: dict[str, Publisher] = {}
        self.inboxes: list[Inbox] = []
        self.offers: list[Any] = []
        """Other queryables and subscribers of this service, outside its inboxes."""

    def close(self) -> None:
        """Undeclare all publishers and queryables of this service: a query to it then fails at once.

        The session may be shared with other services of the process, and stays open.
        """
        for inbox in self.inboxes:
            inbox.close()
        for handle in (*self.offers, *(publisher.handle for publisher in self.publishers.values())):
            handle.undeclare()

    def key(self, name: str) -> str:
        return f"nuno/{self.run}/{name}"

    def publisher(self, topic: Topic) -> Publisher:
        """Return this service's only publisher of a topic."""
        if topic.name not in self.publishers:
            handle = self.session.declare_publisher(
                self.key(topic.name),
                congestion_control=zenoh.CongestionControl.BLOCK,
                reliability=zenoh.Reliability.RELIABLE,
                encoding=f"application/{topic.encoding};{topic.schema}",
            )
            self.publishers[topic.name] = Publisher(self, topic, handle)
        return self.publishers[topic.name]

    def ask(self, name: str, payload: bytes = b"", timeout: float = 10.0) -> bytes:
        """Return the reply of one service's queryable. Raises RunFailed if none comes."""
        return self.ask_ahead(name, payload, timeout).answer()

    def ask_ahead(self, name: str, payload: bytes = b"", timeout: float = 10.0) -> PendingReply:
        """Send a query, and return its pending reply."""
        # Not a callback: zenoh starts a thread for each, which takes far longer than the query.
        replies = self.session.get(
            self.key(name), payload=payload, timeout=timeout, congestion_control=zenoh.CongestionControl.BLOCK
        )
        return PendingReply(name, replies, timeout)

    def ask_json(
        self, name: str, value: dict[str, Any], timeout: float = 10.0, slow: Callable[[], None] | None = None
    ) -> dict[str, Any]:
        """Return a service's JSON reply; `slow` as in `PendingReply.answer`. Raises RunFailed if none comes."""
        try:
            answer = json.loads(self.ask_ahead(name, json.dumps(value).encode(), timeout).answer(slow))
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            raise RunFailed(f"the answer of {name} cannot be read", peer=name.split("/")[0])
        return answer

    def present(self, timeout: float = 2.0) -> set[str]:
        """Return the services that are alive now, by a query to the hub."""
        replies = self.session.liveliness().get(self.key("alive/*"), timeout=timeout)
        return {str(reply.ok.key_expr).rsplit("/", 1)[-1] for reply in replies if reply.ok is not None}

    def alive(self) -> zenoh.LivelinessToken:
        """Declare a liveliness token, which disappears with this service."""
        return self.session.liveliness().declare_token(self.key(f"alive/{self.service}"))


# Queries of services to each other, and replies that are pending.


@dataclass
class Query:
    """One query to a service, which has to be answered exactly once."""

    name: str
    key: str
    query: zenoh.Query

    @property
    def payload(self) -> bytes:
        return self.query.payload.to_bytes() if self.query.payload is not None else b""

    def json(self) -> dict[str, Any]:
        """Return the payload as a mapping; anything else counts as empty."""
        try:
            value = json.loads(self.payload)
        except (ValueError, RecursionError):
            return {}
        return value if isinstance(value, dict) else {}

    def refuse(self, problem: str) -> None:
        """Reply with an error."""
        self.query.reply_err(problem)
        self.query.drop()

    def answer(self, payload: bytes) -> None:
        self.query.reply(self.key, payload)
        self.query.drop()

    def answer_json(self, value: dict[str, Any]) -> None:
        self.answer(json.dumps(value).encode())


WAITING_AFTER = 5.0
"""Time of waiting for another service after which a warning is logged [s]."""
SHORTEST, LONGEST = 20e-6, 1e-3
"""First and longest pause between two checks for a reply [s]."""
TIMEOUT = b"Timeout"
"""zenoh's own error reply where none came in time, from any session on the way."""


class Refused(RunFailed):
    """A service refuses a query; `reason` is its text."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.reason = reason


class PendingReply:
    """The pending reply of one query, sent when this is made."""

    def __init__(self, name: str, replies: zenoh.handlers.Handler[zenoh.Reply], timeout: float) -> None:
        """`timeout` is that of zenoh's `replies` [s]."""
        self._name, self._replies, self._timeout = name, replies, timeout
        self._begin = time.monotonic()
        self._duration: float | None = None
        self._reply: zenoh.Reply | None = None

    def arrived(self) -> bool:
        """Return whether the reply has arrived, or none will."""
        if self._duration is None:
            try:
                self._reply = self._replies.try_recv()
            except zenoh.ZError:  # the queryable has gone
                self._end()
            if self._reply is not None:
                self._end()
        return self._duration is not None

    def answer(self, slow: Callable[[], None] | None = None) -> bytes:
        """Wait for the reply; call `slow` once after a long wait. Raises Refused, or RunFailed if none comes."""
        if slow is not None:  # zenoh waits without a limit or not at all
            end = self._begin + WAITING_AFTER
            for pause in pauses():
                if self.arrived() or time.monotonic() > end:
                    break
                time.sleep(pause)
            if not self.arrived():
                slow()
        if not self.arrived():
            with suppress(zenoh.ZError):
                self._reply = self._replies.recv()
            self._end()
        return self._payload()

    def _end(self) -> None:
        self._duration = time.monotonic() - self._begin

    def _payload(self) -> bytes:
        reply = self._reply
        if reply is not None and reply.ok is not None:
            return reply.ok.payload.to_bytes()
        reason = TIMEOUT if reply is None or reply.err is None else reply.err.payload.to_bytes()
        if reason != TIMEOUT:
            raise Refused(self._name, reason.decode(errors="replace"))
        peer = self._name.split("/")[0]
        if self._duration is not None and self._duration < 0.5 * self._timeout:
            problem = "its service is not there, or not yet, or the certificate here does not allow to ask it"
            raise RunFailed(f"nobody answers {self._name}: {problem}", peer=peer)
        raise RunFailed(f"no answer from {self._name} within {self._timeout:.3g} s", peer=peer)


def pauses() -> Iterator[float]:
    """Yield the pauses between checks for a reply [s], from the shortest to the longest."""
    pause = SHORTEST
    while True:
        yield pause
        pause = min(2.0 * pause, LONGEST)
