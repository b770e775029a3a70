"""Runs a scene: starts the services that it needs, supervises them, and ends the run in order."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from nuno.bus.messages import Bus
from nuno.bus.sessions import cut_off, hub_at, identity, spoke
from nuno.formatting import counted
from nuno.process import SIGNALS, state_of
from nuno.runtime import intersections, launch, log, runs
from nuno.runtime.oversight import COMPILE_TIMEOUT, Progress, Supervisor
from nuno.runtime.plan import Plan, make_plan
from nuno.runtime.service import SUPERVISOR, Options
from nuno.scene.scene_file import Loaded
from nuno.scene.warnings import scene_warnings
from nuno_schemas.errors import BadInput, RunFailed

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
    """Endpoint of a hub with services started by hand; this process starts none."""
    run: str | None = None
    config: str | None = None
    """zenoh configuration file (TLS, access control)."""
    paused: bool = False
    """Whether the run waits before the first frame for the control request to resume."""


@dataclass
class Outcome:
    """State of a run at its end, and the reports of its services."""

    run: str
    state: str
    """done, stopped, interrupted, terminated, diverged, unconverged or failed"""
    error: str
    plan: Plan
    summary: dict[str, Any]
    services: dict[str, dict[str, Any]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def problem(self) -> str:
        """The problem of the run in words; empty if there is none."""
        if self.state in ("done", "stopped"):
            return intersections.problem(self.services.get("collision", {}).get("cloth_contact"))
        if self.state in SIGNALS:
            return f"{self.state} by {SIGNALS[self.state]} before its end"
        return f"{self.state}: {self.error or self.summary.get('message') or 'positions are no longer finite'}"


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
        log.note_failure(supervisor.run, state, f"{state} while its services ended")
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
            lost.append(f"{path} is not whole: it lacks {counted(missing)}")
    if supervisor.options.save is not None:
        words = f"{supervisor.options.save} is not whole"
        lost += [f"{words}: the {name} service died: {why}" for name, why in supervisor.without.items()]
    return lost


def control(
    run: str,
    endpoint: str,
    request: dict[str, Any],
    config: str | None = None,
    slow: Callable[[], None] | None = None,
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
