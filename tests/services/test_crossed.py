"""Cloth that meets cloth in a whole run: what is found of it where contact holds, and where it does nothing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nuno.cli import main
from nuno.recording.reader import open_recording
from nuno_contact.offset.plugin import Offset
from nuno_schemas.messages import PENETRATION
from nuno_schemas.system import Term

THICKNESS, FRAMES = 4e-3, 30


def sheet(name: str, height: float, tilt: str, *pinned: str) -> dict[str, Any]:
    model = {
        "plugin": "sheet", "size": [0.1, 0.1], "resolution": [7, 7], "plane": "xz", "centre": [0, height, 0],
        "rotate": {"axis": [1, 0, 0], "angle": tilt}, "fabric": "jacket", "pin": [*pinned],
    }  # fmt: skip
    return {"name": name, "model": model}


def run(folder: Path, **contact: Any) -> tuple[int, Path]:
    """A sheet falls on one that hangs at its edges, leaning, from above: exit code and recording."""
    scene = {
        "nuno": 1, "name": "fall", "duration": FRAMES / 100, "frame_rate": 100,
        "solver": {"plugin": "symplectic_euler", "dt": "0.2 ms"},
        "cloth_contact": {"plugin": "offset", "thickness": THICKNESS} | contact,
        "objects": [sheet("below", 0.0, "0 deg", "left-edge", "right-edge"), sheet("above", 0.05, "30 deg")],
    }  # fmt: skip
    path = folder / "fall.yaml"
    path.write_text(yaml.safe_dump(scene))
    record = folder / "fall.mcap"
    return main(["run", str(path), "--record", str(record), "--no-view"]), record


def read(record: Path) -> list[dict[str, Any]]:
    with open_recording(record) as recording:
        return [recording.json(message.payload) for message in recording.messages([PENETRATION.name])]


@pytest.fixture
def powerless(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cloth contact that does nothing."""
    monkeypatch.setattr(Offset, "prepare", lambda *args: Term("cloth_contact", ()))


def test_cloth_that_is_held_off_keeps_a_distance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """More than the thickness at first, then less, and never none; and the run succeeds."""
    code, record = run(tmp_path)
    said = capsys.readouterr().out
    frames = read(record)
    found = [frame["distance"] for frame in frames]
    near = [distance for distance in found if distance is not None]
    assert (code, len(frames)) == (0, FRAMES + 1)
    assert all(frame["crossings"] == 0 and frame["places"] == [] for frame in frames)
    assert found[0] is None and 0.0 < min(near) <= max(near) <= THICKNESS
    least = f"{1e3 * min(near):.3g} mm"
    assert f"cloth is pressed to within {least} of cloth; it pushes back from 4 mm on" in said
    assert main(["info", str(record)]) == 0
    told = capsys.readouterr().out
    assert f"{least}, in frame {found.index(min(near))}" in told and "passes through cloth in 0 of 31 frames" in told
    with open_recording(record) as recording:
        series = recording.series()
    assert np.array_equal(series["distance"], [np.nan if d is None else d for d in found], equal_nan=True)


def test_cloth_that_passes_through_is_told_with_frame_place_and_objects(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], powerless: None
) -> None:
    code, record = run(tmp_path)
    report, problem = capsys.readouterr()
    frames = read(record)
    number = next(i for i, frame in enumerate(frames) if frame["crossings"])
    crossed = [frame for frame in frames if frame["crossings"]]
    first = crossed[0]
    assert code == 1
    assert all(frame["distance"] == 0.0 for frame in crossed)
    assert {name for pair in first["objects"] for name in pair} == {"above", "below"}
    x, y, z = first["places"][0]
    with open_recording(record) as recording:
        points = next(frame.x for frame in recording.frames() if frame.number == number)
    assert np.abs(points - first["places"][0]).max(axis=1).min() < 0.02
    where = f"first in frame {number} ({number / 100:.4g} s), {' through '.join(first['objects'][0])} at"
    where += f" [{x:.4g}, {y:.4g}, {z:.4g}] m"
    assert f"passes through cloth in {len(crossed)} of 31 frames" in report and where in report and where in problem
    assert main(["info", "--json", str(record)]) == 0
    spells = json.loads(capsys.readouterr().out)["crossings"]
    assert spells[0]["frames"][0] == number and spells[0]["place"] == [x, y, z]
    assert sum(b - a + 1 for a, b in (spell["frames"] for spell in spells)) == len(crossed)
    assert main(["info", str(record)]) == 0
    assert f"frames {number} to" in capsys.readouterr().out


def test_what_may_pass_through_is_told_once(
    tmp_path: Path, powerless: None, capsys: pytest.CaptureFixture[str]
) -> None:
    code, record = run(tmp_path, allow=[["above", "below"]])
    assert "in 0 of 31 frames, but for below and above, which may" in capsys.readouterr().out
    assert code == 0
    assert {(frame["crossings"], frame["distance"]) for frame in read(record)} == {(0, None)}
