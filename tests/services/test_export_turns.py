"""Pictures from named sides, turns round a frame, and the animation that a run draws at its end."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from recorded_sheet import Sheet, write
from scenes import write_scene

import nuno
from nuno.cli import main
from nuno.exports.animations import Shot, export_animation
from nuno.exports.camera import NARROW, SIDES, turned, z_up
from nuno.exports.cloth import read_frame
from nuno.exports.dyed_pictures import Changes
from nuno.exports.pictures import ROOM, Painter, draw_turn
from nuno.recording.reader import open_recording
from nuno_schemas.fabric import Float
from nuno_schemas.pictures import axes

SIZE = (96, 64)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("turns") / "run.mcap"
    write(path, Sheet(), 8)
    return path


def test_a_turn_comes_round_and_every_side_is_in_the_picture(path: Path, tmp_path: Path) -> None:
    """Once round one frame, in as many pictures as its time and rate have; a quarter on, it is the next side."""
    with open_recording(path) as recording:
        frame = read_frame(recording, 5)
        pictures = list(draw_turn(partial(Painter, recording, size=SIZE), frame, list(range(8))))
        painter = Painter(recording, [frame], SIZE)
        painter.stand_back(frame)
        assert turned(painter.camera, 2.0 * np.pi).eye == pytest.approx(painter.camera.eye)
        quarter = turned(painter.camera, 0.5 * np.pi)
        on = painter.camera.eye - painter.camera.target
        assert quarter.eye - painter.camera.target == pytest.approx([-on[1], on[0], on[2]])
        # A later azimuth is to the same side.
        sides = [Changes(overrides=(f"view.azimuth={angle}deg",)) for angle in (0, 90)]
        cameras = [Painter(recording, [frame], SIZE, changes=one).camera for one in sides]
        ways = [camera.eye - camera.target for camera in cameras]
        flat = [way * [1, 1, 0] / np.linalg.norm(way * [1, 1, 0]) for way in ways]
        assert flat[1] == pytest.approx([-flat[0][1], flat[0][0], 0.0])
    assert len(pictures) == 8 and len({picture.tobytes() for picture in pictures}) == 8
    for picture in pictures:
        edge = np.concatenate([picture[0], picture[:, 0], picture[:, -1]]).astype(np.int64)
        assert np.abs(np.diff(edge, axis=0)).max() < 40  # of the background alone
    out = export_animation(path, tmp_path / "turn.gif", SIZE, fps=5.0, shot=Shot(turn=2.0, frame=5))
    with Image.open(out) as image:
        assert getattr(image, "n_frames", 1) == 10


def reach(painter: Painter, points: Float) -> tuple[Float, Float]:
    """(2,) the lowest and the highest place of points (n, 3) in a picture, across and down, its edges at -1 and 1."""
    camera = painter.camera
    right, up, forward = axes(camera)
    from_eye = points - camera.eye
    half = np.tan(0.5 * camera.fov) * np.array([camera.size[0] / camera.size[1], 1.0])
    place = np.stack([from_eye @ right, from_eye @ up], axis=1) / (from_eye @ forward)[:, None] / half
    return place.min(axis=0), place.max(axis=0)


def test_a_bare_angle_in_degrees_is_doubted(path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As a scene's is."""
    command = ["export", str(path), "--size", "48x32", "--png", str(tmp_path / "a.png"), "--set"]
    for angle, doubted in (("view.azimuth=90", True), ("view.azimuth=90 deg", False), ("view.azimuth=1.5", False)):
        assert main([*command, angle]) == 0
        assert ("90 deg, which is 1.571 rad?" in capsys.readouterr().err) == doubted
    with pytest.warns(UserWarning, match="a bare 90 is 90 rad"):
        nuno.export(path, "view.azimuth=90", png=tmp_path / "b.png", size=(48, 32))


