"""What a resumed or repeated run takes from a recording: control events, poses, settled cloth, earlier messages."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from nuno.recording.reader import Recording, opened
from nuno.recording.writer import RecordingWriter
from nuno_schemas.fabric import Float
from nuno_schemas.messages import BODIES, CHECKPOINTS, EVENT, FABRIC, REPORT, Event, Header

SETTLED = "settled_from", "settled"
"""Names of the arrays of `Loaded.settled` in `sim/fabric`."""
CONTROLS = tuple(f"{EVENT.name}/{service}" for service in ("simulation", "dye"))
"""Event topics of the services that answer control requests."""


def control_events(recording: Recording) -> list[Event]:
    """Return the control events of a run, in order: pause, resume, step, stop, set, add."""
    return [event for event in recording.events() if event.kind == "control"]


def recorded_poses(recording: Recording, until: float = math.inf) -> dict[int, bytes]:
    """Return `Loaded.recorded_poses` of a recording, up to a time [s]."""
    marks, poses = recording.marks(), recording.messages([BODIES.name])
    return {marks[m.log_time][0]: m.payload for m in poses if m.log_time in marks and m.t <= until + 1e-9}


def settled_cloth(recording: Recording) -> tuple[Float, Float] | None:
    """Return `Loaded.settled` of a recording."""
    if not recording.counts.get(FABRIC.name):
        return None
    arrays, _ = recording.fabric(0.0)
    start, x = (arrays.get(name, np.zeros(0)) for name in SETTLED)
    return (start, x) if start.shape == x.shape and x.ndim == 2 and x.shape[1] == 3 else None


def before_checkpoint(source: Recording | Path | None, topics: Iterable[str]) -> list[dict[str, Any]]:
    """Return the JSON messages before the first frame of a run that resumes a recording, for its report."""
    if source is None:
        return []
    with opened(source) as recording:
        return [recording.said(message) for message in recording.messages(topics, end=recording.common_checkpoint().t)]


def copy_until(recording: Recording, writer: RecordingWriter) -> None:
    """Write all messages before the last checkpoint, and the checkpoint itself, which a resumed run has in common with
    the recorded one.
    """
    checkpoint = recording.common_checkpoint()
    for message in recording.messages():
        earlier = message.t < checkpoint.t - 1e-9
        # A change made at the checkpoint's frame comes after it.
        same = message.t < checkpoint.t + 1e-9 and message.topic in (*CHECKPOINTS, *CONTROLS)
        if message.topic != REPORT.name and (earlier or same):
            header = Header(run="", service="", seq=message.seq, frame=0, t=message.t)
            writer.write(message.topic, header, message.payload)
