"""Recordings in one view: beside each other or over each other, with the distance between them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dye_scene
import numpy as np
import pytest
import recorded_sheet
from recorded_sheet import Sheet
from rrd import columns, curves, read

import nuno
from nuno.cli import main
from nuno.recording.reader import open_recording
from nuno.recording.writer import RecordingWriter
from nuno_schemas.fabric import Float

FRAMES, SHIFT = 6, np.array([0.0, 0.03, -0.04])


class Shifted(Sheet):
    """The same sheet, that moves 5 cm away from where it would be within the time of FRAMES."""

    def x(self, t: float) -> Float:
        return super().x(t) + SHIFT * (t * recorded_sheet.RATE / (FRAMES - 1))


def record(folder: Path, name: str, sheet: Sheet, **options: Any) -> Path:
    path = folder / f"{name}.mcap"
    recorded_sheet.write(path, sheet, **({"frames": FRAMES} | options))
    return path


@pytest.fixture
def pair(tmp_path: Path) -> list[str]:
    return [str(record(tmp_path, "still", Sheet())), str(record(tmp_path, "away", Shifted()))]


@pytest.mark.parametrize("over", [False, True])
def test_curves_share_plots_and_cloth_of_equal_triangles_has_its_distance(
    over: bool, pair: list[str], tmp_path: Path
) -> None:
    saved = tmp_path / "both.rrd"
    assert main(["view", *pair, "--save", str(saved), *(["--over"] if over else [])]) == 0
    apart = curves(saved, "/plots/difference")
    assert set(apart) == {"largest/away", "root mean square/away"}
    for values in apart.values():
        assert [values[n] for n in range(FRAMES)] == pytest.approx([10.0 * n for n in range(FRAMES)], abs=1e-3)
    assert len(read(saved, "/world/away/cloth/cloth", "difference:colors")) == FRAMES
    shifts = [columns(saved, "Transform3D:translation")[f"/world/{name}"][0][0] for name in ("still", "away")]
    assert shifts[0] == [0.0, 0.0, 0.0]
    assert (shifts[1] == [0.0, 0.0, 0.0]) is over
    with open_recording(Path(pair[1])) as recording:
        for number, frame in enumerate(recording.frames()):
            shown = np.array(read(saved, "/world/away/cloth/cloth", "Mesh3D:vertex_positions")[number])
            assert np.array_equal(shown, frame.x.astype(np.float32))


def test_scenes_side_by_side_do_not_overlap_as_seen(pair: list[str], tmp_path: Path) -> None:
    """Along what is to the right of the first scene's camera."""
    saved = tmp_path / "three.rrd"
    assert main(["view", *pair, pair[0], "--save", str(saved)]) == 0
    names = ["1 still", "2 away", "3 still"]
    shifts = columns(saved, "Transform3D:translation")
    right, edge = np.array([np.cos(0.6), 0.0, -np.sin(0.6)]), -np.inf
    for name in names:
        path = f"/world/{name}".replace(" ", "\\ ")
        x = np.array(read(saved, f"{path}/cloth/cloth", "Mesh3D:vertex_positions")[0]) + shifts[path][0][0]
        assert (x @ right).min() > edge
        edge = (x @ right).max()


def test_cloth_of_other_triangles_has_no_distance(tmp_path: Path) -> None:
    one, other = record(tmp_path, "one", Sheet()), record(tmp_path, "other", Sheet(5, 6))
    assert main(["view", str(one), str(other), "--save", str(tmp_path / "both.rrd")]) == 0
    assert not curves(tmp_path / "both.rrd", "/plots/difference")
    assert set(curves(tmp_path / "both.rrd", "/plots/energy")) >= {"total/one", "total/other"}


def test_dyes_are_compared_in_pictures_and_amounts(tmp_path: Path) -> None:
    paths = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        scene = dye_scene.write_scene(tmp_path / name)
        paths.append(str(nuno.run(scene, record=tmp_path / f"{name}.mcap").path))
    saved = tmp_path / "both.rrd"
    assert main(["view", *paths, "--save", str(saved)]) == 0
    pictures = columns(saved, "EncodedImage:blob")
    assert set(pictures) == {"/picture/a", "/picture/b"}
    assert pictures["/picture/a"] == pictures["/picture/b"]
    amounts = curves(saved, "/plots/dye/blue")
    assert set(amounts) == {f"{kind}/{run}" for kind in ("supplied", "total", "mobile", "fixed") for run in "ab"}
    assert amounts["fixed/a"] == amounts["fixed/b"]


def test_recordings_that_cannot_be_compared_are_refused(pair: list[str], tmp_path: Path) -> None:
    dyed = nuno.run(dye_scene.write_scene(tmp_path), record=tmp_path / "dyed.mcap").path
    saved = tmp_path / "both.rrd"
    assert main(["view", pair[0], str(dyed), "--save", str(saved)]) == 2
    late = RecordingWriter(tmp_path / "late.mcap", recorded_sheet.metadata(), {})
    for topic, header, payload in recorded_sheet.items(Sheet(), FRAMES):
        late.write(topic, header.model_copy(update={"t": header.t + 100.0}), payload)
    assert main(["view", pair[0], str(late.finish({})), "--save", str(saved)]) == 2
    assert main(["view", pair[0], "--over", "--save", str(saved)]) == 2
    assert not list(tmp_path.glob("*.rrd*"))


def test_a_field_is_seen_first_or_refused_where_it_is_not(pair: list[str], tmp_path: Path) -> None:
    saved = tmp_path / "both.rrd"
    assert main(["view", *pair, "--colour", "difference", "--save", str(saved)]) == 0
    saved.unlink()
    assert main(["view", pair[0], "--colour", "difference", "--save", str(saved)]) == 2
    assert main(["view", *pair, "--colour", "tension", "--save", str(saved)]) == 2
    assert not list(tmp_path.glob("*.rrd*"))


def test_an_interrupted_comparison_keeps_the_file_of_before_and_leaves_no_part(
    pair: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved = tmp_path / "both.rrd"
    assert main(["view", *pair, "--save", str(saved)]) == 0
    before = saved.read_bytes()

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("nuno.viewer.comparison._log_difference", interrupt)
    assert main(["view", *pair, "--save", str(saved)]) == 1
    assert saved.read_bytes() == before
    assert list(tmp_path.glob("*.rrd*")) == [saved]
