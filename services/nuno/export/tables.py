"""The last checkpoint as NumPy arrays, and the report's series as a table."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.export.pressure import read_pressure
from nuno.export.target import opened, writing
from nuno.recording.reader import Recording
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import DYE_CHECKPOINT

UNITS = {"balance": "1", "t": "s", "time": "s", "step_seconds": "s", "depth": "m", "mean": "m", "stretch": "1"}


def export_npz(source: Recording | Path | str, path: Path, t: float | None = None) -> Path:
    """Write the last checkpoint (not after t [s]): x, v (n, 3) and t, of a knit `pressure` (n,) [Pa], all float64.

    Of a cloth that is dyed: phi, fixed and t; the amounts are (2, ny, nx), or (dyes, 2, ny, nx) for
    several dyes, as in the file of the cloth `cells`. Of a garment that is dyed all of these.

    Solver memory stays in the recording, from which a run is resumed. Raises BadInput where
    there is no checkpoint or the file cannot be written.
    """
    with opened(source) as recording:
        arrays = {} if recording.dyed_alone else _cloth(recording, t)
        arrays |= _dye(recording, t) if DYE_CHECKPOINT.name in recording.counts else {}
        with writing(path, ".npz") as new, new.open("wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)
    return path


def _cloth(recording: Recording, t: float | None) -> dict[str, NDArray[Any]]:
    point = recording.last_checkpoint(before=t)
    arrays = {"x": point.x, "v": point.v, "t": np.array(point.t)}
    measured = read_pressure(recording)
    return arrays if measured is None else arrays | {"pressure": measured(point.x)}


def _dye(recording: Recording, t: float | None) -> dict[str, NDArray[Any]]:
    from nuno.dye.checkpoint import last_checkpoint, per_dye

    point = last_checkpoint(recording, t)
    return {"phi": per_dye(point.phi), "fixed": per_dye(point.fixed), "t": np.array(point.t)}


def export_csv(source: Recording | Path | str, path: Path) -> Path:
    """Write one row a frame: time, energies, stretch, steps, penetration, amounts of dye; empty where unknown.

    Columns are named as the recording's series, with the unit behind: `t [s]`, `energy_kinetic [J]`;
    a number that only counts has none. Numbers are written with all their digits. Raises BadInput where there are none.
    """
    with opened(source) as recording:
        series = recording.series()
        if not series:
            raise BadInput("the recording holds no status, so no series", str(recording.path))
        with writing(path, ".csv") as new, new.open("w", newline="", encoding="utf-8") as stream:
            table = csv.writer(stream)
            table.writerow(map(_heading, series))
            for row in zip(*(column.tolist() for column in series.values()), strict=True):
                table.writerow("" if value != value else repr(value) for value in row)
    return path


def _heading(name: str) -> str:
    unit = "J" if name.startswith("energy_") else "m" if name.startswith("wrinkles_") else UNITS.get(name)
    return name if unit is None else f"{name} [{unit}]"
