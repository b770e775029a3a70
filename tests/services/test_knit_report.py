"""What a run of a knit tells: how long its courses are, and what it presses with; in the report, a table, a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nuno
from nuno.cli import main
from nuno.exports.cloth import SIDES
from nuno.exports.pictures import Painter
from nuno.recording.reader import open_recording
from nuno.report.run_report import lines
from nuno.resimulation.frame_state import export_npz
from nuno.scene import scene_file, shipped
from nuno.simulation import cloth
from nuno.simulation.yarns import measure_courses
from nuno_schemas.colour import colours
from nuno_schemas.errors import BadInput

WALES, COURSES, SPACING, K, GIRTH = 12, 14, 0.01, 40.0, 0.353
SCENE = f"""nuno: 1
name: bandage
duration: 1 s
frame_rate: 20 Hz
damping: 20
solver: symplectic_euler
gravity: [0, 0, 0]
contact: {{plugin: sliding, gap: 1 mm}}
bodies:
  - name: leg
    collider: {{plugin: mesh, shape: leg, resolution: 24}}
objects:
  - name: bandage
    model:
      plugin: knit
      form: tube
      wales: {WALES}
      courses: {COURSES}
      spacing: [{SPACING} m, {SPACING} m]
      stretch: [1.8, 1]
      yarns: [{{name: one, k: {K} N/m, mu: 0}}, {{name: two, k: {K} N/m, mu: 0}}]
      mass: 1 g
      pin: [top-row, bottom-row]
      centre: [0, 0.455 m, 0.012 m]
"""
"""About a leg's knee and no other place that has a name."""


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("bandage")
    (folder / "bandage.yaml").write_text(SCENE)
    return folder / "run.mcap", nuno.run(folder / "bandage.yaml", record=folder / "run.mcap").report


def test_courses_are_as_long_as_their_links_together() -> None:
    """All links at 1.5 of their rest; then the last course's legs, ten of its nineteen links, by 1 m more."""
    fabric, _ = cloth.build_fabric(scene_file.read(shipped.find("knit/stitch-10x10")))
    found = measure_courses(fabric, fabric.position)
    assert len(found["rest"]) == 9 and found["min"] == pytest.approx(1.5) == found["max"]
    x = fabric.position.copy()
    x[-10:, 1] += 1.0
    longer = measure_courses(fabric, x)
    assert longer["longest"] == 8 and longer["min"] == pytest.approx(1.5)
    assert longer["max"] == pytest.approx(1.5 + 10.0 / 19.0)


def test_the_report_tells_of_courses_and_of_the_knee(ran: tuple[Path, dict[str, Any]]) -> None:
    _, report = ran
    assert report["courses"]["min"] > 1.1 and len(report["courses"]["present"]) == COURSES
    pressure = report["pressure"]
    assert set(pressure) == {"min", "mean", "max", "knee"}
    # Whatever its shape, a hoop of tension T and girth G presses with 2 pi T / (G w) on average.
    tension = K * (GIRTH / (2 * WALES) - SPACING)
    assert pressure["knee"] == pytest.approx(2.0 * np.pi * tension / (GIRTH * SPACING), rel=0.1)
    text = dict(lines(report))
    assert f"{COURSES} of" in text["courses"] and "knee" in text["pressure"] and "ankle" not in text["pressure"]


def test_a_table_and_a_picture_have_it_point_by_point(ran: tuple[Path, dict[str, Any]]) -> None:
    path, report = ran
    arrays = np.load(export_npz(path, path.with_suffix(".npz")))
    inner = arrays["pressure"].reshape(COURSES + 1, -1)[1:-1]
    assert inner.min() == pytest.approx(report["pressure"]["min"], rel=1e-12)
    with open_recording(path) as recording:
        last = list(recording.frames())[-1]
        painter = Painter(recording, [last], (96, 64), colour="pressure")
        shown = painter.meshes(last)[0].colours
        assert painter.legend is not None and painter.legend["label"] == "pressure [Pa]"
        assert shown is not None and painter.pressure is not None
        by_point = colours(np.maximum(painter.pressure(last.x), 0.0), 0.0, painter.most)
        owner = np.repeat(painter.pieces(last.t)[0].edges, SIDES, axis=1).reshape(-1)
        assert np.array_equal(shown, by_point[owner])


def test_what_is_no_knit_has_no_pressure_to_be_painted_by(tmp_path: Path) -> None:
    nuno.run("net", "duration=0.1", record=tmp_path / "net.mcap")
    with open_recording(tmp_path / "net.mcap") as recording, pytest.raises(BadInput, match="no knit"):
        Painter(recording, list(recording.frames())[-1:], colour="pressure")
    wanted = ["--npz", str(tmp_path / "a.npz"), "--png", str(tmp_path / "a.png"), "--colour", "pressure"]
    assert main(["export", str(tmp_path / "net.mcap"), *wanted]) == 2
    assert not (tmp_path / "a.npz").exists()
