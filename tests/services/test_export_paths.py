"""Exports by another renderer: what is drawn, what is refused, what it costs others."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from recorded_sheet import Sheet, write

from nuno.cli import main
from nuno.exports.animations import Shot, export_animation
from nuno.exports.pictures import Painter, Rendering, export_picture
from nuno.recording.reader import open_recording
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


@pytest.mark.parametrize(
    ("flags", "field"),
    [
        (["--renderer", "path"], "--renderer"),
        (["--renderer", "paths", "--samples", "0"], "--samples"),
        (["--renderer", "paths", "--samples", "-3"], "--samples"),
        (["--renderer", "raster", "--samples", "5"], "--samples"),
        (["--samples", "5"], "--samples"),
    ],
)
def test_what_cannot_be_drawn_is_refused_before_anything_starts(
    path: Path, tmp_path: Path, flags: list[str], field: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr("nuno_render.paths.renderer.Paths.require", lambda self: None)
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


def test_nothing_imports_mitsuba_before_it_draws() -> None:
    code = (
        "import sys, nuno.cli.run, nuno.cli.recordings, nuno.exports.animations, nuno_render.raster; "
        "import nuno_render.paths.renderer; assert not {'mitsuba', 'drjit', 'pyoidn'} & set(sys.modules)"
    )
    done: Any = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
