"""Dyed cloth in rerun: its pictures, each once, and the curves of its amounts; live, saved and from a recording."""

from __future__ import annotations

import functools
import io
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_scene import arrays, write_scene
from numpy.typing import NDArray
from PIL import Image
from rrd import curves, read

import nuno
from nuno.bus.encodings import decode_arrays, encode_arrays
from nuno.cli import main
from nuno.dye.painter import DyePainter
from nuno.scene import scene_file
from nuno.viewer import dyed
from nuno.viewer.bridge import Bridge
from nuno.viewer.file import RerunFile
from nuno.viewer.live import Ring
from nuno.viewer.stream import Subject, read_painter, scene_of
from nuno_schemas.messages import CONCENTRATION, FRAMES, STATE

PICTURE, COLUMN = "/picture", "EncodedImage:blob"
CURVES = "/plots/dye/blue"
TOTAL = f"{CURVES}/total"
NEAR = 6.0
"""How far JPEG may be off, on average [of 255]."""


def pictures(path: Path) -> dict[int, NDArray[np.uint8]]:
    found = read(path, PICTURE, COLUMN)
    return {n: np.asarray(Image.open(io.BytesIO(bytes(blob[0])))) for n, blob in found.items()}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with run.mcap and run.rrd, written by one run."""
    folder = tmp_path_factory.mktemp("dyed")
    scene = write_scene(folder)
    where = ["--record", str(folder / "run.mcap"), "--save", str(folder / "run.rrd")]
    assert main(["run", str(scene), *where, "--no-view"]) == 0
    return folder


def feed(folder: Path, target: Path, speed: float = 1.0, **picture: Any) -> Path:
    """A recording's messages, shown as a scene that differs in its picture would be."""
    scene = scene_file.read(write_scene(folder, picture=picture, speed=speed))
    file = RerunFile(target, Subject(run="run"), painter=DyePainter(scene, most=dyed.MOST_PIXELS))
    with nuno.open(folder / "run.mcap") as recording:
        marks = recording.marks()
        for message in recording.messages():
            frame, _ = marks.get(message.log_time, (-1, ""))
            file.feed(message.topic, frame, message.t, message.payload)
    return file.finish()


def test_a_run_s_file_has_every_frame_s_picture(run: Path) -> None:
    import rerun_cli

    binary = os.path.join(rerun_cli.__path__[0], "rerun")
    subprocess.run([binary, "rrd", "verify", str(run / "run.rrd")], check=True, timeout=60)
    found = pictures(run / "run.rrd")
    assert sorted(found) == list(range(11))
    painter = DyePainter(scene_file.read(run / "scene.yaml"))
    with nuno.open(run / "run.mcap") as recording:
        cloth = recording.last("dye/cloth")
        assert cloth is not None
        painter.take_cloth(cloth.payload)
        for frame, message in enumerate(recording.messages([CONCENTRATION.name])):
            exact = painter.draw(message.payload).astype(float)
            assert found[frame].shape == exact.shape
            assert np.abs(found[frame] - exact).mean() < NEAR


def test_a_recording_becomes_the_same_file(run: Path) -> None:
    assert main(["export", str(run / "run.mcap"), "--rrd", str(run / "again.rrd")]) == 0
    assert pictures(run / "again.rrd").keys() == pictures(run / "run.rrd").keys()
    assert read(run / "again.rrd", PICTURE, COLUMN) == read(run / "run.rrd", PICTURE, COLUMN)
    assert curves(run / "again.rrd", CURVES) == curves(run / "run.rrd", CURVES)


def test_a_replay_is_saved_as_the_run_was(run: Path, tmp_path: Path) -> None:
    target = tmp_path / "replay.rrd"
    assert main(["replay", str(run / "run.mcap"), "--fast", "--save", str(target)]) == 0
    assert read(target, PICTURE, COLUMN) == read(run / "run.rrd", PICTURE, COLUMN)