@pytest.mark.parametrize("more", [(), ("view.azimuth=70deg",)])
def test_a_close_camera_fills_the_picture_with_the_cloth_alone(path: Path, more: tuple[str, ...]) -> None:
    """It touches the margin on two opposite sides, and nothing of it is beyond; otherwise the body is there, too."""
    with open_recording(path) as recording:
        frame = read_frame(recording, 5)
        frame = replace(frame, x=0.2 * frame.x)  # smaller than the body
        near, far = (Painter(recording, [frame], SIZE, colour="stretch", changes=Changes(overrides=(*how, *more)))
                     for how in ((SIDES["close"],), ()))  # fmt: skip
        assert near.legend is not None
        cloth, everything = z_up(frame.x), np.concatenate([mesh.vertices for mesh in near.meshes(frame)])
        low, high = reach(near, cloth)
        edge = 1.0 - 2.0 * (NARROW + ROOM)
        widest = int(np.argmax(high - low))
        assert (low[widest], high[widest]) == pytest.approx((-edge, edge), abs=1e-9)
        assert low.min() > -edge - 1e-9 and high.max() < edge + 1e-9
        assert np.abs(reach(near, everything)).max() > 1.0 > np.abs(reach(far, everything)).max()


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--side", "left", "--csv", "a.csv"], "--side: for pictures and animations"),
        (["--turn", "2", "--png", "a.png"], "--turn: for animations"),
        (["--turn", "2", "--gif", "a.gif", "--start", "0"], "a turn is round one frame"),
        (["--turn", "2", "--gif", "a.gif", "--frame", "999"], "no such frame"),
        (["--frame", "3", "--csv", "a.csv"], "what is to be written has all frames"),
        (["--frame", "3", "--rrd", "a.rrd"], "what is to be written has all frames"),
        (["--start", "0.1", "--csv", "a.csv"], "--start: for animations"),
        (["--end", "0.1", "--npz", "a.npz"], "--end: for animations"),
        (["--end", "0.1", "--csv", "a.csv"], "leave it out: --csv has all frames"),
        (["--fps", "9", "--png", "a.png"], "--fps: for animations"),
        (["--size", "80x60", "--csv", "a.csv"], "--size: for pictures and animations"),
        (["--colour", "stretch", "--obj", "a.obj"], "--colour: for pictures and animations"),
        (["--set", "view.azimuth=1", "--csv", "a.csv"], "--set: for pictures and animations"),
    ],
)
def test_sides_and_turns_are_of_what_is_drawn(
    flags: list[str],
    said: str,
    path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(path), *flags]) == 2
    assert said in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("plain", "units"),
    [(["--start", "0.06", "--end", "0.1"], ["--start", "60 ms", "--end", "0.1s"]),
     (["--turn", "0.2"], ["--turn", "200ms"])],
)  # fmt: skip
def test_times_of_an_animation_have_units(plain: list[str], units: list[str], path: Path, tmp_path: Path) -> None:
    size = f"{SIZE[0]}x{SIZE[1]}"
    for name, flags in (("a.gif", plain), ("b.gif", units)):
        assert main(["export", str(path), "--gif", str(tmp_path / name), "--size", size, *flags]) == 0
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


@pytest.mark.full
def test_a_run_is_animated_at_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where it is recorded; a name that is none is refused before it runs."""
    monkeypatch.chdir(tmp_path)
    path = str(write_scene(tmp_path, duration=0.2))
    assert main(["run", path, "--no-view", "--mp4", "a.gif"]) == 0
    with Image.open(tmp_path / "a.gif") as image:
        assert getattr(image, "n_frames", 1) > 1
    assert "animation   a.gif" in capsys.readouterr().out
    for flags, said in ((["--mp4", "a.mpg"], "no such kind"), (["--mp4", "b.gif", "--no-record"], "leave --no-record")):
        assert main(["run", path, *flags]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "b.gif").exists() and len(list((tmp_path / "recordings").glob("*.mcap"))) == 1
