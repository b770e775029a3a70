"""Export of checkpoints, frames and forces as NumPy arrays, of series as a table, and of the scene as text."""

from __future__ import annotations

import csv
from pathlib import Path

from nuno.output_files import writing
from nuno.recording.reader import Recording, opened
from nuno.scene.edit import comment
from nuno.scene.recorded_scene import restored_scene
from nuno_schemas.errors import BadInput

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
