"""Resimulation of a recording from a checkpoint, with the changes that were made during its run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nuno.recording.reader import Recording, open_recording
from nuno.recording.recorded import Checkpoint, Recorded
from nuno.recording.restore import control_events
from nuno.runtime.stepper import Stepper
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import Event

CHANGES = ("set", "add")
"""Control events that change the scene."""


def changes_of(recording: Recording, service: str) -> list[Event]:
    """Return the control events that changed a service's cloth or dye during the run, in order. Raises BadInput."""
    return [event for event in control_events(recording) if event.service == service and event.text in CHANGES]


def take_up(stepper: Stepper, recording: Recording, point: Checkpoint) -> None:
    """Bring a new stepper to a checkpoint of its scene's recording. Raises BadInput where it does not fit."""
    changes = changes_of(recording, stepper.service)
    stepper.resume(point, [event for event in changes if event.frame <= point.frame])


def resume(stepper: Stepper, path: Path) -> None:
    """Bring a new stepper to the last checkpoint of a recording. Raises BadInput."""
    with open_recording(path) as recording:
        point = recording.last_checkpoint(recording.common_checkpoint().t, stepper.kept.name)
        if point.frame > (frames := stepper.loaded.scene.frames):
            problem, remedy = "the recording goes on after the end of the scene", "lengthen it: --set duration=10s"
            value, limit = f"frame {point.frame}", f"{frames} frames"
            raise BadInput(problem, str(path), value=value, limit=limit, remedy=remedy)
        if not all(np.isfinite(values).all() for values in point.state.values()):
            problem, remedy = "the last checkpoint is not finite: its run diverged", "run its scene with a shorter step"
            raise BadInput(problem, str(path), value=f"frame {point.frame}", remedy=remedy)
        take_up(stepper, recording, point)


class Resimulation:
    """Cloth or dye of a recording, which can be stepped to any frame."""

    def __init__(self, recording: Recording, stepper: Stepper, start: Recorded | None = None) -> None:
        """Begin at a checkpoint's message, by default at the scene's start. Raises BadInput."""
        self.stepper = stepper
        self.changes = changes_of(recording, stepper.service)
        """Changes that are not applied yet."""
        if start is not None:
            point = recording.checkpoint(start)
            take_up(stepper, recording, point)
            self.changes = [event for event in self.changes if event.frame > point.frame]
        stepper.present()

    @property
    def changing(self) -> bool:
        """Whether changes of the present frame are not applied yet."""
        return any(event.frame == self.stepper.frame for event in self.changes)

    def change(self) -> None:
        """Apply the changes of the present frame, each once, in order."""
        for event in [event for event in self.changes if event.frame == self.stepper.frame]:
            self.changes.remove(event)
            apply = self.stepper.set if event.text == "set" else self.stepper.add
            apply(str(event.args["item"]))

    def go_to(self, frame: int) -> None:
        """Step to a frame, with the changes before it."""
        while self.stepper.frame < frame:
            self.change()
            self.stepper.step()

    def comes_to(self, digest: str | None) -> bool:
        """Return whether the present state has this digest, before or after the frame's changes.

        The first frame, of this run or of a resumed one, contains the changes before it already.
        """
        if self.stepper.digest() != digest:
            self.change()
        return self.stepper.digest() == digest
