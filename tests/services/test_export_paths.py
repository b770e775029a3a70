"""Exports by another renderer and with an open shutter: what is drawn, what is refused, what it costs others."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from recorded_sheet import RATE, Sheet, write

import nuno
from nuno.cli import main
from nuno.exports.animations import Shot, export_animation
from nuno.exports.camera import z_up
from nuno.exports.dyed_pictures import Changes
from nuno.exports.pictures import MOMENTS, Painter, Rendering, draw_frames, export_picture
from nuno.exports.yarns import make_yarns
from nuno.recording.reader import open_recording
from nuno_schemas.colour import parse_hex
from nuno_schemas.errors import BadInput

SIZE = (96, 64)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("paths") / "run.mcap"
    write(path, Sheet(), 12)
    return path


def test_a_picture_by_paths_tells_its_time_its_progress_and_its_noise(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    told: list[str] = []
    done: list[tuple[int, int]] = []
    rendering = Rendering("paths", 4, told.append)
    out = export_picture(path, tmp_path / "a.png", 5, SIZE, rendering=rendering, progress=lambda *at: done.append(at))
    with Image.open(out) as image:
        assert image.size == SIZE
    assert [at for at, _ in done] == list(range(1, done[-1][1] + 1))
    assert len(told) == 2 and "about" in told[0] and "noise" in told[1] and "%" in told[1]


def test_a_film_by_paths_has_its_pictures(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    shot = Shot(start=0.0, end=0.04)
    export_animation(path, tmp_path / "a.gif", (32, 24), 50.0, shot, rendering=Rendering("paths", 1))
    with Image.open(tmp_path / "a.gif") as image:
        assert getattr(image, "n_frames", 1) == 3


def test_a_knit_is_drawn_by_the_curves_that_are_exported(tmp_path: Path) -> None:
    """With the radius and colour that are asked for, and by its stretch as links, as before."""
    pytest.importorskip("mitsuba")
    nuno.run("knit/stitch-10x10", "duration=0.3", record=tmp_path / "knit.mcap")
    changes = Changes(overrides=("view.yarns.radius=30mm", "view.yarns.colour=#804020", "view.azimuth=10deg"))
    with open_recording(tmp_path / "knit.mcap") as recording:
        last = list(recording.frames())[-1]
        (mesh,) = Painter(recording, [last], SIZE, changes=changes, rendering=Rendering("paths", 1)).meshes(last)
        wanted = make_yarns(recording, last, settings={"radius": 0.03}).curves
        by_stretch = Painter(recording, [last], SIZE, colour="stretch", rendering=Rendering("paths", 1)).meshes(last)
    assert mesh.yarns is not None and wanted is not None and by_stretch[0].yarns is None
    assert np.array_equal(mesh.vertices, z_up(wanted.points)) and np.array_equal(mesh.yarns.radius, wanted.radius)
    assert np.unique(np.asarray(mesh.colours), axis=0) == pytest.approx(parse_hex("#804020")[None])
    out = export_picture(tmp_path / "knit.mcap", tmp_path / "a.png", size=SIZE, rendering=Rendering("paths", 1))
    with Image.open(out) as image:
        assert np.ptp(np.asarray(image.convert("L"))) > 30


@pytest.mark.parametrize(
    ("flags", "field"),
    [
        (["--renderer", "path"], "--renderer"),
        (["--renderer", "paths", "--samples", "0"], "--samples"),
        (["--renderer", "paths", "--samples", "-3"], "--samples"),
        (["--renderer", "raster", "--samples", "5"], "--samples"),
        (["--samples", "5"], "--samples"),
        (["--shutter", "0.5"], "--shutter"),
        (["--renderer", "paths", "--style", "yarns"], "--renderer"),
    ],
)
def test_what_cannot_be_drawn_is_refused_before_anything_starts(
    path: Path, tmp_path: Path, flags: list[str], field: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr("nuno_render.paths_of_light.Paths.require", lambda self: None)
    assert main(["export", str(path), "--png", str(tmp_path / "a.png"), *flags]) == 2
    assert f"{field}:" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_renderer_that_is_not_installed_is_refused_with_how_to(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    there = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "mitsuba" else there(name, *a))
    assert main(["export", str(path), "--png", str(tmp_path / "a.png"), "--renderer", "paths"]) == 2
    assert 'pip install "nuno[paths]"' in capsys.readouterr().err


def test_a_frame_without_cloth_is_refused(path: Path) -> None:
    pytest.importorskip("mitsuba")
    with open_recording(path) as recording:
        frame = next(iter(recording.frames()))
        frame.x[:] = np.nan
        painter = Painter(recording, [frame], SIZE, rendering=Rendering("paths", 1))
        with pytest.raises(BadInput, match="no cloth"):
            painter.draw(frame)


def test_a_shutter_sees_the_mean_of_what_passes(path: Path) -> None:
    """The sheet waves: each pixel's light lies between its least and most, and is that of the moments' mean."""
    with open_recording(path) as recording:
        frames = list(recording.frames())
        painter = Painter(recording, frames, SIZE)
        blurred = painter.blur(frames[2], 0.08)
        times = frames[2].t + 0.08 * (np.arange(MOMENTS) + 0.5) / MOMENTS
        moments = [painter.draw(frames[2], meshes=painter._meshes_at(frames[2], float(t))) for t in times]
        still = painter.draw(frames[2])
    assert (blurred >= np.min(moments, axis=0)).all() and (blurred <= np.max(moments, axis=0)).all()
    assert len({moment.tobytes() for moment in moments}) == MOMENTS
    assert not np.array_equal(blurred, still)


def test_a_moment_between_frames_is_on_the_way_between_them(path: Path) -> None:
    with open_recording(path) as recording:
        frames = list(recording.frames())
        painter = Painter(recording, frames, SIZE)
        between = painter._meshes_at(frames[3], frames[3].t + 0.25 / RATE)
        first, last = (painter.meshes(frame) for frame in frames[3:5])
    for mesh, a, b in zip(between, first, last, strict=True):
        assert np.allclose(mesh.vertices, 0.75 * a.vertices + 0.25 * b.vertices, atol=1e-6)


def test_a_film_of_what_stands_still_is_not_blurred(path: Path) -> None:
    """After the last frame nothing moves any more."""
    with open_recording(path) as recording:
        last, paint = [frame.number for frame in recording.frames()][-1:], partial(Painter, recording, size=SIZE)
        sharp, blurred = (next(draw_frames(recording, paint, last, shutter=shutter)) for shutter in (0.0, 0.01))
    assert np.array_equal(sharp, blurred)


def test_nothing_imports_mitsuba_before_it_draws() -> None:
    code = (
        "import sys, nuno.cli.run, nuno.cli.recordings, nuno.exports.animations, nuno_render.raster; "
        "import nuno_render.paths_of_light; assert not {'mitsuba', 'drjit', 'pyoidn'} & set(sys.modules)"
    )
    done: Any = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
