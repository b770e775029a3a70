"""A sheet and a hand that a program moves while the run goes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from live_run import Run
from scenes import write_scene

from nuno.bus.sessions import spoke
from nuno.collision.messages import decode_poses
from nuno.recording.reader import open_recording
from nuno_schemas.messages import BODIES

SHEET = {"plugin": "sheet", "size": [0.2, 0.2], "resolution": [9, 9], "pin": ["top-row"]}
START = [0.0, 0.0, 0.2]
LONG = 60.0
"""A silence that no test lasts for [s]."""


def hand(folder: Path, **motion: Any) -> Path:
    """A sheet that hangs, and a ball in front of it that waits for poses of its own in each of 20 frames."""
    moved = {"plugin": "topic", "frames": "poses", "position": START, "silence": LONG, "fastest": 50.0} | motion
    ball = {"name": "hand", "collider": {"plugin": "sphere", "radius": 0.03}, "motion": moved}
    objects = [{"name": "cloth", "model": SHEET}]
    return write_scene(folder, objects=objects, bodies=[ball], solver="symplectic_euler", duration=0.4)


def poses(number: int = 20) -> list[tuple[list[float], list[float]]]:
    """The ball goes through where the sheet hangs, and turns."""
    turns = np.linspace(0.0, 1.0, number)
    return [
        ([0.01 * i, 0.0, 0.2 - 0.02 * i], [float(np.cos(a)), 0.0, float(np.sin(a)), 0.0]) for i, a in enumerate(turns)
    ]


def places(path: Path) -> np.ndarray:
    """(frames, 3) where the ball was."""
    with open_recording(path) as recording:
        return np.array([decode_poses(one.payload).translation[0] for one in recording.messages([BODIES.name])])


def send(run: Run, key: str, *payloads: bytes | dict[str, Any]) -> None:
    """What a program that knows nothing of nuno does."""
    with spoke(run.endpoint) as session:
        for payload in payloads:
            session.put(key, payload if isinstance(payload, bytes) else json.dumps(payload).encode())
        run.control("resume")
        run.join()
