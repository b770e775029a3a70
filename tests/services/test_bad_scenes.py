"""Scenes, files and commands that cannot run: exit code, field, line, remedy, and no false recording."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import yaml
from refusals import Refused, largest_file, of_file, sheet, write_net
from scenes import BALL, write_scene

import nuno
from nuno.cli import main
from nuno.recording.writer import part_of
from nuno.runtime import runs
from nuno.scene import scene_file
from nuno_schemas.errors import BadInput

SKIRT = {"plugin": "skirt", "waist_radius": 0.1, "hem_radius": 0.2, "length": 0.3}


STEPS: dict[str, tuple[dict[str, Any], str]] = {
    "does not divide a frame": (
        {"solver": {"plugin": "rk4", "dt": "3 ms", "strict": True}},
        "0.002857143 s (7 steps) or 0.003333333 s (6 steps)",
    ),
    "longer than a frame": (
        {"solver": {"plugin": "rk4", "dt": "30 ms"}, "allow_unstable": True}, "a frame is shorter than a step",
    ),
    "above the limit, as is what is nearest": ({"solver": {"plugin": "rk4", "dt": "30 ms"}}, "dt: auto"),
    "above the limit": (
        {"solver": {"plugin": "rk4", "dt": "20 ms"}, "objects": sheet()}, "above the stability limit",
    ),
    "so small that no frame ends": ({"solver": {"plugin": "rk4", "dt": 1e-300}}, "10,000,000 steps a frame"),
    "unstable whatever it is": ({"solver": {"plugin": "euler"}}, "use symplectic_euler, leapfrog or rk4"),
}  # fmt: skip


@pytest.mark.parametrize("fault", STEPS)
def test_steps_that_cannot_be_taken(fault: str, refused: Refused, tmp_path: Path) -> None:
    change, words = STEPS[fault]
    said = refused.run(**change)
    assert words in said
    assert f"{tmp_path / 'scene.yaml'}:" in said
    assert "solver." in said


def test_numbers_beyond_float64_are_refused(refused: Refused, tmp_path: Path) -> None:
    for change in ({"k": np.full(2, 1e300)}, {"m": np.full(3, 1e-300)}, {"x": np.diag([0, 1e300, 1e308])}):
        write_net(tmp_path / "bad.npz", **change)
        said = refused.run(objects=of_file("bad.npz"), solver={"plugin": "rk4"})
        assert "too large or too small" in said
        assert "Warning" not in said


PARTS: dict[str, tuple[dict[str, Any], str, str]] = {
    "attached to no body": (
        {"objects": [{"name": "skirt", "model": SKIRT | {"attach": {"body": "bal", "frame": "world"}}}],
         "bodies": BALL},
        "objects[0].model.attach: cloth is attached to a frame that no body has", "did you mean 'ball/world'?",
    ),
    "taken by no body": (
        {"objects": sheet(), "bodies": BALL, "operations": [{"plugin": "attach", "at": 0.1, "body": "bal"}]},
        "operations[0].body: there is no such body", "did you mean 'ball'?",
    ),
    "let go of by no body": (
        {"objects": sheet(), "operations": [{"plugin": "release", "at": 0.1, "body": "ball"}]},
        "operations[0].body: there is no such body", "give the scene the body",
    ),
    "felt by no body": (
        {"record": {"contact_forces": True}}, "record.contact_forces: there are no bodies", "give the scene some",
    ),
    "attached to no frame": (
        {"objects": [*sheet(), {"name": "s", "model": SKIRT | {"attach": {"body": "ball", "frame": "hips"}}}],
         "bodies": BALL},
        "objects[1].model.attach: cloth is attached", "known: ball/world",
    ),
    "attached where there are no bodies": (
        {"objects": [{"name": "skirt", "model": SKIRT | {"attach": {"body": "ball", "frame": "world"}}}]},
        "objects[0].model.attach", "known: none",
    ),
    "no such joint": (
        {"bodies": [{"name": "b", "collider": {"plugin": "sphere", "radius": 1, "joint": "hip"},
                     "motion": {"plugin": "hula"}}]},
        "bodies[0].collider.joint: no such joint", "did you mean 'hips'?",
    ),
    "missing motion": (
        {"bodies": [{"name": "b", "collider": {"plugin": "skeleton"}, "motion": {"plugin": "bvh", "file": "no.bvh"}}]},
        "bodies[0].motion.file: no such file", "--root DIR",
    ),
    "pin -1": ({"objects": sheet(pin=[-1])}, "objects[0].model.pin[0]: no such vertex", "0 to 15"),
    "wind on a net": ({"forces": [{"plugin": "wind"}]}, "forces[0]: wind blows on triangles", "use particle_wind"),
}  # fmt: skip


@pytest.mark.parametrize("fault", PARTS)
def test_parts_that_do_not_fit_together(fault: str, refused: Refused, tmp_path: Path) -> None:
    change, words, advice = PARTS[fault]
    said = refused.run(**change)
    assert words in said
    assert advice in said
    assert f"{tmp_path / 'scene.yaml'}:" in said.replace("scene.yaml: ", "")  # with its line


def test_a_refusal_leaves_no_service_behind(refused: Refused, tmp_path: Path) -> None:
    """A service that refuses ends the others, also those that wait for it."""
    began = time.monotonic()
    refused.run(bodies=[{"name": "b", "collider": {"plugin": "skeleton"}, "motion": {"plugin": "bvh", "file": "no"}}])
    names = {thread.name for thread in threading.enumerate()}
    assert not {"simulation", "collision", "recorder"} & names
    # Waiting for the collision service would take 30 s.
    assert time.monotonic() - began < 25


def test_processes_refuse_alike_and_once(refused: Refused, tmp_path: Path) -> None:
    said = refused.run("--processes", objects=of_file("no.npz"))
    assert said.count("objects[0].model.file: no such file") == 1


def test_a_scene_larger_than_memory_is_refused_before_it_is_built(refused: Refused) -> None:
    before = psutil.Process().memory_info().rss
    said = refused.run(objects=sheet(resolution=[16384, 16384]))
    assert "268,435,456 vertices, about 100.0 GiB" in said
    assert "GiB are free" in said
    assert "lower the resolution" in said
    assert "scene.yaml:5: objects" in said
    # Positions alone would be 6 GiB.
    assert psutil.Process().memory_info().rss - before < 500 * 2**20


FILES: dict[str, tuple[str, str, bytes | None, str]] = {
    "missing net": ("net", "bad.npz", None, "no such file"),
    "empty net": ("net", "bad.npz", b"", "not a readable .npz file"),
    "truncated net": ("net", "bad.npz", b"PK\x03\x04" + b"\0" * 50, "not a readable .npz file"),
    "missing mesh": ("mesh", "bad.obj", None, "no such file"),
    "empty mesh": ("mesh", "bad.obj", b"", "the mesh has no triangles"),
    "noise for a mesh": ("mesh", "bad.ply", bytes(range(256)) * 4, "cannot be read as PLY"),
    "mesh that promises too much": (
        "mesh", "bad.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\n"
        b"property float x\nproperty float y\nproperty float z\nend_header\n", "cannot be read as PLY",
    ),
    "mesh of another kind": ("mesh", "bad.docx", b"x", "unknown kind of mesh"),
    "name with a NUL": ("net", "a\0b", None, "not the name of a file"),
    "name too long": ("net", "a" * 5000, None, "not the name of a file"),
    "empty name": ("net", "", None, "no such file"),
    "folder": ("net", ".", None, "no such file"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FILES)
def test_files_that_cannot_be_used(fault: str, refused: Refused, tmp_path: Path) -> None:
    plugin, name, content, words = FILES[fault]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    said = refused.run(objects=of_file(name, plugin))
    assert words in said
    assert f"{tmp_path / 'scene.yaml'}:" in said
    assert "objects[0].model" in said


@pytest.fixture
def outside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that is not the scene's, with a net."""
    folder = tmp_path_factory.mktemp("outside")
    write_net(folder / "net.npz")
    return folder


