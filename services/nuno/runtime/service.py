"""Common parts of all services of a run: context, life cycle, end.

A service declares its liveliness token once it listens, works until it is asked to finish, and
replies to that query with its counts. If it raises, the error is published as an event and the token
disappears, which ends the run; if the supervisor disappears, the service ends by itself.
"""

from __future__ import annotations

import importlib
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh
from pydantic import BaseModel, ConfigDict, ValidationError

from nuno.bus.health import Watch, offer_health
from nuno.bus.messages import Bus, Inbox, Message, Query
from nuno.plugin_contract import containment
from nuno.process import SIGNALS, state_of, working_folder
from nuno.runtime.consistency import offer_premises
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import EVENT, Ack, Event, Topic

SUPERVISOR = "supervisor"
MODULES = {
    "simulation": "nuno.simulation.service",
    "dye": "nuno.dye.service",
    "collision": "nuno.collision.service",
    "render": "nuno.render.service",
    "recorder": "nuno.recorder.service",
    "viewer": "nuno.viewer.service",
}
"""Modules of the services by name; each has `main(context)`, and is imported only where its service runs."""


LOOK_SECONDS = 0.5
"""Interval of an idle service's checks whether the run goes on [s]."""


def check_threads(threads: int) -> None:
    """Raise BadInput for what is no number of threads."""
    if type(threads) is not int or threads < 0:
        problem, remedy = "the number of threads is a whole number, not negative", "0 stands for all cores"
        raise BadInput(problem, field="--threads", value=threads, limit="at least 0", remedy=remedy)


@dataclass
class Options:
    """Options of a run that are not part of its scene."""

    record: Path | None = None
    save: Path | None = None
    """A rerun file to write."""
    view: str | None = None
    """"window" or "web" show the run live; None shows nothing."""
    resume: Path | None = None
    threads: int = 0
    """Most threads for kernels; 0 = all."""
    must_see: tuple[str, ...] = ()
    """Services that acknowledge every frame; the simulation waits for them."""
    temporary: bool = False
    """Whether the recording is removed later."""
    real_time: bool = False
    """Whether frames wait for the clock."""
    folder: Path = field(default_factory=lambda: Path(working_folder()))
    """Base of relative paths: all threads share the working folder, and a plugin may change it at any time."""

    def __post_init__(self) -> None:
        check_threads(self.threads)


@dataclass
class Context:
    """A service's view of its run."""

    loaded: Loaded
    bus: Bus
    options: Options
    stop: threading.Event = field(default_factory=threading.Event)
    """Set when the supervisor no longer needs this service, even before it is ready."""
    watch: Watch = field(init=False)

    def __post_init__(self) -> None:
        self.watch = Watch(self.bus)

    def event(self, kind: str, text: str, frame: int = -1, t: float = 0.0, **args: Any) -> Event:
        """Publish an event to the run and its recording, and return it."""
        event = Event.model_validate(
            {"frame": frame, "t": t, "service": self.bus.service, "kind": kind, "text": text, "args": args}
        )
        topic = Topic(f"{EVENT.name}/{self.bus.service}", EVENT.encoding, EVENT.schema)  # its own, which it numbers
        self.bus.publisher(topic).put(event.model_dump_json().encode(), frame, t)
        return event

    def acknowledge(self, frame: int, t: float) -> None:
        """Acknowledge a frame that this service has handled."""
        ack = Ack(service=self.bus.service, frame=frame)
        self.bus.publisher(ack_topic(self.bus.service)).put(ack.model_dump_json().encode(), frame, t)

    def orphaned(self) -> bool:
        """Return whether the supervisor was alive and has gone."""
        return self.stop.is_set() or self.watch.gone(SUPERVISOR)

    def require_supervisor(self) -> None:
        """Raise RunFailed if the supervisor was alive and has gone."""
        if self.orphaned():
            raise RunFailed("the supervisor has gone: its run ended without this service, or its process did")

    def counts(self, inbox: Inbox | None = None) -> dict[str, Any]:
        """Return counts of sent and received messages, for the report."""
        counts: dict[str, Any] = {"sent": {name: p.sent for name, p in self.bus.publishers.items()}}
        counts["bus_seconds"] = sum(p.seconds for p in self.bus.publishers.values())
        if inbox is not None:
            counts |= inbox.counts.nonzero()
        return counts


def ack_topic(service: str) -> Topic:
    return Topic(f"ack/{service}", "json", "nuno.Ack", recorded=False)


class Finish(BaseModel):
    """The query that ends a service; the recorder's has the counts for the file."""

    model_config = ConfigDict(strict=True)
    error: str = ""
    discard: bool = False
    expected: dict[str, int] = {}
    """Messages sent by topic."""
    state: str = "done"
    report: dict[str, Any] | None = None
    """The recorder's and the viewer's."""
    loop: bool = False
    """Whether a live viewer plays the frames again and again, once it has all."""

    @property
    def failure(self) -> str:
        """Reason of the run's failure; empty if it did not fail."""
        return self.error or ("" if self.state in ("done", "stopped") else f"it ended as {self.state}")


def asks_to_finish(inbox: Inbox, query: Query) -> bool:
    """Return whether the query ends the run; an invalid one is refused and counted."""
    try:
        inbox.failure = Finish.model_validate_json(query.payload).failure
    except ValidationError as error:
        inbox.refuse(query)
        query.refuse(f"not a question to finish: {error.errors(include_url=False)[0]['msg']}")
        return False
    return True


def each_message(
    context: Context,
    inbox: Inbox,
    handle: Callable[[Message], None],
    answer: Callable[[Query], None] | None = None,
    between: Callable[[], float] = lambda: LOOK_SECONDS,
) -> Query:
    """Declare the service alive, and handle messages and queries until the query to finish.

    `between` is called between two of them; it returns the longest wait for the next [s], at most LOOK_SECONDS.
    Returns that last query, which is not answered yet. Raises RunFailed if the supervisor goes.
    """
    finish = f"finish/{context.bus.service}"
    inbox.answer(finish)
    with context.bus.alive():
        while True:
            item = inbox.get(between())
            if isinstance(item, Message):
                handle(item)
            elif isinstance(item, Query):
                if item.name == finish:
                    if asks_to_finish(inbox, item):
                        return item
                elif answer is not None:
                    answer(item)
            else:
                context.require_supervisor()


def run_service(
    name: str, loaded: Loaded, session: zenoh.Session, run: str, options: Options, stop: threading.Event | None = None
) -> str:
    """Run one service until the query to finish, or `stop`; return the reason of the run's failure, "" if it did not
    fail. Raises the service's own errors.
    """
    bus = Bus(session, run, name)
    offer_health(bus)
    offer_premises(bus, loaded, options.resume is not None, options.real_time)
    context = Context(loaded, bus, options, stop or threading.Event())
    try:
        with containment.serving(run):
            importlib.import_module(MODULES[name]).main(context)
    except BadInput as error:
        context.event("error", str(error), bad_input=True)
        raise
    except RunFailed as error:
        args: dict[str, Any] = {"trace": traceback.format_exc()} if error.__cause__ is not None else {}
        context.event("error", str(error), peer=error.peer, **args)
        raise
    except KeyboardInterrupt as error:
        context.event("error", f"ended by {SIGNALS[state_of(error)]}")
        raise
    except BaseException as error:
        context.event("error", f"{type(error).__name__}: {error}", trace=traceback.format_exc())
        raise
    finally:
        bus.close()
    return next((inbox.failure for inbox in bus.inboxes if inbox.failure), "")
