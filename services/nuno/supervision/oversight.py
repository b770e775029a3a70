"""Watches the services of one run: until they are ready, while they work, and while they finish in order."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

import zenoh

from nuno.bus.health import offer_health
from nuno.bus.liveliness import Watch
from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.sessions import identity
from nuno.bus.slow_consumers import SlowConsumers
from nuno.consistency import check_premises
from nuno.process import SIGNALS
from nuno.scene.coarse_scene import coarser
from nuno.scene.scene_file import Loaded
from nuno.service import SUPERVISOR, Options
from nuno.supervision import log
from nuno.supervision.launch import FINISH_TIMEOUT
from nuno.supervision.plan import Plan
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import DYE_STATUS, EVENT, STATUS, STATUSES, Event, FrameStatus, Topic

# Says where frames stay away: a step may take long, or a plugin never return.

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


START_TIMEOUT, COMPILE_TIMEOUT = 120.0, 1800.0
"""Longest that services may take to be ready [s]: started by hand, which may have been forgotten; and started here,
which are seen to be alive, and on a slow machine's first run compile kernels for minutes."""
FOLLOWERS = ("dye", "collision", "render", "viewer", "recorder")
"""Services in the order in which they finish, after the one that leads."""
DRAWING_TIMEOUT = 3600.0
"""How long pictures that are still to be drawn at the end may take [s]."""
DRAWING = "drawing what is left of the pictures"
UNDRAWN = "the picture that is being drawn is the last (once more, and the run ends at once)"
WRITING_TIMEOUT = 1800.0
"""How long the recorder may take to close its file [s]: a slow disk is still to take what the system has kept."""
PATIENCE_AT_END = {"render": DRAWING_TIMEOUT, "recorder": WRITING_TIMEOUT}
LAST_WORDS = 1.0
"""How long the reason is waited for when a service has gone [s]."""
PREPARING_AFTER = 1.5
"""Preparing that takes this long [s], of much cloth or where kernels are compiled, is said."""
PREPARING = "preparing; what the first run of a kind of scene compiles, the next one finds ready"
SETTLING = "the cloth comes to rest on coarser triangles first"
GONE = "its process ended or the connection broke"
UNSAID = "does not say which scene it has read: it, or the router's rights, are of an older version (see nuno certs)"

Summarise = Callable[[dict[str, dict[str, Any]]], dict[str, Any]]
Progress = Callable[[FrameStatus | str], None]
"""Told each frame's status, and what services have to say."""


