"""Queries of services to each other, and replies that are pending."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import zenoh

from nuno_schemas.errors import RunFailed

# A query to a service.


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
