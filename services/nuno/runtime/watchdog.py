"""Watchdog of frames while they are stepped: it abandons a frame when the run is to end, and warns of one that takes
too long. The stepping thread is in compiled code meanwhile, and reads no messages.
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
from nuno.runtime.service import Context

PATIENCE = 0.3
"""Longest time that a frame, or the preparation, may go on once the run is to stop [s]."""
CHECK_INTERVAL = 0.1
"""Interval of the checks [s]."""
LONG, LEAST, KNOWN = 100.0, 5.0, 3
"""A frame takes too long beyond this multiple of the median of earlier frames, and this time [s]; the median needs at
least this many frames.
"""
LATEST = 50
"""Number of earlier frames in the median."""


class FrameWatchdog:
    """A thread that watches one service's steps, from its start to `close`."""

    def __init__(self, context: Context) -> None:
        self._context, self.leave = context, np.zeros(1, np.int64)
        """(1,) nonzero tells a solver to abandon its frame, as `nuno_schemas.system.System.leave`."""
        self._end_asked_at: float | None = None
        self._began: float | None = time.monotonic()
        """Start of the present frame, at first of the preparation [s]; None between frames."""
        self._frame, self._warned, self._t = 0, True, 0.0
        self._durations: deque[float] = deque(maxlen=LATEST)
        self._lock, self._closed = threading.Lock(), threading.Event()
        self.holds: Callable[[], str] = str
        """Returns what delays the present frame, in words, as far as the solver knows."""
        threading.Thread(target=self._watch, name=f"{context.bus.service} watchdog", daemon=True).start()

    def note_query(self, query: Query) -> None:
        """Record a query that ends the run; any thread may call this."""
        if query.name.startswith("finish/") or query.json().get("action") == "stop":
            self._end_asked_at = self._end_asked_at or time.monotonic()

    def prepared(self) -> None:
        """End the preparation: nothing is computed until the next frame."""
        with self._lock:
            self._began = None

    @contextmanager
    def frame(self, last: int, t: float) -> Iterator[None]:
        """Watch the frame after `last`, which ended at t [s], while it is stepped."""
        with self._lock:
            self._began, self._frame, self._t, self._warned = time.monotonic(), last, t, False
        try:
            yield
        finally:
            with self._lock:
                self._durations.append(time.monotonic() - (self._began or 0.0))
                self._began = None

    def close(self) -> None:
        """End the thread."""
        self._closed.set()

    def _watch(self) -> None:
        while not self._closed.wait(CHECK_INTERVAL):
            now = time.monotonic()
            if orphaned := self._context.orphaned():
                self._end_asked_at = self._end_asked_at or now
            with self._lock:
                late = self._end_asked_at is not None and now - self._end_asked_at > PATIENCE
                if late and self._began is not None:
                    self.leave[0] = 1
                if late and (orphaned or self.leave[0]):
                    return
                if self._began is None:
                    continue
                elapsed, typical = now - self._began, median(self._durations) if len(self._durations) >= KNOWN else None
                if self._warned or typical is None or elapsed < max(LEAST, LONG * typical):
                    continue
                self._warned = True
            text = f"frame {self._frame + 1} has taken {elapsed:.3g} s so far, {elapsed / typical:.0f} times the usual"
            reason = self.holds()
            self._context.event("warning", text + (f": {reason}" if reason else ""), self._frame, self._t)
