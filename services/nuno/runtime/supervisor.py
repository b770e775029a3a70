"""Runs a scene: starts the services that it needs, supervises them until they are ready, while they work and while they
finish, and ends the run in order.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import zenoh

from nuno.bus.health import Watch, offer_health
from nuno.bus.messages import Bus, Inbox, Message, Query
from nuno.bus.sessions import SlowConsumers, cut_off, hub_at, identity, spoke
from nuno.formatting import counted
from nuno.process import SIGNALS, state_of
from nuno.runtime import launch, log, runs
from nuno.runtime.consistency import check_premises
from nuno.runtime.launch import FINISH_TIMEOUT, Plan, make_plan
from nuno.runtime.outcome import Outcome
from nuno.runtime.service import SUPERVISOR, Options
from nuno.scene.scene_file import Loaded, coarser
from nuno.scene.warnings import scene_warnings
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import DYE_STATUS, EVENT, STATUS, STATUSES, Event, FrameStatus, Topic

QUIET_SECONDS = 60.0
"""Time without a frame or an answer after which a warning is logged [s]."""
ANSWER_SECONDS = 0.5
"""Timeout of the status query [s]: a paused or waiting service answers immediately, one in a frame does not."""


class Silence:
    """Watches the frames of the leading service."""

    def __init__(self, bus: Bus, leader: str) -> None:
        self._bus, self._leader = bus, leader
        self._frame, self._arrived, self._warned = 0, time.monotonic(), False

    def hear(self, frame: int) -> None:
        """Record the arrival of a frame."""
        self._frame, self._arrived, self._warned = frame, time.monotonic(), False

    def look(self, say: Callable[[str], None]) -> None:
        """Pass a warning to `say`, once for each frame, if the next one does not arrive for long."""
        if self._warned or time.monotonic() - self._arrived < QUIET_SECONDS:
            return
        try:
            self._bus.ask("control", b'{"action": "status"}', ANSWER_SECONDS)
            self._arrived = time.monotonic()
        except RunFailed:
            self._warned = True
            say(
                f"no frame for {QUIET_SECONDS:g} s: the {self._leader} service is still in frame {self._frame + 1}; "
                "a step may take long, or a plugin may never return. To end the run: Ctrl-C"
            )


START_TIMEOUT, COMPILE_TIMEOUT = 120.0, 1800.0
"""Longest wait until services are ready [s]: of those started by hand, which the user may forget; and of those started
here, which are known to be alive, and may compile kernels for minutes on a slow machine's first run."""
FOLLOWERS = ("dye", "collision", "render", "viewer", "recorder")
"""Services in the order in which they finish, after the leader."""
DRAWING_TIMEOUT = 3600.0
"""Longest wait for pictures that are drawn after the end [s]."""
DRAWING = "drawing what is left of the pictures"
UNDRAWN = "the picture that is being drawn is the last (once more, and the run ends at once)"
WRITING_TIMEOUT = 1800.0
"""Longest wait until the recorder closes its file [s]: a slow disk still has to write the system's cache."""
PATIENCE_AT_END = {"render": DRAWING_TIMEOUT, "recorder": WRITING_TIMEOUT}
LAST_WORDS = 1.0
"""Longest wait for the error of a service that has gone [s]."""
PREPARING_AFTER, PREPARING_EVERY = 1.5, 10.0
"""Time of preparation until the first message, and between messages that name the services that are not ready [s]."""
PREPARING = "preparing; what the first run of a kind of scene compiles, the next one finds ready"
SETTLING = "the cloth comes to rest on coarser triangles first"
GONE = "its process ended or the connection broke"
UNSAID = "does not say which scene it has read: it, or the router's rights, are of an older version (see nuno certs)"

