"""Amounts of dye that are recorded more rarely than frames: when, and that nothing else notices."""

from __future__ import annotations

from pathlib import Path

import garment_scene
import pytest
from dye_scene import write_scene
from PIL import Image

import nuno
from nuno.cli import main
from nuno.recording.reader import Recording
from nuno.scene import scene_file
from nuno.service import Options
from nuno.supervision import supervisor
from nuno.verification import verify
from nuno_schemas.messages import CONCENTRATION, DYE_STATUS


def frames(recording: Recording) -> list[int]:
    """Those whose amounts are there."""
    marks = recording.marks(DYE_STATUS.name)
    return [marks[message.log_time][0] for message in recording.messages([CONCENTRATION.name])]


def amounts(recording: Recording) -> list[bytes]:
    return [message.payload for message in recording.messages([CONCENTRATION.name])]


RARE = {"dye_every": "5.4 s"}
"""Each third frame."""


@pytest.fixture(scope="module")
def rare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rare")
    return nuno.run(write_scene(folder, record=RARE), record=folder / "run.mcap").path


def test_amounts_come_at_their_interval_and_at_the_end(rare: Path) -> None:
    with nuno.open(rare) as recording:
        assert recording.complete and frames(recording) == [0, 3, 6, 9, 10]
        assert recording.counts[DYE_STATUS.name] == 11 and verify(recording).compared == 11
        shown = amounts(recording)
    every = nuno.run(write_scene(rare.parent), record=rare.with_name("every.mcap")).recording
    assert frames(every) == list(range(11))
    assert shown == [amounts(every)[frame] for frame in (0, 3, 6, 9, 10)]


def test_an_interval_longer_than_services_may_lag_behind_holds_nothing_up(tmp_path: Path) -> None:
    result = nuno.run(write_scene(tmp_path, record={"dye_every": "1 h"}), record=tmp_path / "run.mcap")
    assert result.recording.complete and frames(result.recording) == [0, 10]


def test_a_resumed_run_records_what_an_unbroken_one_does(tmp_path: Path) -> None:
    """From a checkpoint at frame 4, of which the amounts are recorded for that."""
    record = RARE | {"checkpoint_every": "7.2 s"}
    whole = nuno.run(write_scene(tmp_path, record=record), record=tmp_path / "whole.mcap").recording
    assert frames(whole) == [0, 3, 4, 6, 8, 9, 10]
    part = nuno.run(write_scene(tmp_path, record=record), "duration=7.2 s", record=tmp_path / "part.mcap")
    options = Options(record=tmp_path / "on.mcap", resume=part.path)
    assert supervisor.supervise(scene_file.read(write_scene(tmp_path, record=record)), options).state == "done"
    with nuno.open(tmp_path / "on.mcap") as resumed:
        assert frames(resumed) == frames(whole) and amounts(resumed) == amounts(whole)
        assert verify(resumed).frame is None


def test_a_garment_s_dye_is_as_rare_as_asked(tmp_path: Path) -> None:
    scene = garment_scene.write(tmp_path, record={"dye_every": 0.06})
    result = nuno.run(scene, record=tmp_path / "run.mcap")
    assert result.recording.complete and frames(result.recording) == [0, 3, 6, 9, 10]
    assert verify(result.recording).dyed == 11


def test_exports_take_what_is_there(rare: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(rare), "--gif", str(tmp_path / "a.gif"), "--png", str(tmp_path / "a.png")]) == 0
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == 5  # type: ignore[attr-defined]
    assert main(["export", str(rare), "--png", str(tmp_path / "b.png"), "--frame", "6"]) == 0
    capsys.readouterr()
    assert main(["export", str(rare), "--png", str(tmp_path / "c.png"), "--frame", "7"]) == 2
    assert "the nearest is frame 6" in capsys.readouterr().err
    assert main(["export", str(rare), "--png", str(tmp_path / "c.png"), "--frame", "11"]) == 2
    assert "no such frame" in capsys.readouterr().err


def test_a_replay_from_between_begins_with_what_was_there(rare: Path, tmp_path: Path) -> None:
    from rrd import read

    for start, shown in ((0.0, 5), (8.0, 4)):
        target = tmp_path / f"{start:g}.rrd"
        assert main(["replay", str(rare), "--fast", "--start", str(start), "--save", str(target)]) == 0
        assert len(read(target, "/dye/picture", "EncodedImage:blob")) == shown


def test_a_plan_counts_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = []
    for record in ({}, RARE):
        assert main(["plan", str(write_scene(tmp_path, record=record))]) == 0
        said.append(next(line for line in capsys.readouterr().out.splitlines() if line.startswith("storage")))
    sizes = [float(line.split()[1]) for line in said]
    # Float32 of 11 frames or of 5, and one checkpoint of float64.
    assert sizes[1] / sizes[0] == pytest.approx((8 * 5 + 16) / (8 * 11 + 16), rel=0.01)
