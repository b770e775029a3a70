"""Export of checkpoints, frames and forces as NumPy arrays, of series as a table, and of the scene as text."""

from __future__ import annotations

import csv
import os
from pathlib import Path

from nuno.output_files import make_folder, replacing, together, writing
from nuno.recording.reader import Recording, control_events, describe_changes, opened
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
    "area": "m^2",
    "area_depth": "m",
    "stretch": "1",
    "distance": "m",
    "dt": "s",
    "dt_limit": "s",
}
FAMILIES = {"energy_": "J", "wrinkles_": "m", "force_": "N", "pressure_": "Pa"}
"""Units of columns by the start of their names."""


def export_scene(source: Recording | Path | str, path: Path) -> list[Path]:
    """Write the recorded scene, with a comment on each field, and the files that it names next to it; return the
    written files. Raises BadInput for a recording without a scene, or with one that this version refuses, and where
    another file would be lost.
    """
    with together(), opened(source) as recording, restored_scene(recording) as loaded, writing(path, ".yaml") as new:
        missing = {file: data for file, data in scene_files(recording, path).items() if not file.exists()}
        head = [f"# the scene of {recording.path.name}"]
        head += [f"# with {name}, which is to lie beside it" for name in recording.attachments]
        head += [f"# without a change during the run: {text}" for text in describe_changes(control_events(recording))]
        new.write_text("\n".join([*head, comment(loaded)]), encoding="utf-8")
        for file, data in missing.items():
            for folder in reversed(file.relative_to(path.parent).parents[:-1]):
                make_folder(path.parent / folder)
            with replacing(file) as part:
                part.write_bytes(data)
    return [path, *missing]


def scene_files(recording: Recording, path: Path) -> dict[Path, bytes]:
    """Return the files that belong next to an exported scene. Raises BadInput where another file is there."""
    files = {path.parent / name: recording.attachment(name) for name in recording.attachments}
    for file, data in files.items():
        if os.path.lexists(file) and not (file.is_file() and file.read_bytes() == data):
            problem = "the scene names a file, and another one is there"
            raise BadInput(problem, field="--scene", value=str(file), remedy="choose another folder, or move it away")
    return files


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
