"""Frames of a recording as they were, in float64: between checkpoints they are simulated again, to the same bits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from nuno.recording.reader import Recording
from nuno.recording.recorded import Recorded
from nuno.recording.restore import control_events, restored_scene
from nuno.stepping.resimulation import Resimulation
from nuno.stepping.stepper import Stepper
from nuno.verification import steppers
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.system import Forces


@dataclass(frozen=True)
class FrameState:
    """One frame of a run.

    x (n, 3) [m] and v (n, 3) [m/s] are float64 with the run's own bits, of which digest is the hash. fabric has
    masses, springs and all else that does not change from frame to frame, as it is at this one; forces what acts,
    where that was asked for. Of a cloth that is dyed phi and fixed are (dyes, 2, ny, nx); of one that is dyed alone
    there are no vertices and no fabric, and digest is that of the amounts.
    """

    frame: int
    t: float
    digest: str
    x: Float
    v: Float
    fabric: Fabric | None = None
    forces: Forces | None = None
    phi: Float | None = None
    fixed: Float | None = None


@dataclass(frozen=True)
class Acted(FrameState):
    """A moment with what acted in it: of cloth that moves, which then has a fabric and forces."""

    fabric: Fabric
    forces: Forces


def states(
    recording: Recording, frames: Iterable[int] | None = None, forces: bool = False, threads: int = 0
) -> Iterator[FrameState]:
    """Frames by their numbers (default: all), in order, each from the nearest checkpoint before it.

    What is simulated again is what was recorded: each frame's digest is compared. Raises BadInput for a recording
    without a scene, for a frame that is not in it, where this version or processor comes to other bits, and for the
    forces of cloth that is dyed alone.
    """
    known = {frame: digest for frame, digest in recording.marks().values() if digest}
    wanted = sorted(known if frames is None else set(frames))
    for frame in wanted:
        if frame not in known:
            raise recording.no_frame(frame, known)
    with restored_scene(recording) as loaded:
        if forces and not loaded.scene.moves:
            raise BadInput("a cloth that is dyed alone feels no forces", loaded.file, field="forces", value=forces)
        parts = {name: _Part(recording, make) for name, make in steppers(loaded, threads).items()}
        for frame in wanted:
            at = {name: part.at(frame) for name, part in parts.items()}
            yield _moment(frame, at.get("cloth"), at.get("dye"), forces)


def _moment(frame: int, cloth: Any, dye: Any, forces: bool) -> FrameState:
    """`cloth` is a simulation, `dye` a dyeing, None for what the scene has not."""
    phi, fixed = (dye.state.phi.copy(), dye.state.fixed.copy()) if dye is not None else (None, None)
    if cloth is None:
        none = np.zeros((0, 3))
        return FrameState(frame, dye.t, dye.digest(), none, none, phi=phi, fixed=fixed)
    x, v = cloth.state.x.copy(), cloth.state.v.copy()
    if forces:
        return Acted(frame, cloth.t, cloth.digest(), x, v, deepcopy(cloth.fabric), cloth.present_forces(), phi, fixed)
    return FrameState(frame, cloth.t, cloth.digest(), x, v, deepcopy(cloth.fabric), None, phi, fixed)


class _Part:
    """What one service stepped, at whichever frame is wanted."""

    def __init__(self, recording: Recording, make: Callable[[], Stepper]) -> None:
        self._recording, self._make, self._stepper = recording, make, make()
        marks = recording.marks(self._stepper.status.name)
        self._times = {frame: time for time, (frame, _) in marks.items()}
        self._digests = dict(marks.values())
        self._changed = {event.frame for event in control_events(recording)}
        self._again: Resimulation | None = None

    def at(self, frame: int) -> Stepper:
        """The same at a frame. Raises BadInput where its digest is another."""
        again, path = self._again, str(self._recording.path)
        if again is None or not again.stepper.frame <= frame <= again.stepper.frame + 1:
            number, start = self._nearest(frame)
            if again is None or not number <= again.stepper.frame <= frame:
                if again is not None:  # the first time, with what has not begun yet
                    self._stepper = self._make()
                again = self._again = Resimulation(self._recording, self._stepper, start)
        again.go_to(frame)
        if not again.comes_to(self._digests.get(frame)):
            part = again.stepper.part
            problem = f"simulated again, frame {frame} of the {part} comes out otherwise than it was recorded"
            raise BadInput(problem, path, remedy="nuno verify says where, and what is another than it was then")
        return again.stepper

    def _nearest(self, frame: int) -> tuple[int, Recorded | None]:
        """Frame and message of the last checkpoint from which a frame can be reached; -1 and None from the start."""
        log_time = self._times.get(frame, -1)
        while (message := self._recording.last(self._stepper.kept.name, log_time / 1e9)) is not None:
            number = next((n for n, time in self._times.items() if time == message.log_time), frame)
            same = self._recording.checkpoint(message).digest == self._digests.get(number)
            if number < frame or (number not in self._changed and same):
                return number, message
            log_time = message.log_time - 1
        return -1, None
