"""The float64 amounts of a recording: what a run of dye resumes from, and what is exported."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from nuno.recording.reader import Recording
from nuno.recording.recorded import Arrays, Recorded
from nuno.recording.restore import control_events
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.messages import DYE_CHECKPOINT


@dataclass(frozen=True)
class DyeCheckpoint:
    """The amounts after a frame, phi and fixed (dyes, 2, ny, nx), with all solver memory."""

    frame: int
    t: float
    digest: str
    phi: Float
    fixed: Float
    memory: Arrays
    text: dict[str, Any]
    """What the service wrote beside the arrays: dt, steps, the dyes' names, what was supplied."""
    resist: Float | None = None
    """B (2, ny, nx), where a resist was added during the run."""


def read_checkpoints(recording: Recording) -> Iterator[DyeCheckpoint]:
    """All of them, in order. Raises BadInput for a damaged one."""
    for message in recording.messages([DYE_CHECKPOINT.name]):
        yield read_checkpoint(recording, message)


def last_checkpoint(recording: Recording, before: float | None = None) -> DyeCheckpoint:
    """The last one with t <= before [s]. Raises BadInput where there is none."""
    return read_checkpoint(recording, recording.last_checkpoint_message(before, (DYE_CHECKPOINT.name,)))


def additions(recording: Recording) -> list[tuple[int, str]]:
    """What dye was added while the run went on, as (frame, item), in order. Raises BadInput for a damaged event."""
    events = control_events(recording)
    return [(event.frame, str(event.args["item"])) for event in events if (event.service, event.text) == ("dye", "add")]


def per_dye(amounts: Float) -> Float:
    """(dyes, 2, ny, nx) as people write it: without the first axis where there is one dye."""
    return amounts[0] if len(amounts) == 1 else amounts


def read_checkpoint(recording: Recording, message: Recorded) -> DyeCheckpoint:
    """What a message of `dye/checkpoint` holds. Raises BadInput for a damaged one."""
    arrays, text = recording.arrays(message)
    try:
        phi, fixed = (np.asarray(arrays[name], np.float64) for name in ("phi", "fixed"))
        if phi.ndim != 4 or phi.shape != fixed.shape:
            raise ValueError(f"phi has shape {phi.shape} and fixed {fixed.shape}")
        memory = {name.removeprefix("memory/"): a for name, a in arrays.items() if name.startswith("memory/")}
        resist = np.asarray(arrays["resist"], np.float64) if "resist" in arrays else None
        return DyeCheckpoint(
            int(text["frame"]), float(text["t"]), str(text.get("digest", "")), phi, fixed, memory, text, resist
        )
    except (KeyError, ValueError, TypeError, OverflowError) as error:
        raise BadInput(f"the checkpoint at {message.t:g} s is damaged: {error}", str(recording.path)) from None
