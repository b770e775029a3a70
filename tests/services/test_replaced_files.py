"""Files that a run would replace: a recording by a whole one only, and nothing that is another kind of file."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from live_run import start_long
from refusals import Refused
from scenes import write_scene

import nuno
from nuno.cli import main
from nuno.output_files import check_target
from nuno.process import Terminated
from nuno.recording.writer import part_of
from nuno.runtime import log
from nuno.runtime.supervisor import Supervisor
from nuno.studio.draw.append import write_whole
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


def test_a_log_replaces_a_log_only(refused: Refused, tmp_path: Path) -> None:
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
        assert "would be lost" in said or name in ("scene.yaml", "chain.npz")
        assert path.read_bytes() == data
    for data in (b"", json.dumps(line).encode() + b"\n", json.dumps(line).encode() + b"\ncut"):
        (tmp_path / "a.jsonl").write_bytes(data)
        with log.written("r", tmp_path / "a.jsonl"):
            log.note("r", log.READY)
        assert log.READY in (tmp_path / "a.jsonl").read_text()


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