class Supervisor:
    """One run, from start to report."""

    def __init__(
        self, loaded: Loaded, options: Options, plan: Plan, session: zenoh.Session, run: str, progress: Progress | None
    ) -> None:
        self.loaded, self.options, self.plan, self.run, self.progress = loaded, options, plan, run, progress
        self.bus = Bus(session, run, SUPERVISOR)
        offer_health(self.bus)
        self.alive = self.bus.alive()
        self.watch = Watch(self.bus)
        self.inbox = Inbox(
            self.bus, [STATUS if loaded.scene.moves else DYE_STATUS, Topic("run/event/*", "json", "nuno.Event")]
        )
        self.errors: dict[str, str] = {}
        self.bad_input: BadInput | None = None
        self.blamed = ""
        self.ended: dict[str, Any] | None = None
        self.patience = START_TIMEOUT
        self.paused, self.recorded = False, False
        self.dispensable = {"viewer"} & set(plan.services)
        """Services without which the run goes on: what they show is no part of its result."""
        self.needed = [name for name in plan.services if name not in self.dispensable]
        self.without: dict[str, str] = {}
        """Services that the run goes on without, and why."""
        self.strange: set[str] = set()
        """Services of this run's name that take no part in it, of which that was said."""
        self.cut_off: Callable[[], str] = str
        """What is wrong with the connection to the hub, "" for nothing."""
        self.broken = ""
        """What was wrong with it as services finished."""
        self.unrecorded: dict[str, int] = {}
        """Messages of each topic that came before the recorder was known to listen: it may have missed them."""
        self.laggards = SlowConsumers(session, {identity(run, name): name for name in plan.services})
        self.silence = Silence(self.bus, plan.leader)
        self.exited: Callable[[], dict[str, str]] = dict
        """Services whose thread or process is over, with a reason; set by what starts them."""

    def wait_until_ready(self) -> None:
        """Wait for every service. Raises BadInput if one refuses the scene, RunFailed if one dies or does not come."""
        begin, told, by_hand = time.monotonic(), set[str](), self.exited is dict
        settles = coarser(self.loaded) is not None and self.options.resume is None
        patience = max(self.patience, COMPILE_TIMEOUT) if settles else self.patience
        while missing := set(self.plan.services) - self.watch.alive() - self.without.keys():
            self._drain()
            if self.bad_input is not None:
                raise self.bad_input
            if broken := self.cut_off():
                raise RunFailed(broken)
            over = self.exited()
            if gone := {name for name in missing if name in over or self.watch.gone(name)}:
                name = min(gone)
                self._hear({name})
                if self.bad_input is not None:
                    raise self.bad_input
                why = self.errors.get(name) or f"the {name} service ended before it was ready: {over.get(name) or GONE}"
                if name not in self.dispensable:
                    raise RunFailed(why)
                self._miss(name, why)
                continue
            waited = time.monotonic() - begin
            if self.progress is not None and waited > PREPARING_AFTER and told != missing and (by_hand or not told):
                told, away = missing, f"waiting for services that are started by hand: {', '.join(sorted(missing))}"
                self.say(away if by_hand else SETTLING if settles else PREPARING)
            if waited > patience:
                raise RunFailed(f"not ready within {patience:g} s: {', '.join(sorted(missing))}")
            self.watch.wait_for(missing, 0.05)
        self._drain()  # what comes from here on, the recorder hears, too

    def check_premises(self) -> None:
        """Have all services start from the same scene. Raises BadInput where one does not, RunFailed where one dies."""
        for services in (set(self.needed), self.dispensable):
            try:
                alive = services & self.watch.alive()
                notes = check_premises(self.bus, alive, self.loaded, self.options.resume is not None)
            except RunFailed as error:
                self._hear({error.peer})
                if broken := self.cut_off():
                    raise RunFailed(broken) from None
                if error.peer in self.watch.alive():
                    raise RunFailed(f"the {error.peer} service {UNSAID}") from None
                if error.peer in self.dispensable:
                    continue
                raise RunFailed(f"the {error.peer} service died: {self._why(error.peer)}") from None
            for note in notes:
                self.say(note)

    def _why(self, name: str) -> str:
        """Why a service is over."""
        return self.errors.get(name) or self.exited().get(name) or GONE

    def _hear(self, names: set[str]) -> bool:
        """Wait for last words of services that are over, which may be on the way; whether the run ends meanwhile."""
        end, over = time.monotonic() + LAST_WORDS, self.ended is not None
        while True:
            if self._drain(timeout=0.05) and not over:
                return True
            if names & self.errors.keys() or time.monotonic() >= end:
                return False

    def _drain(self, timeout: float = 0.0) -> bool:
        """Take in what services say; whether the run has ended."""
        item = self.inbox.get(timeout)
        while isinstance(item, Message):
            try:
                if item.topic in STATUSES:
                    status = STATUSES[item.topic].model_validate_json(item.payload)
                    self.silence.hear(status.frame)
                    if self.progress is not None:
                        self.progress(status)
                else:
                    self._note(item.topic, Event.model_validate_json(item.payload))
            except ValueError:
                self.inbox.refuse(item)
            item = self.inbox.get(0)
        if not self.recorded:
            self.unrecorded = dict(self.inbox.counts.received)
            self.recorded = "recorder" in self.watch.alive()
        return self.ended is not None

    def _note(self, topic: str, event: Event) -> None:
        """Take in one event. Raises ValueError where it does not come from a service of this run."""
        if topic != f"{EVENT.name}/{event.service}" or event.service not in self.plan.services:
            raise ValueError(f"{topic} speaks for {event.service}")
        log.note_event(self.run, event)
        if event.kind == "error":
            self.errors[event.service] = event.text
            self.blamed = self.blamed or str(event.args.get("peer", ""))
            if event.args.get("bad_input"):
                self.bad_input = BadInput(event.text)
        elif event.kind == "end":
            summary = event.args.get("summary")
            if event.service != self.plan.leader or not isinstance(summary, dict):
                raise ValueError("not the end of the run")
            self.ended = summary
        elif event.kind in ("start", "warning") and self.progress is not None:
            self.progress(event.text)

    def follow(self) -> str:
        """Let the run go to its end; the error that ended it early, or ""."""
        if self.paused:
            self.say(f"paused before its first frame; to go on: nuno control {self.run} resume")
        else:
            self.bus.ask_json("control", {"action": "start"})
        while self.ended is None:
            self._drain(timeout=0.2)
            if self.progress is not None:
                self.laggards.look(self.say)
                self.silence.look(self.say)
            if broken := self.cut_off():
                return broken
            for name in self.dispensable - self.watch.alive() - self.without.keys():
                self._hear({name})
                self._miss(name, self.exited().get(name) or GONE)
            for name in self.watch.alive() - {SUPERVISOR, *self.plan.services} - self.strange:
                self.strange.add(name)
                self.say(f"the {name} service takes no part: the run was started without it")
            if dead := [name for name in self.needed if name not in self.watch.alive()]:
                if self._drain() or self._hear(set(dead)):
                    break
                if self.blamed in self.watch.alive():
                    return f"the run gave up: {self.errors[dead[0]]}"
                # What one says may come before another's words about it.
                name = self.blamed or next((name for name in dead if name in self.errors), dead[0])
                return f"the {name} service died: {self._why(name)}"
        return ""

    def say(self, text: str, level: int = logging.INFO) -> None:
        """Tell who watches, and the log."""
        log.note(self.run, text, level=level)
        if self.progress is not None:
            self.progress(text)

    def _miss(self, name: str, why: str) -> None:
        """Go on without a service that the run can do without, and say so, once."""
        if name not in self.without:
            self.without[name] = self.errors.get(name) or why
            self.say(f"the run goes on without a view: the {name} service died: {self.without[name]}")

    def finish(self, error: str, report: Summarise, discard: bool = False) -> dict[str, dict[str, Any]]:
        """Ask each service to finish, the recorder last, and collect what they counted.

        `discard` leaves no recording behind: nothing has happened that could be in it.
        Services that are not ready yet learn from the supervisor's absence that they are not needed.
        """
        answers: dict[str, dict[str, Any]] = {}
        if "recorder" in self.plan.services:
            self._await_recorder()
        order = [self.plan.leader, *(n for n in FOLLOWERS if n in self.plan.services[1:])]
        for name in order:
            self.broken = self.cut_off()
            if self.broken:
                break
            if name not in self.watch.alive():
                if not error and name not in self.without:
                    self._lose(name, "")
                continue
            failed = error or any(service in self.errors for service in self.needed)
            state = "failed" if failed or not self.ended else str(self.ended.get("state", "failed"))
            state = error if error in SIGNALS else state
            request: dict[str, Any] = {"error": error, "state": state}
            if name == "recorder":
                # A service that failed answers no more: of what it sent, what has come here has to come there.
                heard = self.inbox.counts
                sent = {t: n + heard.missing[t] - self.unrecorded.get(t, 0) for t, n in heard.received.items()}
                sent |= {topic: n for answer in answers.values() for topic, n in answer.get("sent", {}).items()}
                request |= {"discard": discard, "expected": sent, "report": report(answers)}
            # One that the run gave up waiting for has had its time.
            patience = FINISH_TIMEOUT if name == self.blamed else PATIENCE_AT_END.get(name, FINISH_TIMEOUT)
            if name == "render" and self.progress is not None and not error:
                self.say(DRAWING)
            try:
                answers[name] = self._ask_to_finish(name, request, patience)
            except RunFailed as failure:
                self.broken = self.cut_off()
                if self.broken:
                    break
                self._lose(name, str(failure))
        answers[SUPERVISOR] = {name: self.inbox.counts.nonzero()[name] for name in ("missing", "refused")}
        self.alive.undeclare()
        return answers

    def _ask_to_finish(self, name: str, request: dict[str, Any], patience: float) -> dict[str, Any]:
        """A service's answer. Where the user would not wait for pictures, those that wait are left undrawn."""
        try:
            return self.bus.ask_json(f"finish/{name}", request, patience)
        except KeyboardInterrupt:
            if name != "render":
                raise
        self.say(UNDRAWN)
        answer = self.bus.ask_json(f"finish/{name}", {"error": "interrupted"}, patience)
        self.errors[name] = f"interrupted, pictures left undrawn: {answer.get('undrawn')}"
        return answer

    def _lose(self, name: str, why: str) -> None:
        """Note a service that has not finished."""
        self._hear({name})
        why = self.exited().get(name) or why or GONE
        if name in self.dispensable:
            self._miss(name, why)
        elif name not in self.errors:
            self.errors[name] = f"the service did not finish: {why}"
            self.say(f"{name}: {self.errors[name]}")

    def _await_recorder(self) -> None:
        """Wait until the recorder can be told what becomes of its file: it may be creating it just now."""
        self._drain()
        end = time.monotonic() + FINISH_TIMEOUT
        while "recorder" not in self.exited() and not self.watch.gone("recorder") and time.monotonic() < end:
            if not self.watch.wait_for({"recorder"}, 0.05):
                return
