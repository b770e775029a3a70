"""Liveliness of the services of a run."""

from __future__ import annotations

import threading

import zenoh

from nuno.bus.messages import Bus
from nuno.bus.sessions import direct


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
