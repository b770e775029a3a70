"""What a recording holds, taken up from a checkpoint and stepped again with what was changed while it went on."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nuno.recording.reader import Recording, open_recording
from nuno.recording.recorded import Checkpoint, Recorded
from nuno.recording.restore import control_events
from nuno.stepping.stepper import Stepper
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import Event

CHANGES = ("set", "add")
"""Control events that change what is stepped."""


def changes_of(recording: Recording, service: str) -> list[Event]:
    """What was changed of a service's cloth or dye while the run went on, in order. Raises BadInput."""
    return [event for event in control_events(recording) if event.service == service and event.text in CHANGES]


def take_up(stepper: Stepper, recording: Recording, point: Checkpoint) -> None:
    """Bring what has not begun to a checkpoint of a recording of its scene. Raises BadInput where it does not fit."""
    changes = changes_of(recording, stepper.service)
    stepper.resume(point, [event for event in changes if event.frame <= point.frame])


def resume(stepper: Stepper, path: Path) -> None:
    """Go on from a recording's last checkpoint. Raises BadInput."""
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
    """Cloth or dye of a recording, at whichever frame it is stepped to."""

    def __init__(self, recording: Recording, stepper: Stepper, start: Recorded | None = None) -> None:
        """From a checkpoint's message on, or else from the start. Raises BadInput."""
        self.stepper = stepper
        self.changes = changes_of(recording, stepper.service)
        """Still to be made."""
        if start is not None:
            point = recording.checkpoint(start)
            take_up(stepper, recording, point)
            self.changes = [event for event in self.changes if event.frame > point.frame]
        stepper.present()

    @property
    def changing(self) -> bool:
        """Whether changes of the present frame are still to be made."""
        return any(event.frame == self.stepper.frame for event in self.changes)

    def change(self) -> None:
        """Make the changes of the present frame, each once, in their order."""
        for event in [event for event in self.changes if event.frame == self.stepper.frame]:
            self.changes.remove(event)
            make = self.stepper.set if event.text == "set" else self.stepper.add
            make(str(event.args["item"]))

    def go_to(self, frame: int) -> None:
        """Step to a frame, with what was changed before it."""
        while self.stepper.frame < frame:
            self.change()
            self.stepper.step()

    def comes_to(self, digest: str | None) -> bool:
        """Whether the present state is that of a digest.

        A change made before the first frame, of this run or of a resumed one, is in that frame already.
        """
        if self.stepper.digest() != digest:
            self.change()
        return self.stepper.digest() == digest
