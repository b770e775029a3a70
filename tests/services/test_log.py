"""What happened to a run is told in lines of JSON, and last is the run begun last."""

from __future__ import annotations

import contextlib
import json
import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_run import start_long
from recorded_sheet import Sheet, write
from scenes import write_scene

import nuno
from nuno.bus.messages import Bus
from nuno.cli import main
from nuno.recording.writer import part_of
from nuno.runtime import log, runs
from nuno_schemas.errors import BadInput


def read(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_run_leaves_its_log_beside_its_recording(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, duration=0.1)
    record = tmp_path / "a.mcap"
    assert main(["run", str(scene), "--record", str(record), "--no-view", "--run", "a1"]) == 0
    lines = read(tmp_path / "a.log.jsonl")
    assert {(line["run"], *line) for line in lines} == {("a1", "time", "level", "run", "service", "message", "fields")}
    assert [line["time"] for line in lines] == sorted(line["time"] for line in lines)
    start, end = lines[0], lines[-1]
    assert start["message"] == "start" and start["fields"]["services"] == ["simulation", "recorder"]
    assert start["fields"]["version"] and len(start["fields"]["scene_hash"]) == 64
    assert "all services are ready" in [line["message"] for line in lines]
    with nuno.open(record) as recording:
        assert end["fields"]["digests"]["simulation"] == recording.metadata["end"]["digest"]
    assert (end["message"], end["level"], end["fields"]["frame"]) == ("end: done", "info", 5)


def test_control_and_failure_are_told(tmp_path: Path) -> None:
    path = tmp_path / "own.jsonl"
    run = start_long(tmp_path, bodies=[])
    with log.written(run.run, path):
        run.control("set", item="damping=3.0")
        run.stop()
    with log.written("another", tmp_path / "other.jsonl"):
        log.note(run.run, "not of the other")
    lines = read(path)
    (changed,) = [line for line in lines if "damping=3.0" in line["message"]]
    assert changed["service"] == "simulation" and changed["fields"]["item"] == "damping=3.0"
    assert lines[-1]["fields"]["state"] == "stopped"
    assert not (tmp_path / "other.jsonl").exists()
    solver = {"plugin": "symplectic_euler", "dt": "20 ms"}
    scene = write_scene(tmp_path, solver=solver, allow_unstable=True, duration=200)
    assert main(["run", str(scene), "--no-record", "--no-view", "--log", str(path)]) == 1
    *before, end = read(path)
    assert end["level"] == "error" and "diverged" in end["fields"]["reason"]
    assert before[: len(lines)] == lines and end["run"] != run.run


@pytest.mark.parametrize(
    "how", [(), pytest.param(("--processes",), marks=pytest.mark.full)], ids=["threads", "processes"]
)
def test_a_run_interrupted_as_it_ends_keeps_what_it_has(
    how: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Here before the recorder is asked to close its file."""
    real = Bus.ask_json

    def ask(self: Bus, name: str, *rest: Any) -> dict[str, Any]:
        if name == "finish/recorder":
            raise KeyboardInterrupt
        return real(self, name, *rest)

    monkeypatch.setattr(Bus, "ask_json", ask)
    record, kept = tmp_path / "a.mcap", tmp_path / "a.log.jsonl"
    with log.written("earlier", kept):
        log.note("earlier", "end: done")
    assert main(["run", str(write_scene(tmp_path)), "--record", str(record), "--no-view", *how]) == 1
    assert (read(kept)[0]["run"], read(kept)[0]["message"]) == ("earlier", "end: done")
    assert capsys.readouterr().err.splitlines()[-1] == "interrupted"
    assert read(tmp_path / "a.log.jsonl")[-1]["fields"]["reason"] == "interrupted while its services ended"
    with nuno.open(record) as recording:
        assert not recording.complete and sum(1 for _ in recording.frames()) == 26


def test_a_refused_run_leaves_no_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path)
    assert main(["run", str(scene), "--no-record", "--no-view", "--log", str(tmp_path / "none" / "a.jsonl")]) == 2
    assert "--log" in capsys.readouterr().err
    record = tmp_path / "a.mcap"
    record.write_text("not a recording")
    assert main(["run", str(scene), "--record", str(record), "--no-view"]) == 2
    assert not (tmp_path / "a.log.jsonl").exists()


def test_a_refused_run_leaves_the_log_of_another(tmp_path: Path) -> None:
    """Of one that records to the same file, or has."""
    scene, record, kept = write_scene(tmp_path), tmp_path / "a.mcap", tmp_path / "a.log.jsonl"
    kept.write_text("another's\n")
    part_of(record).write_bytes(b"being written")
    assert main(["run", str(scene), "--record", str(record), "--no-view"]) == 2
    assert kept.read_text() == "another's\n"
    assert sorted(path.name for path in tmp_path.glob("*a.*")) == ["a.log.jsonl", "a.mcap.part"]


def test_a_refused_run_leaves_the_log_of_one_of_its_name_that_is_not_ready_yet(tmp_path: Path) -> None:
    path = tmp_path / "a.log.jsonl"
    with log.written("r", path):
        log.note("r", "the first")
        with pytest.raises(BadInput), log.written("r", path):
            raise BadInput("a run of that name is going on")
    assert [line["message"] for line in read(path)] == ["the first"]
    assert list(tmp_path.iterdir()) == [path]


def test_a_log_goes_into_a_pipe() -> None:
    reading, writing = os.pipe()
    with log.written("r", Path(f"/dev/fd/{writing}")):
        log.note("r", "through")
    os.close(writing)
    with open(reading) as stream:
        assert json.loads(stream.read())["message"] == "through"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_log_on_a_full_disk_is_given_up_with_a_word(capsys: pytest.CaptureFixture[str]) -> None:
    with log.written("r", Path("/dev/full")):
        for _ in range(3):
            log.note("r", "something")
    assert capsys.readouterr().err == "/dev/full is not whole: No space left on device\n"


def test_lines_go_to_standard_output_for_a_dash(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path, duration=0.04)
    assert main(["run", str(scene), "--no-record", "--no-view", "--log", "-"]) == 0
    said = capsys.readouterr()
    told = [json.loads(line) for line in said.out.splitlines()]
    assert [told[0]["message"], told[-1]["message"]] == ["start", "end: done"]
    assert "\ndigest " in said.err


def test_a_reader_of_the_log_that_leaves_is_told_of_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    back, to = os.pipe()
    with os.fdopen(to, "w") as stream:
        monkeypatch.setattr("sys.stdout", stream)
        with log.written("r", Path("-")):
            log.note("r", "read")
            assert json.loads(os.read(back, 4096))["message"] == "read"
            os.close(back)
            log.note("r", "not read")
            log.note("r", "nor this")
        monkeypatch.undo()
        said = capsys.readouterr().err
        with contextlib.suppress(BrokenPipeError):
            stream.close()
    assert said == "standard output is not whole: Broken pipe\n"


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
