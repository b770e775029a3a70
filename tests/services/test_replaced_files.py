"""Files that a run replaces or leaves: a recording by a whole one only, and what killed processes leave goes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from live_run import start_long
from recorded_sheet import Sheet, write
from refusals import Refused
from scenes import write_scene

import nuno
from nuno import process as scratches
from nuno.cli import main
from nuno.output_files import check_target
from nuno.process import HIDDEN, PREFIX, Terminated, scratch
from nuno.recording.writer import part_of
from nuno.runtime import log
from nuno.runtime.log import written
from nuno.runtime.supervisor import Supervisor
from nuno.studio.scenes import write_whole
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import FrameStatus


@pytest.fixture
def ended_by(monkeypatch: pytest.MonkeyPatch) -> list[type[KeyboardInterrupt]]:
    """What the signal of a run's fifth frame raises; none while it is empty."""
    signals: list[type[KeyboardInterrupt]] = []
    follow = Supervisor.follow

    def follow_until_ended(supervisor: Supervisor) -> str:
        shown = supervisor.progress

        def progress(status: FrameStatus | str) -> None:
            if shown is not None:
                shown(status)
            if isinstance(status, FrameStatus) and status.frame >= 5 and signals:
                raise signals.pop()

        supervisor.progress = progress
        return follow(supervisor)

    monkeypatch.setattr(Supervisor, "follow", follow_until_ended)
    return signals


@pytest.mark.parametrize(
    ("signal", "how"),
    [
        (Terminated, []),
        pytest.param(KeyboardInterrupt, [], marks=pytest.mark.full),
        pytest.param(Terminated, ["--processes"], marks=pytest.mark.full),
        pytest.param(KeyboardInterrupt, ["--processes"], marks=pytest.mark.full),
    ],
)
def test_a_run_ended_by_a_signal_replaces_no_recording(
    signal: type[KeyboardInterrupt],
    how: list[str],
    tmp_path: Path,
    ended_by: list[type[KeyboardInterrupt]],
    capsys: pytest.CaptureFixture[str],
) -> None:
    scene, record = write_scene(tmp_path, duration=0.1), tmp_path / "keep.mcap"
    command = ["run", str(scene), "--no-view", "--record", str(record)]
    assert main(command) == 0
    before, part = record.read_bytes(), part_of(record)
    ended_by.append(signal)
    assert main([*command, "--set", "duration=400", *how]) == 1
    assert record.read_bytes() == before
    assert f"{part}  ({record} stays as it was" in capsys.readouterr().out
    with nuno.open(part) as recording:
        assert not recording.complete and not recording.recovered
        point = recording.last_checkpoint()
    assert point.frame >= 5
    assert main(command) == 2, "the unfinished one is not replaced, either"
    assert "an unfinished recording is there" in capsys.readouterr().err
    onward = ["run", "--resume", str(part), "--no-view", "--record", str(tmp_path / "on.mcap")]
    assert main([*onward, "--set", f"duration={point.t + 0.1:.2f}"]) == 0
    with nuno.open(tmp_path / "on.mcap") as recording:
        assert recording.complete
    part.unlink()
    assert main([*command, "--set", "duration=0.2"]) == 0
    assert record.read_bytes() != before and not part.exists()


def test_python_names_the_recording_that_replaced_no_other(
    tmp_path: Path, ended_by: list[type[KeyboardInterrupt]]
) -> None:
    scene, record = write_scene(tmp_path, duration=0.1), tmp_path / "keep.mcap"
    nuno.run(scene, record=record)
    before = record.read_bytes()
    ended_by.append(KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt, match=re.escape(f"recording kept in {part_of(record)}")):
        nuno.run(scene, record=record, duration=400)
    assert record.read_bytes() == before
    part_of(record).unlink()
    with pytest.raises(RunFailed, match=re.escape(f"recording kept in {part_of(record)}")):
        nuno.run(scene, "solver.dt=20ms", "allow_unstable=true", record=record, duration=20)
    assert record.read_bytes() == before