Summarise = Callable[[dict[str, dict[str, Any]]], dict[str, Any]]
Progress = Callable[[FrameStatus | str], None]
"""Called with each frame's status, and with the messages of services."""


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
        """Services without which the run goes on: their output is no part of its result."""
        self.needed = [name for name in plan.services if name not in self.dispensable]
        self.without: dict[str, str] = {}
        """Services that the run goes on without, and the reasons."""
        self.strange: set[str] = set()
        """Services that connected to this run but are not part of its plan, after their warning."""
        self.cut_off: Callable[[], str] = str
        """Returns the problem of the connection to the hub, "" for none."""
        self.broken = ""
        """Problem of the connection while services finished."""
        self.unrecorded: dict[str, int] = {}
        """Messages by topic before the recorder was known to be subscribed, which it may have missed."""
        self.slow_consumers = SlowConsumers(session, {identity(run, name): name for name in plan.services})
        self.silence = Silence(self.bus, plan.leader)
        self.exited: Callable[[], dict[str, str]] = dict
        """Returns services whose thread or process has ended, with the reason; set by the launcher."""

    def wait_until_ready(self) -> None:
        """Wait for all services. Raises BadInput if one refuses the scene, RunFailed if one dies or does not start."""
        begin, shown, by_hand = time.monotonic(), set[str](), self.exited is dict
        next_word = PREPARING_EVERY
        settles = coarser(self.loaded) is not None and self.options.resume is None
        patience = max(self.patience, COMPILE_TIMEOUT) if settles else self.patience
        early = Inbox(self.bus, [])
        early.answer("control")  # until the leader does
        while missing := set(self.plan.services) - self.watch.alive() - self.without.keys():
            self._drain()
            if self.bad_input is not None:
                raise self.bad_input
            if broken := self.cut_off():
                raise RunFailed(broken)
            self._answer_early(early)
            done = self.exited()
            if gone := {name for name in missing if name in done or self.watch.gone(name)}:
                name = min(gone)
                self._hear({name})
                if self.bad_input is not None:
                    raise self.bad_input
                why = self.errors.get(name) or f"the {name} service ended before it was ready: {done.get(name) or GONE}"
                if name not in self.dispensable:
                    raise RunFailed(why)
                self._miss(name, why)
                continue
            waited = time.monotonic() - begin
            if self.progress is not None and waited > PREPARING_AFTER and shown != missing and (by_hand or not shown):
                shown, text = missing, f"waiting for services that are started by hand: {', '.join(sorted(missing))}"
                self.say(text if by_hand else SETTLING if settles else PREPARING)
            elif self.progress is not None and waited > next_word:
                next_word += PREPARING_EVERY
                self.say(f"still preparing after {waited:.0f} s: {', '.join(sorted(missing))}")
            if waited > patience:
                raise RunFailed(f"not ready within {patience:g} s: {', '.join(sorted(missing))}")
            self.watch.wait_for(missing, 0.05)
        early.close()
        self._drain()  # the recorder receives all later messages

    def _answer_early(self, inbox: Inbox) -> None:
        """Raise RunFailed for a request to stop before the leader is ready; others have no answer until then."""
        if not isinstance(query := inbox.get(0), Query):
            return
        if query.json().get("action") != "stop":
            query.query.drop()
            return
        query.answer_json({"ok": True, "state": "stopped", "frame": 0, "frames": self.loaded.scene.frames, "t": 0.0})
        raise RunFailed("stopped while it was prepared")

    def check_premises(self) -> None:
        """Check that all services have read the same scene. Raises BadInput if not, RunFailed where one dies."""
        for services in (set(self.needed), self.dispensable):
            try:
                alive = services & self.watch.alive()
                resumes, real_time = self.options.resume is not None, self.options.real_time
                notes = check_premises(self.bus, alive, self.loaded, resumes, real_time)
            except RunFailed as error:
                self._hear({error.peer})
                if broken := self.cut_off():
                    raise RunFailed(broken) from None
                if error.peer in self.watch.alive():
                    raise RunFailed(f"the {error.peer} service {UNSAID}") from None
                if error.peer in self.dispensable:
                    continue
                raise RunFailed(f"the {error.peer} service died: {self._why(error.peer)}") from None
            for text in notes:
                self.say(text)

    def _why(self, name: str) -> str:
        """Return the reason of a service's end."""
        return self.errors.get(name) or self.exited().get(name) or GONE

    def _hear(self, names: set[str]) -> bool:
        """Wait for pending errors of services that have ended; return whether the run ends meanwhile."""
        end, already_ended = time.monotonic() + LAST_WORDS, self.ended is not None
        while True:
            if self._drain(timeout=0.05) and not already_ended:
                return True
            if names & self.errors.keys() or time.monotonic() >= end:
                return False

    def _drain(self, timeout: float = 0.0) -> bool:
        """Handle all queued messages; return whether the run has ended."""
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
        """Handle one event. Raises ValueError where it does not come from a service of this run."""
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
        """Let the run go to its end; return the error that ended it early, or ""."""
        self.bus.ask_json("control", {"action": "start", "paused": self.paused})
        if self.paused:
            self.say(f"paused before its first frame; to go on: nuno control {self.run} resume")
        while self.ended is None:
            self._drain(timeout=0.2)
            if self.progress is not None:
                self.slow_consumers.look(self.say)
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
                # The error of one service may arrive before that of the service that it blames.
                name = self.blamed or next((name for name in dead if name in self.errors), dead[0])
                return f"the {name} service died: {self._why(name)}"
        return ""

    def say(self, text: str, level: int = logging.INFO) -> None:
        """Log a message, and show it as progress."""
        log.note(self.run, text, level=level)
        if self.progress is not None:
            self.progress(text)

    def _miss(self, name: str, reason: str) -> None:
        """Go on without a dispensable service, with one message."""
        if name not in self.without:
            self.without[name] = self.errors.get(name) or reason
            self.say(f"the run goes on without a view: the {name} service died: {self.without[name]}")

    def finish(self, error: str, report: Summarise, discard: bool = False) -> dict[str, dict[str, Any]]:
        """Ask each service to finish, the recorder last, and return their counts.

        The report that the viewer and the recorder get lacks what those that finish later count.
        `discard` removes the recording of a run that has not begun.
        Services that are not ready yet end when the supervisor is gone.
        """
        answers: dict[str, dict[str, Any]] = {}
        if "recorder" in self.plan.services and error not in SIGNALS:  # else it was ready, or no frame has begun
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
            failure_known = error or any(service in self.errors for service in self.needed)
            state = "failed" if failure_known or not self.ended else str(self.ended.get("state", "failed"))
            state = error if error in SIGNALS else state
            request: dict[str, Any] = {"error": error, "state": state}
            if name in ("viewer", "recorder"):
                request["report"] = report(answers)
            if name == "recorder":
                # A failed service does not answer: the recorder needs at least the messages that arrived here.
                counts = self.inbox.counts
                sent = {t: n + counts.missing[t] - self.unrecorded.get(t, 0) for t, n in counts.received.items()}
                sent |= {topic: n for answer in answers.values() for topic, n in answer.get("sent", {}).items()}
                request |= {"discard": discard, "expected": sent}
            # A service that the run has already waited for gets no longer timeout.
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
        """Return a service's answer; if the user interrupts, queued pictures are not drawn."""
        try:
            return self.bus.ask_json(f"finish/{name}", request, patience)
        except KeyboardInterrupt:
            if name != "render":
                raise
        self.say(UNDRAWN)
        answer = self.bus.ask_json(f"finish/{name}", {"error": "interrupted"}, patience)
        self.errors[name] = f"interrupted, pictures left undrawn: {answer.get('undrawn')}"
        return answer

    def _lose(self, name: str, reason: str) -> None:
        """Record a service that has not finished."""
        self._hear({name})
        reason = self.exited().get(name) or reason or GONE
        if name in self.dispensable:
            self._miss(name, reason)
        elif name not in self.errors:
            self.errors[name] = f"the service did not finish: {reason}"
            self.say(f"{name}: {self.errors[name]}")

    def _await_recorder(self) -> None:
        """Wait until the recorder is alive or gone: it may be creating its file just now."""
        self._drain()
        end = time.monotonic() + FINISH_TIMEOUT
        while "recorder" not in self.exited() and not self.watch.gone("recorder") and time.monotonic() < end:
            if not self.watch.wait_for({"recorder"}, 0.05):
                return


