"""The last checkpoint as NumPy arrays, and the report's series as a table."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from nuno.export.target import opened, writing
from nuno.recording.reader import Recording
from nuno_schemas.errors import BadInput

UNITS = {"t": "s", "step_seconds": "s", "depth": "m", "mean": "m", "stretch": "1"}


def export_npz(source: Recording | Path | str, path: Path, t: float | None = None) -> Path:
    """Write the last checkpoint (not after t [s]): x, v (n, 3) and t, all float64, and no more.

    Solver memory stays in the recording, from which a run is resumed. Raises BadInput where
    there is no checkpoint or the file cannot be written.
    """
    with opened(source) as recording:
        point = recording.last_checkpoint(before=t)
        with writing(path, ".npz") as new, new.open("wb") as stream:
            np.savez(stream, x=point.x, v=point.v, t=np.float64(point.t))
    return path


def export_csv(source: Recording | Path | str, path: Path) -> Path:
    """Write one row a frame: time, energies, stretch, steps, penetration; empty where unknown.

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
    unit = "J" if name.startswith("energy_") else UNITS.get(name)
    return name if unit is None else f"{name} [{unit}]"
