"""`last` is the run begun last: of this folder where there is one, else of any; every command says which it took."""

from __future__ import annotations

import json
import os
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from recorded_sheet import Sheet, write
from scenes import write_scene

import nuno
from nuno.cli import main
from nuno.recording.writer import part_of
from nuno.runtime import runs
from nuno_schemas.errors import BadInput


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Two folders to work in, of a user who has never run anything; this program is in the first."""
    (tmp_path / "notes").mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "notes"))
    for name in ("here", "there"):
        (tmp_path / name / "recordings").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here", tmp_path / "there"


def age(path: Path, seconds: float) -> None:
    """Let a file be that old."""
    then = path.stat().st_mtime - seconds
    os.utime(path, (then, then))


def test_the_last_run_is_this_folders(
    folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    here, there = folders
    with pytest.raises(BadInput, match="no such run"):
        runs.find("last")
    with ExitStack() as going:
        monkeypatch.chdir(there)
        going.enter_context(runs.announced("first", "tcp/127.0.0.1:1"))
        monkeypatch.chdir(here)
        assert runs.find("last") == ("first", "tcp/127.0.0.1:1")
        assert capsys.readouterr().err == f"last is first, begun in {there}\n"
        going.enter_context(runs.announced("second", "tcp/127.0.0.1:2"))
        monkeypatch.chdir(there)
        going.enter_context(runs.announced("third", "tcp/127.0.0.1:3"))
        monkeypatch.chdir(here)
        assert runs.find("last") == ("second", "tcp/127.0.0.1:2")
        assert capsys.readouterr().err == "last is second\n"
        monkeypatch.chdir(there)
        assert runs.find("last")[0] == "third"
        assert runs.find("sec")[0] == "second"


def test_the_last_recording_is_this_folders_finished_or_not(
    folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    here, there = folders
    last = Path("last")
    with pytest.raises(BadInput, match="no recording is known"):
        runs.find_recording(last)
    assert runs.find_recording(Path("other.mcap")) == Path("other.mcap")
    # Begun in another folder, and recorded in a third place.
    elsewhere = here.parent / "elsewhere.mcap"
    monkeypatch.chdir(there)
    runs.note_recording(elsewhere)
    monkeypatch.chdir(here)
    with pytest.raises(BadInput, match="no recording is known"):
        runs.find_recording(last)  # it was never written
    part_of(elsewhere).touch()
    capsys.readouterr()
    assert runs.find_recording(last) == part_of(elsewhere)
    assert capsys.readouterr().err == f"last is {part_of(elsewhere)}, begun in {there}\n"
    for name, old in (("a", 30.0), ("b", 10.0), ("c", 20.0)):
        (here / "recordings" / f"{name}.mcap").touch()
        age(here / "recordings" / f"{name}.mcap", old)
    assert runs.find_recording(last) == Path("recordings/b.mcap")
    assert capsys.readouterr().err == f"last is {Path('recordings/b.mcap')}\n"
    (here / "recordings" / "killed.mcap.part").touch()
    assert runs.find_recording(last) == Path("recordings/killed.mcap.part")
    monkeypatch.chdir(there)
    assert runs.find_recording(last) == part_of(elsewhere)


def test_every_command_takes_the_last_recording(folders: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    here, _ = folders
    kept = here / "elsewhere.mcap"
    main(["run", str(write_scene(here, duration=0.2)), "--no-view", "--record", str(kept)])
    write(here / "recordings" / "old.mcap", Sheet(), 2)
    age(here / "recordings" / "old.mcap", 100.0)
    nuno.run(here / "scene.yaml", "duration=0.1")  # its recording is not kept, so it is not the last one
    capsys.readouterr()
    for command in ("info last --json", "verify last", "export last --npz out.npz", "replay last --fast --no-view"):
        assert main(command.split()) == 0, command
        said = capsys.readouterr()
        assert said.err.startswith(f"last is {kept}\n"), command
        if "--json" in command:
            assert json.loads(said.out)["file"] == str(kept)
    with np.load(here / "out.npz") as arrays:
        assert float(arrays["t"]) == 0.2
    assert main(["run", "--resume", "last", "--set", "duration=0.3", "--no-view"]) == 0
    said = capsys.readouterr()
    assert said.err.startswith(f"last is {kept}\n")
    assert f"going on at 0.2 s of {kept}" in said.out
    # That run is the last one now, and is in this folder's recordings.
    assert main(["info", "last", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert Path(facts["file"]).parent == Path("recordings") and facts["span"][1] == 0.3


def test_a_folder_that_was_removed_is_no_fault_of_a_run(folders: tuple[Path, Path]) -> None:
    gone = folders[0] / "gone"
    gone.mkdir()
    os.chdir(gone)
    gone.rmdir()
    with runs.announced("alone", "tcp/127.0.0.1:1"):
        assert runs.find("last")[0] == "alone"
