"""A run that goes on, as it is heard on its bus."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nuno.api.words import in_python
from nuno.bus.encodings import decode_arrays, decode_picture, decode_points
from nuno.bus.liveliness import Watch
from nuno.bus.messages import ALL, Bus, Inbox, Message
from nuno.bus.sessions import spoke
from nuno.service import SUPERVISOR
from nuno.supervision import runs
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.messages import MODELS, PICTURE, REPORT, STATE, TOPICS

TOKENS_SECONDS = 2.0
"""How long it may take to see those alive that are [s]."""
LISTENING = 0.2
"""How often it is asked whether the run is over while nothing comes [s]."""


@dataclass(frozen=True)
class Heard:
    """A message of a run.

    topic, frame and t [s] are those that it was sent with; skipped is how many of this topic were missed before it.
    value is what it says: of `sim/state` positions (n, 3) [m], of float32's precision; of arrays a pair, arrays by name
    and a mapping of what is none; of a picture the bytes of a PNG; of the others an object of nuno_schemas.messages:
    Status, DyeStatus, Penetration, Event or Ack.
    """

    topic: str
    frame: int
    t: float
    value: Any
    skipped: int


class Watching:
    """What is heard of a run, from when this is made until it ends: an iterator of `Heard`, which can be closed."""

    def __init__(self, run: str, endpoint: str, topics: tuple[str, ...], config: str | None, announced: bool) -> None:
        """announced: whether the run is one of this machine's, whose services may still be on their way."""
        self._topics, self._stack, self._over = topics, contextlib.ExitStack(), False
        with in_python():
            bus = Bus(self._stack.enter_context(spoke(endpoint, config)), run, "watch")
        self._stack.callback(bus.close)
        self._inbox = Inbox(bus, [ALL], newest_only=True)
        # Once this is answered, the hub knows of who listens; a session that watches would answer by itself, too early.
        present = bus.present()
        self._life = Watch(bus)
        self._life.wait_for(present, TOKENS_SECONDS)
        if not present and not announced:
            self.close()
            remedy = "check the run's id, as it was told where it was started"
            raise BadInput("no such run is going on there", field="run", value=run, limit=endpoint, remedy=remedy)
        self._own = run if announced else ""

    def __iter__(self) -> Watching:
        return self

    def __next__(self) -> Heard:
        while not self._over:
            item = self._inbox.get(LISTENING)
            if not isinstance(item, Message):
                if self._life.gone(SUPERVISOR) or not (self._life.alive() or self._own in runs.running()):
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
        """Listen no more."""
        self._over = True
        self._stack.close()

    def __enter__(self) -> Watching:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()


def watch(run: str = "last", *topics: str, connect: str | None = None, config: str | None = None) -> Watching:
    """Messages of a run as they come, decoded, until it ends: for heard in nuno.watch("last", "sim/state"). Whoever may
    leave before that closes it: with nuno.watch("last") as heard.

    run: its id or the beginning of that; topics: only these, or what is below them, as "run/event" (default: all); who
    listens late has missed what was said before. connect and config: endpoint and zenoh configuration, for a run on
    another host. A listener never holds up a run, and sees gaps where it does not keep up. Raises BadInput for a run
    that does not go on and a topic that there is not; RunFailed where it cannot be reached.
    """
    with in_python():
        known = [name for name in TOPICS if name != REPORT.name]
        for topic in topics:
            if not isinstance(topic, str) or not any(_below(topic, name) for name in known):
                raise BadInput("no such topic", field="topics", value=topic, remedy=nearest(str(topic), known))
        if connect and run == runs.LAST:
            problem, remedy = "which run of another host is meant is not said", "give its id, as it was told there"
            raise BadInput(problem, field="run", value=run, remedy=remedy)
        name, endpoint = (run, connect) if connect else runs.find(run)
    return Watching(name, endpoint, topics, config, announced=not connect)


def _below(topic: str, name: str) -> bool:
    return topic == name or topic.startswith(f"{name}/")


def _decoder(topic: str) -> Callable[[bytes], Any]:
    schema = next((known.schema for name, known in TOPICS.items() if _below(topic, name)), "")
    if schema in MODELS:
        return MODELS[schema].model_validate_json
    return {STATE.schema: decode_points, PICTURE.schema: decode_picture}.get(schema, decode_arrays)
