"""Frames of a recording as they were, in float64: between checkpoints they are simulated again, to the same bits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from nuno.recording.reader import Recording
from nuno.recording.recorded import Recorded
from nuno.recording.restore import control_events, restored_scene
from nuno.scene.scene_file import Loaded
from nuno.verify import Again
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.system import Forces

if TYPE_CHECKING:
    from nuno.dye.verify import DyeAgain
    from nuno.simulation.verify import ClothAgain

A = TypeVar("A", bound=Again)


@dataclass(frozen=True)
class Moment:
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


def states(
    recording: Recording, frames: Iterable[int] | None = None, forces: bool = False, threads: int = 0
) -> Iterator[Moment]:
    """Frames by their numbers (default: all), in order, each from the nearest checkpoint before it.

    What is simulated again is what was recorded: each frame's digest is compared. Raises BadInput for a recording
    without a scene, for a frame that is not in it, and where this version or processor comes to other bits.
    """
    known = {frame: digest for frame, digest in recording.marks().values() if digest}
    wanted = sorted(known if frames is None else set(frames))
    for frame in wanted:
        if frame not in known:
            limit = f"frames {min(known)} to {max(known)}" if known else "it holds none"
            problem = "no such frame in the recording"
            raise BadInput(problem, str(recording.path), field="--frame", value=frame, limit=limit)
    with restored_scene(recording) as loaded:
        cloth: _Part[ClothAgain] | None = None
        dye: _Part[DyeAgain] | None = None
        if loaded.scene.moves:
            from nuno.simulation.verify import ClothAgain

            cloth = _Part(ClothAgain, recording, loaded, threads)
        if loaded.dye is not None:
            from nuno.dye.verify import DyeAgain

            dye = _Part(DyeAgain, recording, loaded, threads)
        for frame in wanted:
            yield _moment(frame, cloth.at(frame) if cloth else None, dye.at(frame) if dye else None, forces)


def _moment(frame: int, cloth: ClothAgain | None, dye: DyeAgain | None, forces: bool) -> Moment:
    phi, fixed = (dye.dyeing.state.phi.copy(), dye.dyeing.state.fixed.copy()) if dye is not None else (None, None)
    if cloth is None:
        assert dye is not None
        none = np.zeros((0, 3))
        return Moment(frame, dye.t, dye.digest(), none, none, phi=phi, fixed=fixed)
    state, fabric = cloth.simulation.state, cloth.simulation.fabric
    acting = cloth.forces() if forces else None
    return Moment(frame, cloth.t, cloth.digest(), state.x.copy(), state.v.copy(), fabric, acting, phi, fixed)


class _Part(Generic[A]):
    """What one service stepped, at whichever frame is wanted."""

    def __init__(self, kind: type[A], recording: Recording, loaded: Loaded, threads: int) -> None:
        self._kind, self._recording, self._loaded, self._threads = kind, recording, loaded, threads
        marks = recording.marks(kind.status)
        self._times = {frame: time for time, (frame, _) in marks.items()}
        self._digests = dict(marks.values())
        self._changed = {event.frame for event in control_events(recording)}
        self._again: A | None = None

    def at(self, frame: int) -> A:
        """The same at a frame. Raises BadInput where its digest is another."""
        again, path = self._again, str(self._recording.path)
        if again is None or not again.frame <= frame <= again.frame + 1:
            number, start = self._nearest(frame)
            if again is None or not number <= again.frame <= frame:
                again = self._again = self._kind(self._recording, self._loaded, self._threads, start)
        again.go_to(frame)
        if again.digest() != self._digests.get(frame):
            # A change made before the first frame, of this run or of a resumed one, is in that frame already.
            again.change()
        if again.digest() != self._digests.get(frame):
            problem = f"simulated again, frame {frame} of the {again.part} comes out otherwise than it was recorded"
            raise BadInput(problem, path, remedy="nuno verify says where, and what is another than it was then")
        return again

    def _nearest(self, frame: int) -> tuple[int, Recorded | None]:
        """Frame and message of the last checkpoint from which a frame can be reached; -1 and None from the start."""
        log_time = self._times.get(frame, -1)
        while (message := self._recording.last(self._kind.checkpoint, log_time / 1e9)) is not None:
            number = next((n for n, time in self._times.items() if time == message.log_time), frame)
            if number < frame or (number not in self._changed and self._kept(message) == self._digests[number]):
                return number, message
            log_time = message.log_time - 1
        return -1, None

    def _kept(self, message: Recorded) -> str:
        """Digest of the state that a checkpoint holds."""
        return str(self._recording.arrays(message)[1].get("digest", ""))
