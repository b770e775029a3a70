"""Commands that cannot be carried out as typed: exit code 2 before the start, 1 once running."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from refusals import Refused, largest_file, sheet
from scenes import write_scene

import nuno
from nuno.cli import main
from nuno.recording.writer import part_of
from nuno.runtime import runs
from nuno_schemas.errors import BadInput

COMMANDS: dict[str, tuple[list[str], str]] = {
    "unknown command": (["rnu"], "did you mean 'run'?"),
    "unknown flag": (["run", "SCENE", "--recrd", "x"], "nuno run --help"),
    "no scene": (["run"], "for example: nuno run skirt-hula"),
    "no such scene": (["run", "skirt-hulla"], "did you mean 'skirt-hula'?"),
    "no such file": (["run", "FOLDER/none.yaml"], "no such scene"),
    "a folder": (["run", "FOLDER"], "no such scene"),
    "an array for a scene": (["run", "FOLDER/chain.npz"], "a scene is YAML in UTF-8"),
    "negative threads": (
        ["run", "SCENE", "--threads", "-1"],
        "--threads: the number of threads is a whole number, not negative",
    ),
    "threads in words": (["run", "SCENE", "--threads", "two"], "--threads"),
    "run id with a slash": (["run", "SCENE", "--run", "../x"], "--run: not a run's name"),
    "run id that is a pattern": (["run", "SCENE", "--run", "*"], "--run: not a run's name"),
    "run id of the last run": (["run", "SCENE", "--run", "last"], "last means the last run: choose another"),
    "port beyond all": (["run", "SCENE", "--connect", "tcp/127.0.0.1:99999"], "with a port up to 65535"),
    "no port": (["run", "SCENE", "--listen", "tcp/127.0.0.1"], "not an endpoint"),
    "port of a router": (["serve", "router", "--listen", "tls/127.0.0.1:x"], "not an endpoint"),
    "name that is too long": (["run", "SCENE", "--record", f"{'a' * 246}.mcap"], "choose a shorter name"),
    "empty run id": (["run", "SCENE", "--run", ""], "--run: not a run's name"),
    "endpoint without protocol": (["run", "SCENE", "--listen", "7447"], "for example tcp/127.0.0.1:7447"),
    "no such configuration": (["run", "SCENE", "--config", "FOLDER/none.json5"], "--config: cannot be read"),
    "no configuration": (["run", "SCENE", "--config", "SCENE"], "--config: cannot be read"),
    "wrong override": (["run", "SCENE", "--set", "solver.dtt=1"], "--set: solver.dtt: no such field"),
    "half an override": (["run", "SCENE", "--set", "solver.dt"], "written key=value"),
    "resume noise": (["run", "--resume", "FOLDER/noise.mcap"], "not an MCAP file"),
    "resume nothing": (["run", "--resume", "FOLDER/none.mcap"], "No such file"),
    "resume with a scene": (["run", "SCENE", "--resume", "FOLDER/noise.mcap"], "leave the scene out"),
    "replay noise": (["replay", "FOLDER/noise.mcap"], "not an MCAP file"),
    "info of a folder": (["info", "FOLDER"], "Is a directory"),
    "export noise": (["export", "FOLDER/noise.mcap", "--npz", "FOLDER/o.npz"], "not an MCAP file"),
    "control nothing": (["control", "no-such-run", "pause"], "no such run is going on"),
    "control in no way": (["control", "last", "dance"], "invalid choice: 'dance'"),
    "serve nothing": (["serve", "simulatoin"], "invalid choice"),
    "serve without a run": (["serve", "simulation", "SCENE"], "needs --run"),
}


@pytest.mark.parametrize("fault", COMMANDS)
def test_wrong_commands(fault: str, refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command, words = COMMANDS[fault]
    monkeypatch.chdir(tmp_path)
    scene = write_scene(tmp_path)
    (tmp_path / "noise.mcap").write_bytes(bytes(range(256)) * 4)
    said = refused(*(part.replace("SCENE", str(scene)).replace("FOLDER", str(tmp_path)) for part in command))
    assert words in said
    assert not list((tmp_path / "recordings").glob("*"))


def test_the_port_is_taken(refused: Refused) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        said = refused.run("--listen", endpoint)
        assert "another program listens there" in said
        assert endpoint in said
        assert "choose another port" in said
        assert "another program listens" in refused("serve", "router", "--listen", endpoint)


def test_nobody_listens_where_it_connects(refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nuno.runtime.supervisor.CONNECT_PATIENCE", 0.1)
    said = refused.run("--connect", "tcp/127.0.0.1:9")
    assert "nothing answers there" in said
    assert "nuno serve router" in said


def test_recordings_that_cannot_be_written(refused: Refused, tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "other.mcap").write_text("my notes")
    (tmp_path / "open.mcap.part").write_text("")
    for name, words in {
        "folder.mcap": "Is a directory",
        "other.mcap": "what is there is no recording and would be lost",
        "open.mcap": "an unfinished recording is there",
        "chain.npz": "a recording's name ends in .mcap",
        "chain.npz/run.mcap": "cannot be written: File exists",
    }.items():
        said = refused("run", scene, "--no-view", "--record", tmp_path / name)
        assert words in said
        assert str(tmp_path) in said
    assert (tmp_path / "other.mcap").read_text() == "my notes"


@contextmanager
def without_root() -> Iterator[None]:
    """No rights beyond those that a file's mode gives, whoever runs the tests."""
    user = os.geteuid()
    os.seteuid(65534 if user == 0 else user)
    try:
        yield
    finally:
        os.seteuid(user)


