"""Looks after frames while they are stepped: leaves one that is no longer wanted, and says what holds one that takes
too long. Whoever steps is in compiled code meanwhile, and hears nothing.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from statistics import median

import numpy as np

from nuno.bus.query import Query
from nuno.service import Context

PATIENCE = 0.3
"""How long a frame, or what precedes the first one, may go on once the run is to stop [s]."""
LOOKS = 0.1
"""How often it is looked [s]."""
LONG, LEAST, KNOWN = 100.0, 5.0, 3
"""A frame takes too long from so many times the median of those before on, and from so many seconds; as long as fewer
frames are known than the last says, nothing is usual.
"""
LATEST = 50
"""Frames whose median that is."""


class FrameWatchdog:
    """A thread that looks after one service's steps, from its start to `close`."""

    def __init__(self, context: Context) -> None:
        self._context, self.leave = context, np.zeros(1, np.int64)
        """(1,) for whatever takes steps; see nuno_schemas.system.System"""
        self._asked: float | None = None
        self._began: float | None = time.monotonic()
        """When the present frame began; at first, the preparation."""
        self._frame, self._said, self._t = 0, True, 0.0
        self._taken: deque[float] = deque(maxlen=LATEST)
        self._lock, self._over = threading.Lock(), threading.Event()
        self.holds: Callable[[], str] = str
        """What holds the present frame, in words, as far as the solver knows."""
        threading.Thread(target=self._look, name=f"{context.bus.service} attendant", daemon=True).start()

    def hear(self, question: Query) -> None:
        """Note a question that ends the run, from whichever thread it arrives in."""
        if question.name.startswith("finish/") or question.json().get("action") == "stop":
            self._asked = self._asked or time.monotonic()

    def prepared(self) -> None:
        """Nothing is being worked out until the next frame."""
        with self._lock:
            self._began = None

    @contextmanager
    def frame(self, last: int, t: float) -> Iterator[None]:
        """While the frame after the last one is stepped, which ended at t [s]."""
        with self._lock:
            self._began, self._frame, self._t, self._said = time.monotonic(), last, t, False
        try:
            yield
        finally:
            with self._lock:
                self._taken.append(time.monotonic() - (self._began or 0.0))
                self._began = None

    def close(self) -> None:
        """Look no more."""
        self._over.set()

    def _look(self) -> None:
        while not self._over.wait(LOOKS):
            now = time.monotonic()
            if gone := self._context.orphaned():
                self._asked = self._asked or now
            with self._lock:
                late = self._asked is not None and now - self._asked > PATIENCE
                if late and self._began is not None:
                    self.leave[0] = 1
                if late and (gone or self.leave[0]):
                    return
                if self._began is None:
                    continue
                taken, usual = now - self._began, median(self._taken) if len(self._taken) >= KNOWN else None
                if self._said or usual is None or taken < max(LEAST, LONG * usual):
                    continue
                self._said = True
            text = f"frame {self._frame + 1} has taken {taken:.3g} s so far, {taken / usual:.0f} times the usual"
            why = self.holds()
            self._context.event("warning", text + (f": {why}" if why else ""), self._frame, self._t)
