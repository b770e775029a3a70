"""Maps of scenes of dye: limits scale with the coefficient, break what is above them, and sweeps go on."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
from dye_scene import D0, arrays, write_scene

from nuno.cli import main
from nuno_bench.stability.dye import FACTORS, FRAMES, LONGEST, dye_settings, pose_dye, prepare_dye
from nuno_bench.stability.sweep import settings_of


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random cells, full ones beside empty ones, some resisted, for ten frames of nine seconds."""
    folder = tmp_path_factory.mktemp("dye")
    return write_scene(folder, data=arrays(14, 15), name="dyed", duration="90 s", frame_rate=1 / 9.0)


@pytest.fixture(scope="module")
def out(scene: Path) -> Path:
    folder = scene.parent / "out"
    flags = ["--budget", "60", "--jobs", "1", "--out", str(folder), "--solvers", "explicit"]
    assert main(["bench", "stability", str(scene), *flags]) == 0
    return folder


def test_settings_are_the_scene_with_other_coefficients_and_few_frames(scene: Path) -> None:
    settings, omissions = settings_of(scene, [])
    assert omissions == [] and {setting.axis for setting in settings} == {"diffusion"}
    assert settings[0].value == 1.0 and sorted(setting.value for setting in settings) == list(FACTORS)
    for setting in settings:
        with pose_dye(setting) as posed:
            assert posed.problem.frames == FRAMES
            (dye,) = posed.problem.start.system.dyes
            assert dye.D0 / setting.value == pytest.approx(D0, rel=1e-12)


def test_frames_of_a_map_hold_few_steps_however_long_the_scene_s_own_are(tmp_path: Path) -> None:
    path = write_scene(tmp_path, data=arrays(6, 7), duration="10 h", frame_rate=1 / 3600.0)
    with pose_dye(dye_settings(path, [])[0]) as posed:
        plugin = posed.problem.loaded.dye.solver.plugin  # type: ignore[union-attr]
        assert posed.frame == pytest.approx(LONGEST * posed.limit(plugin, plugin.Config()), rel=1e-9)
        assert posed.problem.frames == FRAMES


def test_steps_are_the_same_for_every_factor_and_reach_a_tenth_of_the_limit(scene: Path) -> None:
    found = []
    for setting in dye_settings(scene, []):
        with pose_dye(setting) as posed:
            found.append(prepare_dye(posed, setting)[0])
            if setting.value == 1.0:
                plugin = posed.problem.loaded.dye.solver.plugin  # type: ignore[union-attr]
                limit = posed.limit(plugin, plugin.Config())
    assert all(counts == found[0] for counts in found)
    assert 9.0 / found[0][-1] <= 0.1 * limit < 9.0 / found[0][-2]


def test_the_map_breaks_at_the_stated_limit(out: Path) -> None:
    rows = json.loads((out / "stability-scene.json").read_text())["rows"]
    limits = {row["value"]: row["limit"] for row in rows}
    assert [limits[f] * f for f in FACTORS] == pytest.approx([limits[1.0]] * len(FACTORS), rel=1e-9)
    points = [(point["dt"] / row["limit"], point) for row in rows for point in row["points"]]
    # Where the coefficient is small, a share of the limit is the whole run.
    below = {point["outcome"] for share, point in points if share < 0.25 and point["value"] >= 1.0}
    above = {point["outcome"] for share, point in points if share > 1.3}
    assert below <= {"exact", "accurate"} and above == {"drifting"}
    assert max(abs(point["gained"]) for _, point in points) < 1e-13, "unstable steps lose no dye either"


def test_errors_fall_with_the_step(out: Path) -> None:
    """The finest over the coarsest of those well below the limit: of first order."""
    rows = json.loads((out / "stability-scene.json").read_text())["rows"]
    slow = next(row for row in rows if row["value"] == 0.01)
    dt, error = (np.array([point[name] for point in slow["points"]]) for name in ("dt", "error"))
    assert np.polyfit(np.log(dt), np.log(error), 1)[0] == pytest.approx(1.0, abs=0.1)


def test_the_command_writes_page_table_and_data(out: Path) -> None:
    page = (out / "stability-scene.html").read_text()
    assert page.count("<svg") == 1 and "coefficient of diffusion" in page and "vertices" not in page
    data = json.loads((out / "stability-scene.json").read_text())
    with (out / "stability-scene.csv").open() as stream:
        lines = list(csv.DictReader(stream))
    assert len(lines) == sum(len(row["points"]) for row in data["rows"])
    assert all(math.isfinite(float(line["error"])) for line in lines)


def test_a_sweep_goes_on(scene: Path, out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = out / "stability-scene.rows.jsonl"
    lines = kept.read_text().splitlines()
    kept.write_text("\n".join(lines[:3]) + "\n")
    flags = ["--budget", "60", "--jobs", "1", "--out", str(out), "--solvers", "explicit", "--resume"]
    assert main(["bench", "stability", str(scene), *flags]) == 0
    assert capsys.readouterr().err.count("diffusion x") == len(lines) - 3
    assert kept.read_text().splitlines()[:3] == lines[:3]


def test_solvers_of_cloth_are_none_of_dye(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--solvers", "leapfrog", "--out", str(tmp_path / "out")]
    assert main(["bench", "stability", str(scene), *flags]) == 2
    assert "no such solver" in capsys.readouterr().err
    assert main(["bench", "stability", "net", str(scene), *flags]) == 2
    assert "none of these solvers can run the scene" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
