"""Frames of a recording in float64: between checkpoints they are simulated again, to the same bits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from nuno.recording.reader import Recording, control_events
from nuno.recording.recorded import Recorded
from nuno.replay.verification import steppers
from nuno.runtime.stepper import Resimulation, Stepper
from nuno.scene.recorded_scene import restored_scene
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.system import Forces


@dataclass(frozen=True)
class FrameState:
    """One frame of a run.

    x (n, 3) [m] and v (n, 3) [m/s] are float64 with the run's own bits, and digest is their hash. fabric has masses,
    springs and all other constants at this frame; forces are those in the frame, if requested. phi and fixed of dyed
    cloth are (dyes, 2, ny, nx); cloth that is only dyed has no vertices and no fabric, and digest is that of the
    amounts.
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
    """A frame of moving cloth with its fabric and forces."""

    fabric: Fabric
    forces: Forces


def states(
    recording: Recording, frames: Iterable[int] | None = None, forces: bool = False, threads: int = 0
) -> Iterator[FrameState]:
    """Yield frames by number (default: all), in order, each from the nearest checkpoint before it.

    Each frame's digest is compared with the recorded one. Raises BadInput for a recording without a scene, for a frame
    that is not in it, where this version or processor computes other bits, and for the forces of cloth that is only
    dyed.
    """
    recorded = {frame: digest for frame, digest in recording.marks().values() if digest}
    wanted = sorted(recorded if frames is None else set(frames))
    for frame in wanted:
        if frame not in recorded:
            raise recording.no_frame(frame, recorded)
    with restored_scene(recording) as loaded:
        if forces and not loaded.scene.moves:
            raise BadInput("a cloth that is dyed alone feels no forces", loaded.file, field="forces", value=forces)
        parts = {name: _Part(recording, make) for name, make in steppers(loaded, threads).items()}
        for frame in wanted:
            at = {name: part.at(frame) for name, part in parts.items()}
            yield _frame_state(frame, at.get("cloth"), at.get("dye"), forces)


def _frame_state(frame: int, cloth: Any, dye: Any, forces: bool) -> FrameState:
    """Return the present frame of `cloth`, a simulation, and `dye`, a dyeing; None for a missing one."""
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
        self._resimulation: Resimulation | None = None

    def at(self, frame: int) -> Stepper:
        """Return the stepper at a frame. Raises BadInput where its digest differs."""
        resimulation, path = self._resimulation, str(self._recording.path)
        if resimulation is None or not resimulation.stepper.frame <= frame <= resimulation.stepper.frame + 1:
            number, start = self._nearest(frame)
            if resimulation is None or not number <= resimulation.stepper.frame <= frame:
                if resimulation is not None:  # the first time, with the stepper at its start
                    self._stepper = self._make()
                resimulation = self._resimulation = Resimulation(self._recording, self._stepper, start)
        resimulation.go_to(frame)
        if not resimulation.comes_to(self._digests.get(frame)):
            part = resimulation.stepper.part
            problem = f"simulated again, frame {frame} of the {part} comes out otherwise than it was recorded"
            raise BadInput(problem, path, remedy="nuno verify says where, and what is another than it was then")
        return resimulation.stepper

    def _nearest(self, frame: int) -> tuple[int, Recorded | None]:
        """Return frame and message of the last checkpoint before a frame; -1 and None for the start."""
        log_time = self._times.get(frame, -1)
        while (message := self._recording.last(self._stepper.kept.name, log_time / 1e9)) is not None:
            number = next((n for n, time in self._times.items() if time == message.log_time), frame)
            same = self._recording.checkpoint(message).digest == self._digests.get(number)
            if number < frame or (number not in self._changed and same):
                return number, message
            log_time = message.log_time - 1
        return -1, None
