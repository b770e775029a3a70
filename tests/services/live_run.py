"""A run that goes on while a test disturbs it."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from scenes import BALL, write_scene

from nuno.report.run_report import Report, make_report
from nuno.runtime import runs, supervisor
from nuno.runtime.outcome import Outcome
from nuno.runtime.service import Options
from nuno.runtime.supervisor import Deployment
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import FrameStatus

PATIENCE = 1800.0
"""Longest that a run, or its answer, is waited for [s]; a first one compiles kernels."""


class Live:
    """A run in a thread of this process, which goes on from when this is made.

    moved   set when it has finished a frame after the first
    frame   the last that it has finished
    core    the one processor that it, and the processes that it starts, may use
    """

    def __init__(self, loaded: Loaded, options: Options, deployment: Deployment, core: int | None = None) -> None:
        self.loaded, self.options, self.core, self.run = loaded, options, core, runs.new_id("live")
        self.deployment = replace(deployment, run=self.run)
        self.moved, self.frame, self._standing = threading.Event(), -1, not deployment.paused
        self.outcome: Outcome | None = None
        self.error: BaseException | None = None
        self.thread = threading.Thread(target=self._body, daemon=True)
        self.thread.start()

    def _body(self) -> None:
        if self.core is not None:
            os.sched_setaffinity(0, {self.core})
        try:
            self.outcome = supervisor.supervise(self.loaded, self.options, self.deployment, self._note)
        except BaseException as error:
            self.error = error

    def _note(self, status: FrameStatus | str) -> None:
        if isinstance(status, FrameStatus):
            self.frame = status.frame
            if status.frame > 0:
                self.moved.set()
        elif status.startswith("paused"):
            self._standing = True

    @property
    def endpoint(self) -> str:
        return runs.running()[self.run]

    @property
    def report(self) -> Report:
        """Of a run that is over."""
        return make_report(self.loaded, self.join())

    def control(self, action: str, **request: object) -> dict[str, Any]:
        return supervisor.control(self.run, self.endpoint, {"action": action, **request})

    def wait_until_paused(self) -> int:
        """The frame at which the run stands still."""
        self.wait(lambda: self._standing)  # nobody answers before
        self.wait(lambda: self.control("status")["state"] == "paused")
        return int(self.control("status")["frame"])

    def step_to(self, frame: int) -> None:
        """Stand still after a frame."""
        at = self.wait_until_paused()
        if at < frame:
            self.control("step", frames=frame - at)
            self.wait(lambda: self.frame >= frame)  # within a frame nobody answers
            self.wait_until_paused()

    def wait(self, condition: Callable[[], bool]) -> None:
        """Until it holds. Raises RunFailed where the run ends before."""
        end = time.monotonic() + PATIENCE
        while not condition():
            if not self.thread.is_alive():
                raise RunFailed(f"the run ended: {self.error or (self.outcome and self.outcome.problem)}")
            if time.monotonic() > end:
                raise RunFailed(f"nothing came within {PATIENCE:g} s")
            time.sleep(0.005)

    def join(self, patience: float = PATIENCE) -> Outcome:
        """How it ended. Raises what it raised."""
        self.thread.join(patience)
        if self.error is not None:
            raise self.error
        if self.outcome is None:
            raise RunFailed(f"not over within {patience:g} s")
        return self.outcome

    def stop(self) -> Outcome:
        self.control("stop")
        return self.join()


class Run(Live):
    """A run of a scene's file."""

    def __init__(
        self, scene: Path, record: Path, processes: bool = False, paused: bool = False, real_time: bool = False
    ) -> None:
        self.record = record
        deployment = Deployment(processes=processes, paused=paused)
        super().__init__(scene_file.read(scene), Options(record=record, real_time=real_time), deployment)


def start_long(folder: Path, processes: bool = False, **fields: Any) -> Run:
    """A run of 20,000 frames that has taken its first."""
    scene = write_scene(folder, **({"bodies": BALL, "duration": 400.0} | fields))
    run = Run(scene, folder / "long.mcap", processes)
    assert run.moved.wait(60)
    return run


def wait_until(condition: Callable[[], bool], patience: float = 30.0) -> None:
    deadline = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < deadline
