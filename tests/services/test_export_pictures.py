"""Pictures and animations have the size, the number and the content that was asked for."""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from recorded_sheet import RATE, Sheet, write

from nuno.cli import main
from nuno.exports import cloth as paint
from nuno.exports.animations import Shot, _choose_palette, _write_gif, export_animation
from nuno.exports.cloth import SIDES, tubes
from nuno.exports.pictures import Painter, choose_frames, export_picture
from nuno.recording.reader import open_recording
from nuno_schemas.colour import colours
from nuno_schemas.errors import BadInput

FRAMES = 26
SIZE = (96, 64)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pictures") / "run.mcap"
    write(path, Sheet(), FRAMES)
    return path


def test_a_picture_has_its_size_and_shows_its_frame(path: Path, tmp_path: Path) -> None:
    pictures = []
    for number in (0, 5, 5):
        out = export_picture(path, tmp_path / "out.png", number, SIZE)
        with Image.open(out) as image:
            assert (image.format, image.size, image.mode) == ("PNG", SIZE, "RGB")
            pictures.append(np.asarray(image))
    assert np.array_equal(pictures[1], pictures[2])
    assert not np.array_equal(pictures[0], pictures[1])


def test_the_scene_chooses_size_and_camera(tmp_path: Path) -> None:
    """Without a size the view's is taken; the camera keeps its distance from its target."""
    write(tmp_path / "a.mcap", Sheet(), 2)
    with open_recording(tmp_path / "a.mcap") as recording:
        frames = list(recording.frames())
        view = {"size": [80, 60], "target": [0.5, 0.25, 0.125], "distance": "3 m", "azimuth": "0 rad", "elevation": 0.0}
        recording.layout.metadata["scene"]["json"] = '{"name": "waving", "view": ' + str(view).replace("'", '"') + "}"
        painter = Painter(recording, frames)
        assert painter.draw(frames[0]).shape == (60, 80, 3)
    # y up becomes z up: (x, y, z) -> (x, -z, y), seen from +z of the scene.
    assert painter.camera.target == pytest.approx([0.5, -0.125, 0.25])
    assert painter.camera.eye == pytest.approx([0.5, -3.125, 0.25])


SEEN_FROM = {"azimuth": "90deg", "elevation": 0.5, "target": [0.5, 0.25, 0.125], "distance": "3 m", "size": [80, 60]}


