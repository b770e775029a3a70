"""Export of checkpoints, frames and forces as NumPy arrays, of series as a table, and of the scene as text."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.exports.cloth import read_pressure
from nuno.output_files import writing
from nuno.recording.reader import Recording, opened
from nuno.recording.recorded import per_dye
from nuno.replay.frame_state import Acted, FrameState, states
from nuno.scene.edit import comment
from nuno.scene.recorded_scene import restored_scene
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import DYE_CHECKPOINT

UNITS = {
    "balance": "1",
    "t": "s",
    "time": "s",
    "step_seconds": "s",
    "depth": "m",
    "mean": "m",
    "stretch": "1",
    "distance": "m",
    "dt": "s",
    "dt_limit": "s",
}
FAMILIES = {"energy_": "J", "wrinkles_": "m", "force_": "N", "pressure_": "Pa"}
"""Units of columns by the start of their names."""


def export_scene(source: Recording | Path | str, path: Path) -> Path:
    """Write the recorded scene, with a comment on each field. Raises BadInput for a recording without a scene, or with
    one that this version refuses.
    """
    with opened(source) as recording, restored_scene(recording) as loaded, writing(path, ".yaml") as new:
        head = [f"# the scene of {recording.path.name}"]
        head += [f"# with {name}, which is to lie beside it" for name in recording.attachments]
        new.write_text("\n".join([*head, comment(loaded)]), encoding="utf-8")
    return path


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


def export_csv(source: Recording | Path | str, path: Path) -> Path:
    """Write one row per frame: time, energies, stretch, steps, penetration, amounts of dye; empty if unknown.

    Columns are named as the recording's series, followed by the unit: `t [s]`, `energy_kinetic [J]`;
    counts have no unit. Numbers are written with all their digits. Raises BadInput for a recording without series.
    """
    with opened(source) as recording:
        series = recording.series()
        if not series:
            raise BadInput("the recording holds no status, so no series", str(recording.path))
        with writing(path, ".csv") as new, new.open("w", newline="", encoding="utf-8") as stream:
            table = csv.writer(stream)
            table.writerow(map(heading, series))
            for row in zip(*(column.tolist() for column in series.values()), strict=True):
                table.writerow("" if value != value else repr(value) for value in row)
    return path


def heading(name: str) -> str:
    """Return a column's name with its unit, if it has one: `dt [s]`."""
    unit = next((unit for start, unit in FAMILIES.items() if name.startswith(start)), UNITS.get(name))
    return name if unit is None else f"{name} [{unit}]"