CONTROL_TIMEOUT = 120.0
"""Timeout of a control request [s]: the answer comes between frames, and a first addition compiles kernels."""
CONNECT_PATIENCE = 20.0
AT_ONCE = " (once more, and they end at once)"


@dataclass
class Deployment:
    """Placement of the services; the result is the same to the last bit."""

    processes: bool = False
    listen: str | None = None
    """Endpoint to listen on; None chooses a free port on loopback."""
    connect: str | None = None
    """Endpoint of a hub with services started by hand, or with `processes` here."""
    run: str | None = None
    config: str | None = None
    """zenoh configuration file (TLS, access control)."""
    paused: bool = False
    """Whether the run waits before the first frame for the control request to resume."""


def supervise(
    loaded: Loaded,
    options: Options,
    deployment: Deployment | None = None,
    progress: Progress | None = None,
    report: Callable[[Outcome], dict[str, Any]] | None = None,
) -> Outcome:
    """Run a scene from start to end. Raises BadInput for errors before the start.

    `report` makes the recording's report of the outcome. A run that fails has its state and
    error in the outcome; its recording is kept.
    """
    deployment = deployment or Deployment()
    plan = make_plan(loaded, options)
    options = replace(options, must_see=plan.must_see)
    run = deployment.run or runs.new_id(loaded.scene.name)
    began = time.perf_counter()
    with contextlib.ExitStack() as stack:
        if deployment.connect:
            endpoint = deployment.connect
            own_identity = identity(run, SUPERVISOR)
            # First, since a second session of its identity would end that of a run of the same name.
            stack.enter_context(runs.announced(run, endpoint, loaded.own_path))
            with spoke(endpoint, deployment.config, CONNECT_PATIENCE) as session:
                if SUPERVISOR in Bus(session, run, "visitor").present():  # from another host
                    raise runs.goes_on(run)
            session = stack.enter_context(spoke(endpoint, deployment.config, CONNECT_PATIENCE, own_identity))
        else:
            trusted = [identity(run, name) for name in plan.services if name != "viewer" or name in plan.must_see]
            session, endpoint = stack.enter_context(hub_at(deployment.listen, deployment.config, trusted))
            stack.enter_context(runs.announced(run, endpoint, loaded.own_path))
        if progress is not None:
            progress(f"run {run}, its bus at {endpoint}")
        log.note_start(run, loaded, plan.services)
        supervisor = Supervisor(loaded, options, plan, session, run, progress)
        supervisor.paused = deployment.paused
        for text in scene_warnings(loaded):
            supervisor.say(text, logging.WARNING)
        if deployment.connect:
            supervisor.cut_off = partial(cut_off, session, endpoint)
        else:
            supervisor.patience = COMPILE_TIMEOUT
        if deployment.processes:
            supervisor.exited = stack.enter_context(
                launch.processes(loaded, options, plan, endpoint, run, supervisor.watch, deployment.config)
            )
        elif not deployment.connect:
            supervisor.exited = stack.enter_context(
                launch.threads(loaded, options, plan, session, run, supervisor.watch)
            )
        apart = deployment.processes or deployment.connect is not None
        return _conduct(supervisor, began, apart, report)