def test_a_run_stopped_by_control_replaces_a_recording(tmp_path: Path) -> None:
    record = tmp_path / "long.mcap"
    record.write_bytes(b"\x89MCAP0\r\n")
    start_long(tmp_path, bodies=[]).stop()
    with nuno.open(record) as recording:
        assert recording.complete and recording.metadata["end"]["state"] == "stopped"
    assert not part_of(record).exists()


def test_a_log_is_appended_to_a_log_only(refused: Refused, tmp_path: Path) -> None:
    scene, line = write_scene(tmp_path, duration=0.1), {"time": "", "level": "info", "run": "r", "message": "start"}
    texts = {
        "old.mcap": b"\x89MCAP0\r\n\xff\n",
        "notes.jsonl": b"my notes\n",
        "other.jsonl": b'{"time": "2026", "level": "info", "msg": "of another program"}\n',
        "list.json": b"[1, 2]\n",
        "number.json": b"5\n",
        "deep.json": b"[" * 70_000,
        "scene.yaml": scene.read_bytes(),
        "chain.npz": (tmp_path / "chain.npz").read_bytes(),
    }
    for name, data in texts.items():
        path = tmp_path / name
        path.write_bytes(data)
        said = refused("run", scene, "--no-view", "--no-record", "--log", path)
        assert "--log" in said and str(path) in said
        assert "no log of runs" in said or name in ("scene.yaml", "chain.npz")
        assert path.read_bytes() == data
    for data in (b"", json.dumps(line).encode() + b"\n", json.dumps(line).encode() + b"\ncut"):
        (tmp_path / "a.jsonl").write_bytes(data)
        for run in ("first", "second"):
            with log.written(run, tmp_path / "a.jsonl"):
                log.note(run, log.READY)
        before, own = data.decode().splitlines(), (tmp_path / "a.jsonl").read_text().splitlines()
        assert own[:-2] == before  # a line that was cut stays alone
        assert [json.loads(text)["run"] for text in own[-2:]] == ["first", "second"]


