"""One run in one way: its digests, of every frame where it is recorded."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from nuno.recording.reader import open_recording
from nuno.recording.restore import restored_scene
from nuno.scene.scene_file import Loaded
from nuno.service import Options
from nuno.supervision import runs, supervisor
from nuno.supervision.supervisor import Deployment, Outcome
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import DYE_STATUS, STATUS, FrameStatus

PATIENCE = 1800.0
"""Longest that a run, or its answer, is waited for [s]; a first one compiles kernels."""

Changes = tuple[tuple[int, str, str], ...]


@dataclass(frozen=True)
class Seen:
    """A run's digests: the last of each service that steps, and of each frame where they were recorded."""

    last: tuple[str, ...]
    frames: tuple[tuple[int, str], ...] = ()


@dataclass
class Way:
    """How a scene is run; the bits may not depend on it."""

    options: Options
    processes: bool = False
    core: int | None = None
    """The one processor that its processes may use."""
    pauses: tuple[int, ...] = ()
    """Frames at which it stands still for a moment."""
    stop: int | None = None
    """Frame at which it is stopped."""


def take(loaded: Loaded, way: Way, changes: Changes = ()) -> Seen:
    """Run a scene. Raises RunFailed where it does not end as it should."""
    frames = sorted({*way.pauses, *(frame for frame, _, _ in changes), *([way.stop] if way.stop is not None else [])})
    frames = [frame for frame in frames if way.stop is None or frame <= way.stop]
    run = _Run(loaded, way, paused=bool(frames))
    try:
        for frame in frames:
            run.step_to(frame)
            for _, action, item in (change for change in changes if change[0] == frame):
                run.ask(action=action, item=item)
        if frames:
            run.ask(action="stop" if way.stop is not None else "resume")
    except BaseException:
        run.end()
        raise
    outcome = run.join()
    if outcome.problem:
        raise RunFailed(outcome.problem)
    summaries = [answer["summary"] for answer in outcome.services.values() if "summary" in answer]
    return Seen(tuple(str(summary["digest"]) for summary in summaries), _frames(way.options.record))


def resume(path: Path, way: Way, changes: Changes, duration: str | None) -> Seen:
    """Go on from a recording's last checkpoint, with the changes that were to come after it."""
    overrides = (f"duration={duration}",) if duration is not None else ()
    with open_recording(path) as recording:
        point = recording.common_checkpoint().t
        with restored_scene(recording, overrides) as loaded:
            at = round(point * loaded.scene.frame_rate)
            left = tuple(change for change in changes if change[0] > at)
            return take(loaded, replace(way, options=replace(way.options, resume=path)), left)


def _frames(record: Path | None) -> tuple[tuple[int, str], ...]:
    if record is None:
        return ()
    with open_recording(record) as recording:
        if not recording.complete:
            raise RunFailed(f"the recording is incomplete: {recording.missing}")
        return tuple(mark for topic in (STATUS, DYE_STATUS) for mark in recording.marks(topic.name).values())


class _Run:
    """A run in a thread of its own, under control."""

    def __init__(self, loaded: Loaded, way: Way, paused: bool) -> None:
        self.loaded, self.way, self.run = loaded, way, runs.new_id("bits")
        self.deployment = Deployment(processes=way.processes, run=self.run, paused=paused)
        self.outcome: Outcome | None = None
        self.error: BaseException | None = None
        self.standing = threading.Event()
        self.frame = -1
        self.thread = threading.Thread(target=self._body, daemon=True)
        self.thread.start()
        self.endpoint = ""
        if paused:
            self._wait(self.standing.is_set)
            self.endpoint = runs.running()[self.run]

    def _body(self) -> None:
        if self.way.core is not None:  # of this thread and of the processes that it starts
            os.sched_setaffinity(0, {self.way.core})
        try:
            self.outcome = supervisor.supervise(self.loaded, self.way.options, self.deployment, self._note)
        except BaseException as error:
            self.error = error

    def _note(self, status: FrameStatus | str) -> None:
        if isinstance(status, FrameStatus):
            self.frame = status.frame
        elif status.startswith("paused"):
            self.standing.set()

    def ask(self, **request: Any) -> dict[str, Any]:
        """Raises RunFailed where a request is refused."""
        answer = supervisor.control(self.run, self.endpoint, request)
        if not answer.get("ok"):
            raise RunFailed(str(answer.get("error")))
        return answer

    def step_to(self, frame: int) -> None:
        """Stand still after a frame."""
        at = int(self.ask(action="status")["frame"])
        if at < frame:
            self.ask(action="step", frames=frame - at)
            self._wait(lambda: self.frame >= frame)  # within a frame nobody answers
            self._wait(lambda: self.ask(action="status")["state"] == "paused")

    def _wait(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            if not self.thread.is_alive():
                raise RunFailed(f"the run ended: {self.error or (self.outcome and self.outcome.problem)}")
            if time.monotonic() > end:
                raise RunFailed(f"nothing came within {PATIENCE:g} s")
            self.standing.wait(0.01) if not self.standing.is_set() else time.sleep(0.005)

    def end(self) -> None:
        """Stop it, so that nothing is left behind."""
        if self.endpoint and self.thread.is_alive():
            self.ask(action="stop")
        self.thread.join(PATIENCE)

    def join(self) -> Outcome:
        """How it ended. Raises what it raised."""
        self.thread.join(PATIENCE)
        if self.error is not None:
            raise self.error
        if self.outcome is None:
            raise RunFailed(f"not over within {PATIENCE:g} s")
        return self.outcome
