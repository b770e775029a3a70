"""A run that goes on while a test disturbs it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from scenes import BALL, write_scene

from nuno.scene import scene_file
from nuno.service import Options
from nuno.supervision.supervisor import Deployment
from soak import live


class Run(live.Run):
    """A run of a scene's file."""

    def __init__(self, scene: Path, record: Path, processes: bool = False, paused: bool = False) -> None:
        self.record = record
        deployment = Deployment(processes=processes, paused=paused)
        super().__init__(scene_file.read(scene), Options(record=record), deployment)


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
