"""What surrounds a command: the files of its folder, a user's own files, streams, names of files."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from scenes import write_scene

import nuno
from nuno.cli import main
from nuno.cli.common import find_own
from nuno.scene.yaml_lines import parse_value
from nuno_schemas.errors import BadInput

NUNO = str(Path(sys.executable).with_name("nuno"))


def shell(script: str, folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """What `sh` makes of a script, in which "$@" is the command."""
    command = ["sh", "-c", script, "sh", NUNO, *map(str, arguments)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture
def shadowed(shared_data: Path, tmp_path: Path) -> Path:
    """A folder with a scene, and files that have the names of modules and end whoever imports them."""
    write_scene(tmp_path, duration=0.04)
    for name in ("queue.py", "nuno.py", "random.py", "pickle.py"):
        shutil.copy(shared_data / "cases" / "16-shadowed" / "queue.py", tmp_path / name)
    return tmp_path


def test_services_import_no_file_of_the_working_folder_and_need_no_standard_stream(shadowed: Path) -> None:
    """In processes of their own, with all streams closed: the recording is whole."""
    run = ("run", "scene.yaml", "--no-view", "--record", "run.mcap", "--processes")
    assert shell('"$@" <&- >&- 2>&-', shadowed, *run).returncode == 0
    with nuno.open(shadowed / "run.mcap") as recording:
        assert recording.complete and sum(1 for _ in recording.frames()) == 3


@pytest.mark.full
def test_those_who_compute_a_sweep_import_no_file_of_the_working_folder(shadowed: Path) -> None:
    over = ("--over", "solver.dt=1 ms, 2 ms", "--side", "none", "--jobs", "2", "--out", "swept")
    done = shell('"$@"', shadowed, "sweep", "scene.yaml", *over)
    assert done.returncode == 0 and "mine" not in done.stderr


@pytest.mark.parametrize(
    ("closing", "command", "code"),
    [
        (">&-", "--version", 0), ("2>&-", "--version", 0), ("<&- >&- 2>&-", "--version", 0), ("2>&-", "nonsense", 2),
        ("2> /dev/full", "nonsense", 2), ("> /dev/full", "--version", 1), ("> /dev/full", "--help", 1),
    ],
)  # fmt: skip
def test_streams_that_are_closed_or_full_crash_nothing(closing: str, command: str, code: int, tmp_path: Path) -> None:
    """What cannot be printed on a full disk is a failure, said in words; what nobody wants to read is none."""
    done = shell(f'"$@" {closing}', tmp_path, command)
    assert done.returncode == code
    assert "Traceback" not in done.stderr
    assert ("standard output cannot be written: No space left on device" in done.stderr) is (closing == "> /dev/full")


def test_standard_output_may_be_read_in_part(tmp_path: Path) -> None:
    done = shell('"$@" | head -c 10', tmp_path, "--help")
    assert done.stdout == "nuno: text" and done.stderr == ""


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


LONG = "x" * 256 + ".yaml"
BYTES = os.fsdecode(b"caf\xe9")
"""Not UTF-8."""
NAMED = {
    "run": ["run", "NAME"], "record": ["run", "SCENE", "--record", "NAME"],
    "save": ["run", "SCENE", "--save", "NAME.rrd"],
    "root": ["run", "SCENE", "--root", "NAME"], "resume": ["run", "--resume", "NAME"], "info": ["info", "NAME"],
    "verify": ["verify", "NAME"], "replay": ["replay", "NAME"], "export": ["export", "NAME", "--npz", "a.npz"],
    "plan": ["plan", "NAME"], "weave": ["weave", "NAME"], "sew": ["sew", "NAME", "--body", "NAME"],
    "fit": ["fit", "NAME"], "certs": ["certs", "NAME"], "draw": ["draw", "NAME"],
    "log": ["run", "SCENE", "--log", "NAME"],
    "new": ["new", "skirt", "NAME"],
}  # fmt: skip


@pytest.mark.parametrize("name", [LONG, BYTES], ids=["long", "not UTF-8"])
@pytest.mark.parametrize("command", NAMED)
def test_names_that_no_file_can_have_are_refused_in_words(
    command: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By every command, before anything is written."""
    monkeypatch.chdir(tmp_path)
    scene = str(write_scene(tmp_path))
    before = files(tmp_path)
    assert main([part.replace("SCENE", scene).replace("NAME", name) for part in NAMED[command]]) == 2
    said = capsys.readouterr().err
    assert ("File name too long" if name == LONG else r"is not UTF-8") in said and "remedy" in said
    assert files(tmp_path) == before


def test_a_folder_whose_name_is_not_utf_8_is_named(tmp_path: Path) -> None:
    """In a form that any terminal shows, and not in the words of Python."""
    folder = tmp_path / BYTES
    folder.mkdir()
    done = shell('"$@"', folder, "run", write_scene(tmp_path), "--no-view")
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert r"caf\udce9" in done.stderr and "rename" in done.stderr


@pytest.mark.parametrize("close", ["sys.stdout.close()", "sys.stderr.close()", "open(1, 'w', closefd=False).close()"])
def test_a_plugin_cannot_close_the_streams_of_a_command(close: str) -> None:
    begin, end = "import sys; from nuno import process; process.open_streams()", "print('err', file=sys.stderr)"
    code = f"{begin}; {close}; print('out'); {end}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("out\n", "err\n")


def test_a_file_is_found_where_the_command_is_typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "leg.obj").touch()
    monkeypatch.chdir(tmp_path)
    found = find_own(tmp_path / "scene.yaml", ["bodies.leg.collider.file=scans/leg.obj", "duration=1 s"])
    assert found == (["bodies.leg.collider.file=leg.obj", "duration=1 s"], [tmp_path / "scans"])


def test_files_inside_of_a_mapping_are_found_and_all_else_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "leg, left.obj").touch()
    monkeypatch.chdir(tmp_path)
    value = "{plugin: mesh, file: 'scans/leg, left.obj', scale: 1e-3, up: z, centre: [0, 1 cm, '0'], mend: true}"
    item, folders = find_own(tmp_path / "scene.yaml", [f"bodies.0.collider={value}"])
    key, _, text = item[0].partition("=")
    assert (key, folders) == ("bodies.0.collider", [tmp_path / "scans"])
    assert parse_value(text) == parse_value(value) | {"file": "leg, left.obj"}


def test_another_file_beside_the_scene_is_not_taken_for_it(tmp_path: Path) -> None:
    for folder in ("own", "scene"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "leg.obj").touch()
    with pytest.raises(BadInput, match=r"another file of this name.*\n(.*\n)*.*give yours another name"):
        find_own(tmp_path / "scene" / "scene.yaml", [f"bodies.leg.file={tmp_path / 'own' / 'leg.obj'}"])


@pytest.mark.parametrize(
    "value", ["{points: [" + "0.25, " * 100 + "0.5]}", "1" * 5000 + ".5", "~nobody-of-this-name/leg.obj", "a\0.obj", ""]
)
def test_what_no_file_can_be_called_is_a_value(value: str, tmp_path: Path) -> None:
    assert find_own(tmp_path / "scene.yaml", [f"operations={value}"]) == ([f"operations={value}"], [])
