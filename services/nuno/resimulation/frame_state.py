"""Frames of a recording in float64: between checkpoints they are simulated again, to the same bits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.exports.cloth import read_pressure
from nuno.output_files import writing
from nuno.recording.reader import Recording, control_events, opened
from nuno.recording.recorded import Recorded, per_dye
from nuno.resimulation.verification import steppers
from nuno.runtime.stepper import Resimulation, Stepper
from nuno.scene.recorded_scene import restored_scene
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.messages import DYE_CHECKPOINT
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
        kicked = forces and hasattr(loaded.integrator.plugin, "steps_a_kick")  # no checkpoint has its last kick
        for frame in wanted:
            at = {name: part.at(frame, stepped=kicked) for name, part in parts.items()}
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

    def at(self, frame: int, stepped: bool = False) -> Stepper:
        """Return the stepper at a frame, which it has `stepped` to, as forces of a solver that kicks need, and not
        taken from a checkpoint. Raises BadInput where its digest differs.
        """
        resimulation, path = self._resimulation, str(self._recording.path)
        if resimulation is None or not resimulation.stepper.frame <= frame <= resimulation.stepper.frame + 1:
            number, start = self._nearest(frame, stepped)
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

    def _nearest(self, frame: int, before: bool) -> tuple[int, Recorded | None]:
        """Return frame and message of the last checkpoint up to a frame, or `before` it; -1 and None for the start."""
        log_time = self._times.get(frame, -1)
        while (message := self._recording.last(self._stepper.kept.name, log_time / 1e9)) is not None:
            number = next((n for n, time in self._times.items() if time == message.log_time), frame)
            same = self._recording.checkpoint(message).digest == self._digests.get(number)
            if number < frame or (number not in self._changed and same and not before):
                return number, message
            log_time = message.log_time - 1
        return -1, None


# Files of float64 arrays.


def export_npz(source: Recording | Path | str, path: Path, frame: int | None = None) -> Path:
    """Write the state at the last checkpoint: x, v (n, 3) and t, for a knit `pressure` (n,) [Pa], all float64.

    With `frame` write the state of that frame, which is simulated again unless it has a checkpoint. For dyed cloth the
    arrays are phi, fixed and t; the amounts are (2, ny, nx), or (dyes, 2, ny, nx) for several dyes, as in the file of
    the cloth `cells`. A dyed garment has all of these.

    The solver's memory is not written: runs are resumed from the recording. Raises BadInput without a checkpoint or
    such a frame, or if the file cannot be written.
    """
    with opened(source) as recording:
        if frame is None:
            arrays = {}
            if not recording.dyed_alone:
                point = recording.last_checkpoint()
                arrays = _with_pressure(recording, {"x": point.x, "v": point.v, "t": np.array(point.t)})
            if DYE_CHECKPOINT.name in recording.counts:
                point = recording.last_checkpoint(topic=DYE_CHECKPOINT.name)
                arrays |= {name: per_dye(values) for name, values in point.state.items()} | {"t": np.array(point.t)}
        else:
            arrays = _state(recording, find_moment(recording, frame))
        _write(path, arrays)
    return path


def find_moment(recording: Recording, frame: int | None, forces: bool = False) -> FrameState:
    """Return the state of a frame (default: the last). Raises BadInput."""
    numbers = [number for number, digest in recording.marks().values() if digest]
    return next(states(recording, [(numbers or [0])[-1] if frame is None else frame], forces))


def export_forces(source: Recording | Path | str, path: Path, frame: int | None = None) -> Path:
    """Write the forces on cloth in a frame (default: the last), and its state, as float64 arrays.

    x, v, acceleration and force_KIND (n, 3), mass and pinned (n,), spring_pairs (s, 2), spring_k, spring_rest,
    spring_c and spring_tension (s,), frame and t: SI units, defined in nuno_schemas.system.Forces. Raises BadInput for
    a recording of dye alone, a missing frame, and a file that cannot be written.
    """
    with opened(source) as recording:
        if recording.dyed_alone:
            problem, remedy = "a cloth that is dyed alone feels no forces", "--npz gives its amounts"
            raise BadInput(problem, str(recording.path), field="--forces", remedy=remedy)
        moment = find_moment(recording, frame, forces=True)
        assert isinstance(moment, Acted)
        fabric, acting = moment.fabric, moment.forces
        arrays = {"frame": np.array(moment.frame), **_state(recording, moment)}
        arrays |= {"mass": fabric.mass, "pinned": fabric.pinned, "acceleration": acting.acceleration}
        arrays |= {f"force_{kind}": force for kind, force in acting.parts.items()}
        if (springs := fabric.springs) is not None:
            each: dict[str, NDArray[Any]] = {
                name: springs.per_spring(getattr(springs, name)) for name in ("k", "rest", "c")
            }
            each |= {"pairs": springs.pairs(), "tension": acting.tension}
            arrays |= {f"spring_{name}": values for name, values in each.items()}
        _write(path, arrays)
    return path


def _write(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    with writing(path, ".npz") as new, new.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def _state(recording: Recording, moment: FrameState) -> dict[str, NDArray[Any]]:
    """Return x, v and a knit's pressure of cloth, and phi and fixed of dye."""
    arrays: dict[str, NDArray[Any]] = {"t": np.array(moment.t)}
    if moment.fabric is not None:
        arrays |= _with_pressure(recording, {"x": moment.x, "v": moment.v})
    if moment.phi is not None and moment.fixed is not None:
        arrays |= {"phi": per_dye(moment.phi), "fixed": per_dye(moment.fixed)}
    return arrays


def _with_pressure(recording: Recording, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    measured = read_pressure(recording)
    return arrays if measured is None else arrays | {"pressure": measured(arrays["x"])}
