"""What every service of a run shares: its context, its life, and how it ends.

A service declares its liveliness token once it listens, works until it is asked to finish, and
answers that question with its counts. If it raises, the error goes out as an event and the token
disappears, which ends the run; if the supervisor disappears, it ends by itself.
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

from nuno.bus.health import offer_health
from nuno.bus.liveliness import Watch
from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.query import Query
from nuno.consistency import offer_premises
from nuno.process import SIGNALS, state_of, working_folder
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import EVENT, Ack, Event, Topic

SUPERVISOR = "supervisor"
MODULES = {
    "simulation": "nuno.simulation.service",
    "dye": "nuno.dye.service",
    "collision": "nuno.collision.service",
    "render": "nuno.render.service",
    "recorder": "nuno.recording.service",
    "viewer": "nuno.viewer.service",
}
"""Services by name; a module is imported only where its service runs. Each has `main(context)`."""


LOOK_SECONDS = 0.5
"""How often a service to which nothing comes looks whether it is still needed."""


@dataclass
class Options:
    """What the user chose for a run, beside the scene."""

    record: Path | None = None
    save: Path | None = None
    """A rerun file to write."""
    view: str | None = None
    """"window" or "web": show the run live; None: do not."""
    resume: Path | None = None
    threads: int = 0
    """Most threads for kernels; 0 = all."""
    must_see: tuple[str, ...] = ()
    """Services that acknowledge every frame before the simulation runs far ahead."""
    temporary: bool = False
    """Whether the recording is not to be kept."""
    real_time: bool = False
    """Whether frames wait for the clock."""
    folder: Path = field(default_factory=lambda: Path(working_folder()))
    """Where paths begin: all threads share the working folder, and a plugin may leave it at any moment."""

    def __post_init__(self) -> None:
        if type(self.threads) is not int or self.threads < 0:
            problem, remedy = "the number of threads is a whole number, not negative", "0 stands for all cores"
            raise BadInput(problem, field="--threads", value=self.threads, limit="at least 0", remedy=remedy)


@dataclass
class Context:
    """A service's view of its run."""

    loaded: Loaded
    bus: Bus
    options: Options
    stop: threading.Event = field(default_factory=threading.Event)
    """Set when the supervisor needs this service no more, though it may never have become ready."""
    watch: Watch = field(init=False)

    def __post_init__(self) -> None:
        self.watch = Watch(self.bus)

    def event(self, kind: str, text: str, frame: int = -1, t: float = 0.0, **args: Any) -> None:
        """Tell the run (and its recording) that something happened."""
        event = Event.model_validate(
            {"frame": frame, "t": t, "service": self.bus.service, "kind": kind, "text": text, "args": args}
        )
        self.bus.publisher(_event_topic(self.bus.service)).put(event.model_dump_json().encode(), frame, t)

    def acknowledge(self, frame: int, t: float) -> None:
        """Say that this service, which must see every frame, has handled one."""
        ack = Ack(service=self.bus.service, frame=frame)
        self.bus.publisher(ack_topic(self.bus.service)).put(ack.model_dump_json().encode(), frame, t)

    def orphaned(self) -> bool:
        """Whether the supervisor was there and has gone."""
        return self.stop.is_set() or self.watch.gone(SUPERVISOR)

    def require_supervisor(self) -> None:
        """Raises RunFailed where the supervisor was there and has gone."""
        if self.orphaned():
            raise RunFailed("the supervisor has gone: its run ended without this service, or its process did")

    def counts(self, inbox: Inbox | None = None) -> dict[str, Any]:
        """What this service sent and saw, for the report."""
        counts: dict[str, Any] = {"sent": {name: p.sent for name, p in self.bus.publishers.items()}}
        counts["bus_seconds"] = sum(p.seconds for p in self.bus.publishers.values())
        if inbox is not None:
            counts |= inbox.counts.told()
        return counts


def _event_topic(service: str) -> Topic:
    """Every service numbers its own events."""
    return Topic(f"{EVENT.name}/{service}", EVENT.encoding, EVENT.schema)


def ack_topic(service: str) -> Topic:
    return Topic(f"ack/{service}", "json", "nuno.Ack", recorded=False)


class Finish(BaseModel):
    """The question that ends a service; the recorder's holds what else it needs to close the file."""

    model_config = ConfigDict(strict=True)
    error: str = ""
    discard: bool = False
    expected: dict[str, int] = {}
    """Messages sent per topic."""
    state: str = "done"
    report: dict[str, Any] | None = None

    @property
    def failure(self) -> str:
        """Why the run failed; empty where it did not."""
        return self.error or ("" if self.state in ("done", "stopped") else f"it ended as {self.state}")


def asks_to_finish(inbox: Inbox, question: Query) -> bool:
    """Whether the run is over; a question that cannot be read is refused and counted."""
    try:
        inbox.failure = Finish.model_validate_json(question.payload).failure
    except ValidationError as error:
        inbox.refuse(question)
        question.refuse(f"not a question to finish: {error.errors(include_url=False)[0]['msg']}")
        return False
    return True


def each_message(
    context: Context,
    inbox: Inbox,
    handle: Callable[[Message], None],
    answer: Callable[[Query], None] | None = None,
    between: Callable[[], float] = lambda: LOOK_SECONDS,
) -> Query:
    """Be alive, handle messages and questions as they come, until asked to finish.

    `between` is called between two of them; it says for how long [s] the next may be waited for, at most LOOK_SECONDS.
    Returns that last question, still to be answered. Raises RunFailed if the supervisor goes.
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
    """Run one service until it is asked to finish, or `stop`; why the run failed, empty where it did not. Raises what
    the service raised.
    """
    bus = Bus(session, run, name)
    offer_health(bus)
    offer_premises(bus, loaded, options.resume is not None)
    context = Context(loaded, bus, options, stop or threading.Event())
    try:
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
