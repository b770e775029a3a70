"""An exported scene is that of its recording, with the files that it names."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from recorded_sheet import Sheet, write
from scenes import write_scene

from nuno.cli import main
from nuno.recording.reader import open_recording
from nuno.runtime.consistency import premises_of
from nuno.scene import scene_file
from nuno.scene.recorded_scene import restored_scene
from nuno.studio.desk import Exports

WALK, PAD = b"HIERARCHY\n", b"# a pad\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
BODIES = [
    {"name": "dancer", "collider": {"plugin": "skeleton"}, "motion": {"plugin": "bvh", "file": "walk.bvh"}},
    {"name": "pad", "collider": {"plugin": "mesh", "file": "parts/left/pad.obj"}, "contact": {"plugin": "sliding"}},
]


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording of a scene that names a file in its folder and one in a folder there, moved away from both."""
    data = yaml.safe_load(write_scene(tmp_path, bodies=BODIES).read_text())
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return write_run(data, WALK)


def write_run(data: dict[str, Any], walk: bytes) -> Path:
    write(Path("run.mcap"), Sheet(3, 2), 4, {"walk.bvh": walk, "parts/left/pad.obj": PAD}, data)
    return Path("run.mcap")


def there() -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in Path().rglob("*") if path.is_file() and path.suffix != ".mcap"}


def test_a_scene_comes_with_its_files(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Services that are started by hand with it then agree with the run that goes on from the recording."""
    assert main(["export", str(recording), "--scene", "own.yaml"]) == 0
    assert capsys.readouterr().out.splitlines() == ["own.yaml", "walk.bvh", "parts/left/pad.obj"]
    files = there()
    assert files.keys() == {"own.yaml", "walk.bvh", "parts/left/pad.obj"}
    assert (files["walk.bvh"], files["parts/left/pad.obj"]) == (WALK, PAD)
    with open_recording(recording) as opened, restored_scene(opened) as loaded:
        assert premises_of(scene_file.read(Path("own.yaml")), True) == premises_of(loaded, True)
    # What is there and the same stays, and is not named again.
    Path("walk.bvh").chmod(0o444)
    assert main(["export", str(recording), "--scene", "own.yaml"]) == 0
    assert capsys.readouterr().out.splitlines() == ["own.yaml"] and there() == files


def in_the_way(name: str) -> Callable[[], object]:
    return lambda: Path(name).write_bytes(b"another")


@pytest.mark.parametrize(
    ("before", "flags", "words"),
    [
        (in_the_way("walk.bvh"), "--scene own.yaml", "another one is there"),
        (in_the_way("parts"), "--scene own.yaml", "cannot write there"),
        (lambda: Path("walk.bvh").symlink_to("nowhere"), "--scene own.yaml", "another one is there"),
        (lambda: Path("walk.bvh").mkdir(), "--scene own.yaml", "another one is there"),
        (lambda: Path("parts/left").mkdir(parents=True), "--scene own.yaml --obj parts/left/pad.obj", "there, too"),
    ],
)
def test_no_file_is_lost_to_a_scene(
    before: Callable[[], object], flags: str, words: str, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before()
    files = there()
    assert main(["export", str(recording), "--csv", "a.csv", *flags.split()]) == 2
    assert words in capsys.readouterr().err
    assert there() == files and not Path("own.yaml").exists()


def test_the_studio_exports_the_scene_of_a_recording_that_replaces_another(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With another file of the same name."""

    def child(words: list[str]) -> SimpleNamespace:
        return SimpleNamespace(code=main(words), said="", end=lambda: None)

    monkeypatch.setattr("nuno.studio.desk.Child", child)
    exports = Exports(SimpleNamespace(find=lambda name: recording.absolute()))  # type: ignore[arg-type]
    asked = {"recording": "run.mcap", "kind": "scene"}
    assert exports.export(asked)["bytes"]
    with open_recording(recording) as opened:
        data = opened.scene
    write_run(data, b"HIERARCHY of another\n")
    os.utime(recording, (1, 1))
    assert exports.export(asked)["bytes"]
    assert [path.read_bytes() for path in exports.folder.rglob("walk.bvh")] == [b"HIERARCHY of another\n"]
    exports.forget("run.mcap")
    assert not [path for path in exports.folder.rglob("*") if path.is_file()]
    exports.close()