def test_a_folder_without_permission() -> None:
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        closed = Path(name) / "closed"
        closed.mkdir(mode=0o555)
        with without_root(), pytest.raises(BadInput, match="cannot be written: Permission denied") as caught:
            runs.record_path(closed, "run")
        assert caught.value.value == str(closed)
        assert list(closed.iterdir()) == []


def test_no_room_while_recording_ends_the_run_and_keeps_what_was_whole(refused: Refused, tmp_path: Path) -> None:
    scene = write_scene(
        tmp_path, objects=sheet(resolution=[32, 32]), solver={"plugin": "symplectic_euler"}, duration=20.0
    )
    assert main(["run", str(scene), "--no-view", "--no-record", "--set", "duration=0.1"]) == 0  # compiles
    record = tmp_path / "run.mcap"
    with largest_file(6_000_000):
        said = refused("run", scene, "--no-view", "--record", record, code=1)
    assert "recorder service died: recording stopped: File too large" in said
    assert not record.exists()
    with nuno.open(part_of(record)) as kept:
        assert not kept.complete
        assert len(list(kept.frames())) > 50


def test_an_unstable_run_exits_with_1(refused: Refused, tmp_path: Path) -> None:
    scene = write_scene(tmp_path, solver={"plugin": "euler", "dt": "20 ms"}, allow_unstable=True, duration=20.0)
    said = refused("run", scene, "--no-view", "--record", tmp_path / "run.mcap", code=1)
    assert "diverged: 6 of 6 vertices have no finite position" in said
    with nuno.open(tmp_path / "run.mcap") as recording:
        assert recording.report()["state"] == "diverged"


def test_a_recording_of_another_scene_is_not_gone_on_from(refused: Refused, tmp_path: Path) -> None:
    nuno.run(write_scene(tmp_path, duration=0.2), record=tmp_path / "chain.mcap")
    flags = ["--resume", tmp_path / "chain.mcap", "--no-view", "--record", tmp_path / "on.mcap"]
    other = refused("run", *flags, "--set", "objects=[{name: a, model: {plugin: sheet, resolution: [4, 4]}}]")
    assert "this field cannot change when a run goes on from a checkpoint" in other
    assert "the recording goes on after that" in refused("run", *flags, "--set", "duration=0.1")
    assert not list(tmp_path.glob("on*"))


def test_the_api_refuses_alike(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    data = yaml.safe_load(scene.read_text())
    calls: list[tuple[Callable[[], object], str]] = [
        (lambda: nuno.run(scene, threads=-1), "a whole number, not negative"),
        (lambda: nuno.run(scene, threads="2"), "a whole number, not negative"),  # type: ignore[arg-type]
        (lambda: nuno.run(scene, record=3), "a recording is a file"),  # type: ignore[arg-type]
        (lambda: nuno.run(scene, "solver.dtt=1"), "no such field"),
        (lambda: nuno.run(data | {"durration": 1}), "no such field"),
        (lambda: nuno.run(tmp_path / "none.yaml"), "no such scene"),
        (lambda: nuno.open(scene), "not an MCAP file"),
    ]
    for call, words in calls:
        with pytest.raises(BadInput, match=words):
            call()


def test_exit_codes_of_the_command_itself(tmp_path: Path) -> None:
    """As typed: code and message reach the shell."""
    command = [sys.executable, "-m", "nuno", "run", str(write_scene(tmp_path, durration=1)), "--no-view"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith(f"error: {tmp_path / 'scene.yaml'}:2: durration: no such field")
    assert not (tmp_path / "recordings").exists()


def test_a_fault_of_the_command_itself_is_told_and_ends_with_1() -> None:
    """Not by a signal, as code that the C library calls when Python is no more would end it."""
    code = "from nuno import cli\ncli.main = lambda: 1 / 0\ncli.command()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and done.stderr.rstrip().endswith("ZeroDivisionError: division by zero")
