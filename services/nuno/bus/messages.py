"""The message bus: numbered messages, checked inboxes, who is alive."""

from __future__ import annotations

import json
import math
import queue
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import zenoh
from pydantic import ValidationError

from nuno.bus.pending_reply import PendingReply
from nuno.bus.query import Query
from nuno.bus.sessions import direct
from nuno_schemas import SCHEMA_VERSION
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import POSES, Header, Topic

ALL = Topic("**", "json", "")
"""One subscription to all topics: between several, messages overtake each other."""
FURTHEST = 100_000
"""A message this far ahead of the last is none of the run's: believing it would refuse all others."""


@dataclass
class Message:
    """One message as it arrived."""

    topic: str
    header: Header
    payload: bytes
    skipped: int = 0
    """Messages missing just before this one."""


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
    """Last one published."""
    t: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock)

    def put(self, payload: bytes, frame: int = -1, t: float = 0.0, digest: str = "") -> None:
        with self.lock:
            start = time.perf_counter()
            header = Header(run=self.bus.run, service=self.bus.service, seq=self.sent, frame=frame, t=t, digest=digest)
            self.handle.put(payload, attachment=header.model_dump_json())
            self.sent += 1
            self.payload_bytes += len(payload)
            self.frame, self.t = max(self.frame, frame), t if frame >= 0 else self.t
            self.seconds += time.perf_counter() - start


@dataclass
class Counts:
    """What an inbox saw: per topic received, and what was refused."""

    received: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    missing: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    refused: dict[str, int] = field(default_factory=lambda: defaultdict(int))

    def told(self) -> dict[str, dict[str, int]]:
        """Each of them by its name, of those topics that have any."""
        return {name: {topic: n for topic, n in counts.items() if n} for name, counts in vars(self).items()}


class Inbox:
    """Messages of some topics, and questions, as they arrive; checked and counted.

    The order holds within a subscription; between topics subscribed to apart zenoh keeps none.

    A callback only enqueues: work there would delay every message behind it in the session.
    Malformed, foreign, repeated and out-of-order messages are dropped and counted; a gap in the
    numbers is counted as missing. The queue is bounded by the lockstep, not by a limit here. Who takes
    the `newest_only` listens in from outside, and may be left open by a program that ends.
    """

    def __init__(
        self, bus: Bus, topics: list[Topic], newest_only: bool = False,
        heard: Callable[[Query], None] = lambda question: None,
    ) -> None:  # fmt: skip
        """`heard` is called with each question as it comes, in whichever thread brings it."""
        self.counts = Counts()
        self.payload_bytes = 0
        self.frame = -1
        """Last one taken in."""
        self.failure = ""
        """Why the run failed, as the question that ended it says."""
        self._bus = bus
        self._next: dict[str, int] = {}
        self._queue: queue.SimpleQueue[zenoh.Sample | Query | None] = queue.SimpleQueue()
        self._newest_only, self._heard = newest_only, heard
        bus.inboxes.append(self)
        self._closing = threading.Lock()
        self._closed = False
        take = direct(self._queue.put) if newest_only else self._queue.put
        self._handles: list[Any] = [bus.session.declare_subscriber(bus.key(t.name), take) for t in topics]

    def answer(self, name: str) -> None:
        """Let questions to `name` in, too."""
        key = self._bus.key(name)
        self._handles.append(self._bus.session.declare_queryable(key, lambda query: self._ask(Query(name, key, query))))

    def _ask(self, question: Query) -> None:
        """Take a question in; one that was on its way while the inbox closed is dropped, as those that waited were."""
        with self._closing:
            if not self._closed:
                self._queue.put(question)
                self._heard(question)
                return
        question.query.drop()

    def wake(self) -> None:
        """Let whoever waits here look after something else."""
        self._queue.put(None)

    def get(self, timeout: float) -> Message | Query | None:
        """The next question or good message, or None when the time [s] is over, or to look after something else."""
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
        """What has come and is not taken in yet."""
        return self._queue.qsize()

    def refuse(self, item: Message | Query) -> None:
        """Drop what is not what its topic promises, and count it.

        A message's number is expected again: the one that it belongs to may still come.
        """
        if isinstance(item, Query):
            self.counts.refused[item.name] += 1
            return
        self.counts.refused[item.topic] += 1
        self.counts.received[item.topic] -= 1
        self.counts.missing[item.topic] -= item.skipped
        self._next[item.topic] = item.header.seq - item.skipped

    def close(self) -> None:
        """Take in nothing more; whoever waits for an answer learns at once that none comes."""
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
        if topic.startswith(f"{POSES.name}/"):  # from outside, and for the collision service alone
            return None
        try:
            if sample.attachment is None:
                raise ValueError("no header")
            header = Header.model_validate_json(sample.attachment.to_bytes())
        except (ValidationError, ValueError):
            self.counts.refused[topic] += 1
            return None
        expected = self._next.get(topic, header.seq if self._newest_only else 0)
        known = header.run == self._bus.run and header.schema_version == SCHEMA_VERSION
        if not known or not math.isfinite(header.t) or not expected <= header.seq < expected + FURTHEST:
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
    """One service's place in one run."""

    def __init__(self, session: zenoh.Session, run: str, service: str) -> None:
        self.session, self.run, self.service = session, run, service
        self.publishers: dict[str, Publisher] = {}
        self.inboxes: list[Inbox] = []
        self.offers: list[Any] = []
        """What else this service answers, apart from its inboxes."""

    def close(self) -> None:
        """Withdraw everything this service offers: a question to it then fails at once.

        The session may be shared with other services of the process, and goes on.
        """
        for inbox in self.inboxes:
            inbox.close()
        for handle in (*self.offers, *(publisher.handle for publisher in self.publishers.values())):
            handle.undeclare()

    def key(self, name: str) -> str:
        return f"nuno/{self.run}/{name}"

    def publisher(self, topic: Topic) -> Publisher:
        """The one publisher of a topic in this service."""
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
        """The answer of one service's queryable. Raises RunFailed if none comes."""
        return self.ask_ahead(name, payload, timeout).answer()

    def ask_ahead(self, name: str, payload: bytes = b"", timeout: float = 10.0) -> PendingReply:
        """Ask now, and take the answer later."""
        # Not a callback: zenoh starts a thread for each, which takes far longer than the question.
        replies = self.session.get(
            self.key(name), payload=payload, timeout=timeout, congestion_control=zenoh.CongestionControl.BLOCK
        )
        return PendingReply(name, replies, timeout)

    def ask_json(
        self, name: str, value: dict[str, Any], timeout: float = 10.0, slow: Callable[[], None] | None = None
    ) -> dict[str, Any]:
        """The answer of one service's queryable; `slow` as in `PendingReply.answer`. Raises RunFailed if none comes."""
        try:
            answer = json.loads(self.ask_ahead(name, json.dumps(value).encode(), timeout).answer(slow))
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            raise RunFailed(f"the answer of {name} cannot be read", peer=name.split("/")[0])
        return answer

    def present(self, timeout: float = 2.0) -> set[str]:
        """Services that are alive now, asked of the hub."""
        replies = self.session.liveliness().get(self.key("alive/*"), timeout=timeout)
        return {str(reply.ok.key_expr).rsplit("/", 1)[-1] for reply in replies if reply.ok is not None}

    def alive(self) -> zenoh.LivelinessToken:
        """A token that disappears with this service."""
        return self.session.liveliness().declare_token(self.key(f"alive/{self.service}"))
