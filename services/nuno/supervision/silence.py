"""Says where frames stay away: a step may take long, or a plugin never return."""

from __future__ import annotations

import time
from collections.abc import Callable

from nuno.wire.bus import Bus
from nuno_schemas.errors import RunFailed

QUIET_SECONDS = 60.0
"""So long without a frame, nor an answer, and it is said."""
ANSWER_SECONDS = 0.5
"""A service that is paused, or waits, answers at once; within a frame none does."""


class Silence:
    """Watches the frames of the service that leads."""

    def __init__(self, bus: Bus, leader: str) -> None:
        self._bus, self._leader = bus, leader
        self._frame, self._heard, self._said = 0, time.monotonic(), False

    def hear(self, frame: int) -> None:
        """A frame came."""
        self._frame, self._heard, self._said = frame, time.monotonic(), False

    def look(self, say: Callable[[str], None]) -> None:
        """Say it, once for each frame, where nothing has come of the next one for long."""
        if self._said or time.monotonic() - self._heard < QUIET_SECONDS:
            return
        try:
            self._bus.ask("control", b'{"action": "status"}', ANSWER_SECONDS)
            self._heard = time.monotonic()
        except RunFailed:
            self._said = True
            say(
                f"no frame for {QUIET_SECONDS:g} s: the {self._leader} service is still in frame {self._frame + 1}; "
                "a step may take long, or a plugin may never return. To end the run: Ctrl-C"
            )