def test_a_log_that_is_rotated_by_copytruncate_has_no_hole(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    with log.written("r", path):
        log.note("r", log.READY)
        path.write_bytes(b"")
        log.note("r", "after")
    assert json.loads(path.read_text())["message"] == "after"


@pytest.mark.parametrize("name", ["z.mcap", "./z.mcap", "z.mcap.part", "z.rrd", "z.rrd.part"])
def test_a_log_is_no_file_that_the_run_writes(
    name: str, refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = write_scene(tmp_path)
    before = sorted(tmp_path.iterdir())
    said = refused("run", scene, "--record", tmp_path / "z.mcap", "--save", "z.rrd", "--log", name)
    assert "the run itself uses that file" in said and "--log" in said
    assert sorted(tmp_path.iterdir()) == before


def test_a_file_for_no_recording_is_refused(refused: Refused, tmp_path: Path) -> None:
    record = tmp_path / "x.mcap"
    said = refused("run", write_scene(tmp_path), "--no-record", "--record", record, "--no-view")
    assert "argument --record: not allowed with argument --no-record" in said
    assert not record.exists()


def test_a_refused_recording_is_not_announced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nor is a solver chosen before."""
    scene, record = write_scene(tmp_path, solver="auto"), tmp_path / "notes.mcap"
    record.write_text("my notes")
    assert main(["run", str(scene), "--no-view", "--record", str(record)]) == 2
    said = capsys.readouterr()
    assert said.out == "" and "would be lost" in said.err
    assert record.read_text() == "my notes"
    record.write_bytes(b"\x89MCAP0\r\n")
    assert main(["run", str(scene), "--no-view", "--record", str(record), "--log", str(scene)]) == 2
    assert capsys.readouterr().out == ""


def test_write_protected_files_stay(refused: Refused, tmp_path: Path) -> None:
    """Also for root, who may write any file."""
    scene = write_scene(tmp_path)
    record, picture, kept = tmp_path / "archive.mcap", tmp_path / "a.png", tmp_path / "a.jsonl"
    record.write_bytes(b"\x89MCAP0\r\n")
    picture.write_bytes(b"\x89PNG")
    kept.write_bytes(b"")
    texts = {path: path.read_bytes() for path in (record, picture, kept, scene)}
    for path in texts:
        path.chmod(0o444)
    said = refused("run", scene, "--no-view", "--record", record)
    assert "write-protected" in said and str(record) in said and "chmod u+w" in said
    assert "write-protected" in refused("run", scene, "--no-view", "--no-record", "--log", kept)
    with pytest.raises(BadInput, match="write-protected"):
        check_target(picture, ".png")
    with pytest.raises(BadInput, match="write-protected"):
        write_whole(scene, "nuno: 1\n")
    assert {path: path.read_bytes() for path in texts} == texts
    assert {path.stat().st_mode & 0o777 for path in texts} == {0o444}
    picture.chmod(0o644)
    check_target(picture, ".png")


CHILD = """
import sys, time
from pathlib import Path
from nuno import process as scratch
from nuno.runtime.log import written
with scratch.scratch(Path(sys.argv[1]) if sys.argv[1] else None) as folder, written("run", Path(sys.argv[2])):
    (folder / "file").write_text("data")
    print(folder, flush=True)
    time.sleep(60)
"""


@contextmanager
def _child(beside: Path | None, log: Path) -> Iterator[tuple[Path, subprocess.Popen[str]]]:
    """A process that has a scratch folder, and a log that no service has made ready."""
    words = [sys.executable, "-c", CHILD, str(beside or ""), str(log)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        try:
            yield Path(child.stdout.readline().strip()), child
        finally:
            child.kill()


@pytest.mark.parametrize("beside", [False, True])
def test_what_a_killed_process_left_goes_and_what_is_held_stays(
    tmp_path: Path, beside: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scratches, "YOUNG", 0.0)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    log, where = tmp_path / "a.log.jsonl", tmp_path if beside else None
    with _child(where, log) as (folder, child):
        assert folder.parent == tmp_path and folder.name.startswith(HIDDEN if beside else PREFIX)
        with scratch(where), written("other", tmp_path / "b.log.jsonl"):
            assert (folder / "file").is_file()
        child.kill()
        child.wait()
        assert folder.is_dir()
        with scratch(where), written("other", tmp_path / "b.log.jsonl"):
            assert not folder.exists()
    assert not list(tmp_path.iterdir())


@pytest.fixture
def sheet(tmp_path: Path) -> Path:
    write(tmp_path / "a.mcap", Sheet(3, 2), 4)
    return tmp_path / "a.mcap"


def test_a_failed_export_of_frames_leaves_nothing(sheet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a folder that it has made, nor the frames before the one that fails; one that was there stays."""

    def fail(done: int, total: int) -> None:
        if done == 3:
            raise BadInput("enough")

    monkeypatch.setattr("nuno.cli.recordings.progress_lines", lambda each: fail)
    before = set(sheet.parent.iterdir())
    assert main(["export", str(sheet), "--obj", str(sheet.parent / "frames")]) == 2
    assert set(sheet.parent.iterdir()) == before
    (sheet.parent / "frames").mkdir()
    assert main(["export", str(sheet), "--obj", str(sheet.parent / "frames")]) == 2
    assert list((sheet.parent / "frames").iterdir()) == []


def test_a_whole_export_takes_away_what_a_killed_one_left(sheet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scratches, "YOUNG", 0.0)
    frames = sheet.parent / "frames"
    (frames / f"{HIDDEN}left").mkdir(parents=True)
    (frames / f"{HIDDEN}left" / "frame_00000.obj").write_text("# nuno")
    assert main(["export", str(sheet), "--obj", str(frames)]) == 0
    assert sorted(path.name for path in frames.iterdir()) == [f"frame_0000{i}.obj" for i in range(4)]