def test_curves_are_the_amounts_that_were_reported(run: Path) -> None:
    shown = curves(run / "run.rrd", CURVES)
    with nuno.open(run / "run.mcap") as recording:
        series = recording.series()
    for frame in range(11):
        for name in ("supplied", "mobile", "fixed"):
            assert shown[name][frame] == series[f"{name}_blue"][frame]
        assert shown["total"][frame] == shown["mobile"][frame] + shown["fixed"][frame]
    assert shown["fixed"][10] > shown["fixed"][1] > 0.0


def test_a_front_is_as_far_from_its_middle_as_the_disc_that_is_dyed(run: Path) -> None:
    """A disc's radius to half a cell, however the dye is shared by its layers; what is nearly empty is not reached."""
    size, radius, full = 5e-5, 20.0, 0.5
    y, x = np.mgrid[-32:32, -32:32] + 0.5
    disc = np.hypot(x, y) < radius
    phi, fixed = np.zeros((2, 1, 2, 64, 64))
    phi[0, 0], fixed[0, 1] = np.where(disc, 0.02 * full, 0.009 * full), np.where(disc, 0.3 * full, 0.0)
    payload = encode_arrays({"phi": phi, "fixed": fixed}, {})
    assert dyed.front_radii(payload, full, size) == pytest.approx([radius * size], abs=0.5 * size)
    front = curves(run / "run.rrd", "/plots/front")["blue"]
    with nuno.open(run / "run.mcap") as recording:
        sent = [message.payload for message in recording.messages([CONCENTRATION.name])]
    assert list(front.values()) == [1e3 * dyed.front_radii(payload, 1.0, size)[0] for payload in sent]


def test_what_looks_as_before_is_not_logged_again(run: Path, tmp_path: Path) -> None:
    """Before the first step no dye is fixed; of dye that nothing holds there is never another picture."""
    data = arrays()
    data["phi"] *= 0.0
    write_scene(tmp_path, data=data)
    path = nuno.run(tmp_path / "scene.yaml", record=tmp_path / "run.mcap").path
    assert main(["export", str(path), "--rrd", str(tmp_path / "run.rrd")]) == 0
    assert list(pictures(tmp_path / "run.rrd")) == [0]
    assert len(curves(tmp_path / "run.rrd", CURVES)["total"]) == 11


def test_pictures_are_as_rare_as_the_scene_asks_and_the_last_is_there(run: Path, tmp_path: Path) -> None:
    assert sorted(pictures(feed(run, tmp_path / "a.rrd", every="5.4 s"))) == [0, 3, 6, 9, 10]
    assert sorted(pictures(feed(run, tmp_path / "b.rrd", every="1 h"))) == [0, 10]


def test_the_time_of_a_cloth_by_itself_is_that_of_the_dyeing(run: Path, tmp_path: Path) -> None:
    """For which the run's messages are shown as those of a scene of a minute a second."""
    import rerun.chunk

    target = feed(run, tmp_path / "a.rrd", speed=60.0)
    seen: dict[str, list[float]] = {}
    for chunk in rerun.chunk.RrdReader(target).stream().to_chunks():
        batch = chunk.to_record_batch()
        assert "sim_time" not in batch.schema.names
        if not chunk.is_static and chunk.entity_path in (PICTURE, TOTAL):
            times = zip(batch["frame"].to_pylist(), batch["dye_time"].to_pylist(), strict=True)
            seen.setdefault(chunk.entity_path, []).extend(t.total_seconds() / frame for frame, t in times if frame)
    for entity in (PICTURE, TOTAL):
        assert seen[entity] == pytest.approx([60.0 * 1.8] * 10, rel=1e-9)


def test_a_live_view_skips_pictures_but_not_the_last(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dyed, "LIVE_SECONDS", 1e9)
    monkeypatch.setattr("nuno.viewer.file.Bridge", functools.partial(Bridge, live=True))
    assert sorted(pictures(feed(run, tmp_path / "a.rrd"))) == [0, 10]


