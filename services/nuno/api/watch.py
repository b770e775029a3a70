"""Messages of a running simulation, from its bus."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nuno.api.words import in_python
from nuno.bus.encodings import decode_arrays, decode_picture, decode_points
from nuno.bus.health import Watch
from nuno.bus.messages import ALL, Bus, Inbox, Message
from nuno.bus.sessions import spoke
from nuno.runtime import runs
from nuno.runtime.service import SUPERVISOR
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.messages import MODELS, PICTURE, REPORT, STATE, TOPICS

TOKENS_SECONDS = 2.0
"""Longest wait for the liveliness tokens of the present services [s]."""
LISTENING = 0.2
"""Interval of the checks for the run's end while no message arrives [s]."""


@dataclass(frozen=True)
class Heard:
    """A message of a run.

    topic, frame and t [s] are from its header; skipped is the number of lost messages of this topic directly before it.
    value is its content: for `sim/state` positions (n, 3) [m], with float32's precision; for arrays a pair, arrays by
    name and a mapping of other fields; for a picture the bytes of a PNG; for others an object of nuno_schemas.messages:
    Status, DyeStatus, Penetration, Event or Ack.
    """

    topic: str
    frame: int
    t: float
    value: Any
    skipped: int


class Watching:
    """An iterator of a run's messages, as `Heard`, from its construction to the run's end; it can be closed."""

    def __init__(self, run: str, endpoint: str, topics: tuple[str, ...], config: str | None, announced: bool) -> None:
        """announced: whether the run is on this machine, where its services may still be starting."""
        self._topics, self._stack, self._closed = topics, contextlib.ExitStack(), False
        with in_python():
            bus = Bus(self._stack.enter_context(spoke(endpoint, config)), run, "watch")
        self._stack.callback(bus.close)
        self._inbox = Inbox(bus, [ALL], newest_only=True)
        # After this reply, the hub knows the subscriber; a `Watch` in the session would reply itself, too early.
        present = bus.present()
        self._life = Watch(bus)
        self._life.wait_for(present, TOKENS_SECONDS)
        if not present and not announced:
            self.close()
            remedy = "check the run's id, as printed where it was started"
            raise BadInput("no such run is going on there", field="run", value=run, limit=endpoint, remedy=remedy)
        self._local_run = run if announced else ""

    def __iter__(self) -> Watching:
        return self

    def __next__(self) -> Heard:
        while not self._closed:
            item = self._inbox.get(LISTENING)
            if not isinstance(item, Message):
                if self._life.gone(SUPERVISOR) or not (self._life.alive() or self._local_run in runs.running()):
                    self.close()
            elif not self._topics or any(_below(item.topic, one) for one in self._topics):
                try:
                    value = _decoder(item.topic)(item.payload)
                except ValueError:  # BadMessage is one
                    self._inbox.refuse(item)
                    continue
                return Heard(item.topic, item.header.frame, item.header.t, value, item.skipped)
        raise StopIteration

    def close(self) -> None:
        """End the subscription."""
        self._closed = True
        self._stack.close()

    def __enter__(self) -> Watching:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()


def watch(run: str = "last", *topics: str, connect: str | None = None, config: str | None = None) -> Watching:
    """Iterate over a run's messages, decoded, until it ends: for heard in nuno.watch("last", "sim/state"). To leave
    earlier, close it: with nuno.watch("last") as heard.

    run: its id or the beginning of that; topics: only these, or those below them, as "run/event" (default: all);
    earlier messages are not repeated. connect and config: endpoint and zenoh configuration, for a run on another host.
    A subscriber never delays a run, and has gaps if it does not keep up. Raises BadInput for a run that does not go on
    and an unknown topic; RunFailed where the run cannot be reached.
    """
    with in_python():
        published = [name for name in TOPICS if name != REPORT.name]
        for topic in topics:
            if not isinstance(topic, str) or not any(_below(topic, name) for name in published):
                raise BadInput("no such topic", field="topics", value=topic, remedy=nearest(str(topic), published))
        if connect and run == runs.LAST:
            problem, remedy = "which run of another host is meant is not said", "give its id, as printed there"
            raise BadInput(problem, field="run", value=run, remedy=remedy)
        name, endpoint = (run, connect) if connect else runs.find(run)
    return Watching(name, endpoint, topics, config, announced=not connect)


def _below(topic: str, name: str) -> bool:
    return topic == name or topic.startswith(f"{name}/")


def _decoder(topic: str) -> Callable[[bytes], Any]:
    schema = next((listed.schema for name, listed in TOPICS.items() if _below(topic, name)), "")
    if schema in MODELS:
        return MODELS[schema].model_validate_json
    return {STATE.schema: decode_points, PICTURE.schema: decode_picture}.get(schema, decode_arrays)