@pytest.mark.quick(kind=["png"], field=["size"])
@pytest.mark.parametrize("field", SEEN_FROM)
@pytest.mark.parametrize("kind", ["png", "gif"])
def test_a_picture_from_another_side_needs_no_other_run(
    field: str, kind: str, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is the very picture of a run whose scene says so; a GIF without --size has one of its own."""
    says_so = tmp_path / "other.mcap"
    write(says_so, Sheet(), FRAMES, scene={"name": "waving", "view": {field: SEEN_FROM[field]}})

    def export(recording: Path, *flags: str) -> bytes:
        target = tmp_path / f"out.{kind}"
        part = ("--frame", "2") if kind == "png" else ("--end", "0.1")
        assert main(["export", str(recording), f"--{kind}", str(target), *part, *flags]) == 0
        return target.read_bytes()

    found = export(path, "--set", f"view.{field}={SEEN_FROM[field]}".replace("'", ""))
    assert found == export(says_so)
    assert (found == export(path)) == ((kind, field) == ("gif", "size"))


@pytest.mark.parametrize(
    ("item", "words"),
    [
        ("view.azimut=1", ["view.azimut", "no matter of pictures"]),
        ("view.azimuth=left", ["--set: view.azimuth", "'left'"]),
        ("view.azimuth.x=1", ["view.azimuth"]),
        ("view.size=[5, 5]", ["--set: view.size", "at least 16"]),
        ("view.links=yarn", ["view.links", "no matter of pictures"]),
        ("solver.dt=1", ["solver.dt", "no matter of pictures"]),
    ],
)
@pytest.mark.parametrize("colour", ["auto", "stretch"])
def test_what_is_no_camera_is_refused_before_any_file_is_written(
    item: str, words: list[str], colour: str, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--npz", str(tmp_path / "a.npz"), "--png", str(tmp_path / "a.png"), "--colour", colour, "--set", item]
    assert main(["export", str(path), *flags]) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in words), said
    assert list(tmp_path.iterdir()) == []


def test_every_look_of_an_animation_is_inside_the_picture(path: Path) -> None:
    with open_recording(path) as recording:
        frames = list(recording.frames())
        painter = Painter(recording, frames, SIZE)
        camera = painter.camera
        forward = (camera.target - camera.eye) / np.linalg.norm(camera.target - camera.eye)
        right = np.cross(forward, camera.up)
        half = np.tan(camera.fov / 2)
        for frame in frames:
            meshes = list(painter.meshes(frame))
            assert sum(len(mesh.vertices) for mesh in meshes) >= len(frame.x)
            for mesh in meshes:
                d = mesh.vertices - camera.eye
                depth = d @ forward
                assert np.abs(d @ camera.up / depth).max() <= half
                assert np.abs(d @ right / depth).max() <= half * SIZE[0] / SIZE[1]


def test_chosen_frames_keep_real_time(path: Path) -> None:
    with open_recording(path) as recording:
        assert choose_frames(recording, 50.0, None, None) == list(range(FRAMES))
        assert choose_frames(recording, 25.0, None, None) == list(range(0, FRAMES, 2))
        assert choose_frames(recording, 150.0, 0.0, 0.04) == [0, 0, 1, 1, 1, 2, 2]
        assert choose_frames(recording, 10.0, 0.1, 0.3) == [5, 10, 15]
        for fps in (7.0, 12.5, 30.0):
            times = np.array(choose_frames(recording, fps, None, None)) / RATE
            due = np.arange(len(times)) / fps
            assert np.abs(times - due).max() <= 0.5 / RATE + 1e-9
            assert len(times) == int((FRAMES - 1) / RATE * fps + 1e-6) + 1
        with pytest.raises(BadInput, match="nothing to show"):
            choose_frames(recording, 25.0, 9.0, 10.0)


def test_a_gif_keeps_the_colours_of_cloth_that_come_later_and_of_the_background(tmp_path: Path) -> None:
    """Mean colours over 4 x 4 pixels, between which dithering may trade, are those of the pictures."""
    y, x = np.mgrid[0:96, 0:128] / 128.0
    background = 225.0 + 20.0 * np.stack([y, y, 1.0 - y], axis=-1)
    cloth = (slice(24, 72), slice(32, 96))
    pictures = []
    for k in range(5):
        picture = background.copy()
        picture[cloth] = 255.0 * colours(0.2 * k + 0.3 * x[cloth].ravel(), 0.0, 1.0).reshape(48, 64, 3) ** 0.45
        pictures.append(picture.astype(np.uint8))
    _write_gif(tmp_path / "a.gif", iter(pictures), 10.0, _choose_palette(iter(pictures)))
    with Image.open(tmp_path / "a.gif") as image:
        for k, picture in enumerate(pictures):
            image.seek(k)
            apart = (np.asarray(image.convert("RGB"), float) - picture).reshape(24, 4, 32, 4, 3).mean(axis=(1, 3))
            inside = apart[6:18, 8:24]
            assert np.sqrt((inside**2).mean()) < 3.0
            assert np.sqrt((apart[:6] ** 2).mean()) < 2.0


def test_a_falsified_time_makes_no_animation_of_a_thousand_million_pictures(tmp_path: Path) -> None:
    sheet = Sheet()
    write(tmp_path / "a.mcap", sheet, 3)
    with open_recording(tmp_path / "a.mcap") as recording:
        marks = recording.marks()
        last = max(marks)
        marks[10**18] = marks.pop(last)
        recording.marks = lambda: marks  # type: ignore[method-assign]
        for shot in (Shot(), Shot(turn=1e9)):
            with pytest.raises(BadInput, match="too many pictures"):
                export_animation(recording, tmp_path / "a.gif", SIZE, shot=shot)
    assert not (tmp_path / "a.gif").exists()


def test_a_gif_has_its_frames_and_its_pace(path: Path, tmp_path: Path) -> None:
    steps: list[tuple[int, int]] = []
    out = export_animation(path, tmp_path / "a.gif", SIZE, 25.0, progress=lambda done, all: steps.append((done, all)))
    with Image.open(out) as image:
        assert image.size == SIZE
        total, shown = 0, []
        for k in range(image.n_frames):
            image.seek(k)
            total += image.info["duration"]
            shown.append(np.asarray(image.convert("RGB")))
    assert total == 13 * 40
    assert steps == [(k + 1, 13) for k in range(13)]
    assert all(not np.array_equal(a, b) for a, b in pairwise(shown))


def test_an_mp4_has_its_frames(path: Path, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    out = export_animation(path, tmp_path / "a.mp4", (96, 64), 25.0)
    frames, seconds = ffmpeg.count_frames_and_secs(str(out))
    assert frames == 13
    assert seconds == pytest.approx(13 / 25, abs=0.021)
    assert next(ffmpeg.read_frames(str(out)))["size"] == (96, 64)
    # Faster than the recording: pictures stand longer, time still runs true.
    out = export_animation(path, tmp_path / "a.mp4", SIZE, 150.0)
    assert ffmpeg.count_frames_and_secs(str(out))[0] == 76


@pytest.mark.parametrize("size", ["97x64", "96x65"])
def test_an_mp4_of_another_size_than_asked_for_is_refused(
    size: str, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    film, picture = tmp_path / "a.mp4", tmp_path / "a.png"
    assert main(["export", str(path), "--mp4", str(film), "--png", str(picture), "--size", size]) == 2
    said = capsys.readouterr().err
    assert "error: --size: " in said and "--size 96x64" in said and not (film.exists() or picture.exists())
    assert main(["export", str(path), "--gif", str(tmp_path / "a.gif"), "--size", size]) == 0
    with Image.open(tmp_path / "a.gif") as image:
        assert f"{image.width}x{image.height}" == size


def test_without_the_encoder_the_extra_is_named(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(BadInput) as caught:
        export_animation(path, tmp_path / "a.mp4", SIZE)
    assert "nuno[video]" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.avi", {}),
        ("a.gif", {"fps": 0.0}),
        ("a.gif", {"fps": float("nan")}),
        ("a.gif", {"fps": 30.0}),
        ("a.gif", {"size": (0, 5)}),
        ("a.gif", {"size": (99999, 5)}),
        ("a.gif", {"shot": Shot(start=5.0)}),
        ("no/a.gif", {}),
    ],
)
def test_bad_wishes_are_refused(path: Path, tmp_path: Path, name: str, options: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        export_animation(path, tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--png a.png --size 5x5", "--size: no such size"),
        ("--png a.png --size big", "--size: a size is written"),
        ("--png a.png --frame 999", "no such frame"),
        ("--glb a.glb --frame 999", "no such frame"),
        ("--png a.png --glb a.png/x.glb", "no such folder"),
        ("--png a.png --gif b.gif --start 999", "nothing to show"),
        ("--png a.png --gif b.gif --fps 0", "--fps: no such rate"),
        ("--png a.png --rrd b.mcap", "--rrd: the name must end in .rrd"),
        ("--forces a.npz", "--forces: --npz is to be written there, too"),
        ("--png a.jpg", "the name must end in .png"),
        ("--csv=", "the name must end in .csv"),
        ("--scene a.txt", "the name must end in .yaml"),
        ("--yarns b.csv", "the name must end in .npz"),
        ("--obj no/frames", "no such folder"),
        ("--png a.png --colour pressure", "the recording has no knit"),
    ],
)
def test_nothing_is_begun_where_one_of_several_files_cannot_be(
    path: Path, arguments: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nuno.python_api.export._export", None)
    csv = [] if "--csv" in arguments else ["--csv", "a.csv"]
    assert main(["export", str(path), "--npz", "a.npz", *csv, *arguments.split()]) == 2
    assert words in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_stretch_colours_are_logarithmic() -> None:
    low, high = paint.STRETCH
    ends = paint.paint_stretch(np.array([low, np.sqrt(low * high), high, -0.5, 0.0, 7.0, np.nan]))
    assert ends[:3] == pytest.approx(colours([0.0, 0.5, 1.0], 0.0, 1.0), abs=1e-12)
    assert ends[3:] == pytest.approx(colours([0.0, 0.0, 1.0, np.nan], 0.0, 1.0), abs=1e-12)


def test_tubes_stand_round_their_edges() -> None:
    x = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 2.0, 0.5]])
    edges = np.array([[0, 1], [1, 2]], np.int32)
    vertices, faces, owner = tubes(x, edges)
    radius = 0.004 * 2.0
    for e, (i, j) in enumerate(edges):
        ring = vertices[2 * SIDES * e : 2 * SIDES * (e + 1)]
        axis = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
        start = np.where((owner[2 * SIDES * e : 2 * SIDES * (e + 1)] == i)[:, None], x[i], x[j])
        assert np.linalg.norm(ring - start, axis=1) == pytest.approx(radius)
        assert (ring - start) @ axis == pytest.approx(0.0, abs=1e-12)
        # Faces look outward.
        for a, b, c in faces[2 * SIDES * e : 2 * SIDES * (e + 1)]:
            normal = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
            middle = (vertices[a] + vertices[b] + vertices[c]) / 3
            outward = middle - x[i] - ((middle - x[i]) @ axis) * axis
            assert normal @ outward > 0
