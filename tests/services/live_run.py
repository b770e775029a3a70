"""A run that goes on while a test disturbs it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from scenes import BALL, write_scene

from nuno.report import Report, make_report
from nuno.scene import scene_file
from nuno.service import Options
from nuno.supervision import runs, supervisor
from nuno.supervision.supervisor import Deployment, Outcome
from nuno_schemas.messages import FrameStatus


class Run:
    """A run in a thread of its own, to be disturbed from outside."""

    def __init__(self, scene: Path, record: Path, processes: bool = False, paused: bool = False) -> None:
        self.loaded = scene_file.read(scene)
        self.run = runs.new_id("test")
        self.options = Options(record=record)
        self.record = record
        self.moved = threading.Event()
        self.outcome: Outcome | None = None
        self.report: Report = {}
        self.deployment = Deployment(processes=processes, run=self.run, paused=paused)
        self.thread = threading.Thread(target=self._body, daemon=True)
        self.thread.start()

    def _body(self) -> None:
        self.outcome = supervisor.supervise(self.loaded, self.options, self.deployment, self._note)
        self.report = make_report(self.loaded, self.outcome)

    def _note(self, status: FrameStatus | str) -> None:
        if isinstance(status, FrameStatus) and status.frame > 0:
            self.moved.set()

    @property
    def endpoint(self) -> str:
        return runs.running()[self.run]

    def control(self, action: str, **request: object) -> dict[str, Any]:
        return supervisor.control(self.run, self.endpoint, {"action": action, **request})

    def wait_until_paused(self) -> int:
        """The frame at which the run stands still."""
        wait_until(lambda: self.control("status")["state"] == "paused")
        return int(self.control("status")["frame"])

    def join(self) -> Outcome:
        self.thread.join(60)
        assert self.outcome is not None
        return self.outcome

    def stop(self) -> Outcome:
        self.control("stop")
        return self.join()


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