def test_a_large_cloth_is_drawn_smaller(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dyed, "MOST_PIXELS", 99 * 5**2 + 1)
    assert next(iter(pictures(feed(run, tmp_path / "a.rrd", scale=40)).values())).shape == (45, 55, 3)
    monkeypatch.setattr(dyed, "MOST_PIXELS", 1)
    assert next(iter(pictures(feed(run, tmp_path / "b.rrd", scale=40)).values())).shape == (9, 11, 3)


def test_a_scene_s_painter_is_made_again_in_another_process(run: Path) -> None:
    loaded = scene_file.read(run / "scene.yaml", ("dye.picture.view=fixed", "dye.dyes.0.colour.full=0.5"))
    painter = read_painter(scene_of(loaded))
    assert painter is not None and painter.look.view == "fixed" and painter.colours[0].full == 0.5
    assert read_painter("") is None


def test_the_ring_gives_up_frames_of_dye_too() -> None:
    assert CONCENTRATION.name in FRAMES and STATE.name in FRAMES
    ring = Ring(limit=300)
    for frame in range(5):
        ring.put((CONCENTRATION.name, frame, 0.0, bytes(100)))
    ring.close()
    kept = []
    while (item := ring.get()) is not None:
        kept.append(item[1])
    assert kept == [2, 3, 4]


def test_damaged_amounts_are_refused_and_leave_the_picture(run: Path, tmp_path: Path) -> None:
    from nuno.bus.encodings import BadMessage, encode_arrays

    file = RerunFile(tmp_path / "a.rrd", Subject(run="run"), painter=DyePainter(scene_file.read(run / "scene.yaml")))
    with nuno.open(run / "run.mcap") as recording:
        cloth, amounts = recording.last("dye/cloth"), recording.last(CONCENTRATION.name)
    assert cloth is not None and amounts is not None
    with pytest.raises(BadMessage):
        file.feed(CONCENTRATION.name, 0, 0.0, amounts.payload)
    file.feed("dye/cloth", 0, 0.0, cloth.payload)
    found, text = decode_arrays(amounts.payload)
    for wrong in ({"phi": found["phi"]}, {"phi": found["phi"][:, :1], "fixed": found["fixed"][:, :1]}):
        with pytest.raises(BadMessage):
            file.feed(CONCENTRATION.name, 1, 1.0, encode_arrays(wrong, text))
    for broken in ({"fibre": found["phi"][0]}, {"fibre": found["phi"][0], "up": found["phi"][0, :, :3]}):
        with pytest.raises(BadMessage):
            file.feed("dye/cloth", 1, 1.0, encode_arrays(broken, {"v_max": 1, "cell_size": 1e-4}))
    known, said = decode_arrays(cloth.payload)
    for change in (
        {"weft_yarn": np.zeros(9, np.int32)},
        {"weft_yarn": np.full(9, 2**30, np.int32), "warp_yarn": np.zeros(11, np.int32)},
        {"weft_yarn": np.zeros(9, np.int32), "warp_yarn": np.zeros(11)},
        {"photograph": np.zeros((9, 11, 3), np.uint8)},
        {"photograph": np.zeros((9, 12, 3), np.uint8), "photograph_warp": np.zeros((9, 12), bool)},
    ):
        with pytest.raises(BadMessage):
            file.feed("dye/cloth", 1, 1.0, encode_arrays(known | change, said))
    for change in ({"cell_size": 0.0}, {"v_max": float("nan")}, {"cell_size": "wide"}):
        with pytest.raises(BadMessage):
            file.feed("dye/cloth", 1, 1.0, encode_arrays(known, said | change))
    file.feed(CONCENTRATION.name, 2, 2.0, amounts.payload)
    file.finish()
    assert list(pictures(tmp_path / "a.rrd")) == [2]