def _conduct(
    supervisor: Supervisor, began: float, apart: bool, report: Callable[[Outcome], dict[str, Any]] | None
) -> Outcome:
    """Supervise a run; with `apart`, each service has read the scene itself."""
    ready, error = 0.0, ""
    try:
        supervisor.wait_until_ready()
        if apart:
            supervisor.check_premises()
        ready = time.perf_counter()
        if supervisor.options.record is not None and not supervisor.options.temporary:
            runs.note_recording(supervisor.options.folder / supervisor.options.record)
        log.note(supervisor.run, log.READY, {"seconds": ready - began})
        error = supervisor.follow()
    except BadInput:
        supervisor.progress = None  # only the reason of the refusal is shown
        supervisor.finish("refused", lambda answers: {}, discard=True)
        raise
    except RunFailed as failure:
        error = str(failure)
    except KeyboardInterrupt as signal:
        error = state_of(signal)
    ended = time.perf_counter()
    ready = ready or ended
    if error and supervisor.progress is not None:
        supervisor.progress(f"the services end in order: {error}{AT_ONCE if error in SIGNALS else ''}")

    def outcome(answers: dict[str, dict[str, Any]]) -> Outcome:
        summary = supervisor.ended or answers.get(supervisor.plan.leader, {}).get("summary", {})
        reason = error or "; ".join(_lost(supervisor, answers))
        state = error if error in SIGNALS else "failed" if reason else str(summary["state"])
        seconds = {"prepare": ready - began, "run": ended - ready}
        return Outcome(supervisor.run, state, reason, supervisor.plan, summary, answers, seconds)

    try:
        answers = supervisor.finish(error, lambda answers: report(outcome(answers)) if report else {})
    except KeyboardInterrupt as signal:
        state = state_of(signal)
        facts = {"state": state, "reason": f"{state} while its services ended"}
        log.note(supervisor.run, f"end: {state}", facts, logging.ERROR)
        raise
    result = outcome(answers)
    log.note_end(supervisor.run, result)
    return result


def _lost(supervisor: Supervisor, answers: dict[str, dict[str, Any]]) -> list[str]:
    """Return the problems of a run that reached its end: requested output is incomplete."""
    if supervisor.broken:
        return [supervisor.broken]
    lost = [f"{name}: {text}" for name, text in supervisor.errors.items() if name in supervisor.needed]
    kept = {"recorder": supervisor.options.record, "viewer": supervisor.options.save}
    for name, path in kept.items():
        if path is not None and (missing := answers.get(name, {}).get("missing")):
            written = answers[name].get("file", str(path)).removesuffix(".part")
            lost.append(f"{written} is not whole: it lacks {counted(missing)}")
    if supervisor.options.save is not None:
        words = f"{supervisor.options.save} is not whole"
        lost += [f"{words}: the {name} service died: {why}" for name, why in supervisor.without.items()]
    return lost


def control(
    run: str, endpoint: str, request: dict[str, Any], config: str | None = None, slow: Callable[[], None] | None = None
) -> dict[str, Any]:
    """Send one control request to an active run, whose hub may need a zenoh configuration.

    `slow` is called once after a long wait. Raises BadInput or RunFailed.
    """
    begin = time.monotonic()
    with spoke(endpoint, config) as session:
        try:
            return Bus(session, run, "control").ask_json("control", request, CONTROL_TIMEOUT, slow)
        except RunFailed as error:
            if time.monotonic() - begin < CONTROL_TIMEOUT:
                raise
            raise RunFailed(f"{error}; it may still do what it was asked for", peer=error.peer) from None