@pytest.mark.parametrize("how", ["relative", "absolute", "link", "link to itself"])
def test_paths_that_leave_the_folder(how: str, refused: Refused, tmp_path: Path, outside: Path) -> None:
    names = {
        "relative": os.path.relpath(outside / "net.npz", tmp_path),
        "absolute": str(outside / "net.npz"),
        "link": "link.npz",
        "link to itself": "loop.npz",
    }
    (tmp_path / "link.npz").symlink_to(outside / "net.npz")
    (tmp_path / "loop.npz").symlink_to(tmp_path / "loop.npz")
    said = refused.run(objects=of_file(names[how]))
    assert "objects[0].model.file" in said
    if how != "link to itself":
        assert "leaves the scene's folder" in said
        assert (f"to {outside / 'net.npz'}" in said) is (how == "link")
        assert (f"--root {outside}" if how == "link" else "--root DIR") in said
        assert str(tmp_path) in said


def test_a_link_may_lead_into_a_folder_that_the_user_names(tmp_path: Path, outside: Path) -> None:
    """As its remedy says, whatever the file is called there."""
    (tmp_path / "other.npz").symlink_to(outside / "net.npz")
    scene = write_scene(tmp_path, objects=of_file("other.npz"), duration=0.1)
    loaded = scene_file.read(scene, [], [outside])
    assert loaded.files.resolve("other.npz") == (outside / "net.npz").resolve()


def test_a_root_opens_its_folder_and_no_other(refused: Refused, tmp_path: Path, outside: Path) -> None:
    command = ["run", write_scene(tmp_path, objects=of_file("net.npz"), duration=0.1), "--no-view", "--no-record"]
    assert main([*map(str, command), "--root", str(outside)]) == 0
    (outside / "link.npz").symlink_to("/etc/passwd")
    for name in ("../secret.npz", "/etc/passwd", "link.npz"):
        said = refused.run("--root", outside, objects=of_file(name))
        assert "leaves the scene's folder" in said or "no such file" in said
        assert str(outside) in said
    assert "--root: no such folder" in refused.run("--root", tmp_path / "nowhere")


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
    "other capitals": (
        ["plan", "dye/drops", "--set", "dye.dyes.0.isotherm={plugin: langmuir, k: 5}"],
        "did you mean 'K'?",
    ),
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
    "serve what goes on without a scene": (
        ["serve", "dye", "--resume", "a.mcap", "--run", "r", "--connect", "tcp/127.0.0.1:1"],
        "nuno export a.mcap --scene own.yaml, then nuno serve dye own.yaml --resume a.mcap --run r --connect tcp/12",
    ),
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
    for item, possible in (("gravity=[0, -1, 0]", True), ("objects[0].model.fabric=wool", False)):
        other = refused("run", *flags, "--set", item)
        assert f"{item.partition('=')[0].partition('[')[0]}: this field cannot change" in other and item in other
        assert ("nuno control last set" in other) == possible  # whose answer to the other is a refusal as well
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
