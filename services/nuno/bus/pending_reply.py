"""A question that is on its way to a service of the run, and its answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress

import zenoh

from nuno_schemas.errors import RunFailed

WAITING_AFTER = 5.0
"""Whoever waits this long [s] for another service says so."""
SHORTEST, LONGEST = 20e-6, 1e-3
"""Pauses [s] between two looks for an answer, first and at last."""
TIMEOUT = b"Timeout"
"""zenoh's own answer, of whichever session on the way, where none came in time."""


class Refused(RunFailed):
    """A service answers that it does not do what it was asked for; `said` is why, in its words."""

    def __init__(self, name: str, said: str) -> None:
        super().__init__(f"{name}: {said}")
        self.said = said


class PendingReply:
    """One question, on its way from when this is made."""

    def __init__(self, name: str, replies: zenoh.handlers.Handler[zenoh.Reply], timeout: float) -> None:
        """`timeout` [s] is that of zenoh's `replies`."""
        self._name, self._replies, self._timeout = name, replies, timeout
        self._begin = time.monotonic()
        self._took: float | None = None
        self._reply: zenoh.Reply | None = None

    def there(self) -> bool:
        """Whether the answer has come, or none will."""
        if self._took is None:
            try:
                self._reply = self._replies.try_recv()
            except zenoh.ZError:  # who could have answered has gone
                self._end()
            if self._reply is not None:
                self._end()
        return self._took is not None

    def answer(self, slow: Callable[[], None] | None = None) -> bytes:
        """Wait for it; `slow` is called once where that takes long. Raises Refused, or RunFailed if none comes."""
        if slow is not None:  # zenoh waits without a limit or not at all
            end = self._begin + WAITING_AFTER
            for pause in pauses():
                if self.there() or time.monotonic() > end:
                    break
                time.sleep(pause)
            if not self.there():
                slow()
        if not self.there():
            with suppress(zenoh.ZError):
                self._reply = self._replies.recv()
            self._end()
        return self._said()

    def _end(self) -> None:
        self._took = time.monotonic() - self._begin

    def _said(self) -> bytes:
        reply = self._reply
        if reply is not None and reply.ok is not None:
            return reply.ok.payload.to_bytes()
        said = TIMEOUT if reply is None or reply.err is None else reply.err.payload.to_bytes()
        if said != TIMEOUT:
            raise Refused(self._name, said.decode(errors="replace"))
        peer = self._name.split("/")[0]
        if self._took is not None and self._took < 0.5 * self._timeout:
            problem = "its service is not there, or not yet, or the certificate here does not allow to ask it"
            raise RunFailed(f"nobody answers {self._name}: {problem}", peer=peer)
        raise RunFailed(f"no answer from {self._name} within {self._timeout:.3g} s", peer=peer)


def pauses() -> Iterator[float]:
    """Times [s] between one look for an answer and the next."""
    pause = SHORTEST
    while True:
        yield pause
        pause = min(2.0 * pause, LONGEST)
