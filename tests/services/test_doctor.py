"""nuno doctor, and commands that need what is not installed, say so first, with a remedy."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from nuno.cli import doctor, main
from nuno_bench.peers.command import choose, leave_out
from nuno_bench.peers.process import SHEET_KINDS
from nuno_bench.report.page import Result
from nuno_bench.speed import command as speed


def test_a_machine_that_runs_nuno_passes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["doctor"]) == 0
    rows = {line[7:21].strip(): line[:6].strip() for line in capsys.readouterr().out.splitlines()}
    wanted = {"python", "memory", "kernels", "threads", "kernel cache", "bus", "recordings"}
    assert wanted <= set(rows) and "failed" not in rows.values()
    assert list(tmp_path.iterdir()) == []


def test_what_would_stop_a_run_fails_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recordings").write_text("a file in the folder's place")
    monkeypatch.setattr(doctor, "LEAST_MEMORY", 2**60)
    assert main(["doctor"]) == 1
    said = capsys.readouterr().out
    for name in ("recordings", "memory"):
        at = said.index(f"failed {name}")
        assert "remedy: " in said[at:].split("\n", 2)[1]


@pytest.mark.full
def test_a_home_that_cannot_be_written_is_done_without(tmp_path: Path) -> None:
    """Below a file nobody can make a folder: neither kernels nor units are kept, and both are ready."""
    (tmp_path / "file").write_text("no folder")
    own = {name: value for name, value in os.environ.items() if name != "XDG_CACHE_HOME"}
    run = [sys.executable, "-m", "nuno", "doctor"]
    home = {"HOME": str(tmp_path / "file" / "home")}
    ended = subprocess.run(run, env=own | home, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout
    rows = {line[7:21].strip(): line for line in ended.stdout.splitlines()}
    assert rows["kernels"].startswith("ok") and "OpenMP" not in rows["threads"]
    assert rows["kernel cache"].startswith("note") and f"{home['HOME']}/.cache/nuno" in rows["kernel cache"]


def test_nothing_is_said_of_threads_before_a_kernel_ran(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: Any) -> None:
        raise OSError("no kernels")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(doctor, "Simulation", fail)
    assert main(["doctor"]) == 1
    said = capsys.readouterr().out
    assert "failed kernels" in said and "OpenMP" not in said
    assert said.count("not known: no kernel has run") == 2


@pytest.mark.parametrize(
    ("name", "value"), [("NUMBA_DISABLE_JIT", "1"), ("NUMBA_NUM_THREADS", "0"), ("NUMBA_NUM_THREADS", "two")]
)
def test_settings_without_which_kernels_run_are_named_at_the_start_too(
    name: str, value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(name, value)
    assert main(["doctor"]) == 1
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("failed kernels"))
    assert f"{name}={value}: numba " in row
    assert main(["run", "net", "--no-view"]) == 2
    said = capsys.readouterr().err
    assert f"{name}: numba" in said and f"unset {name}" in said
    monkeypatch.delenv(name)
    assert main(["plan", "net"]) == 0


EXTRAS = ("matplotlib", "imageio_ffmpeg", "mujoco", "newton", "ipctk", "igl", "rtree", "open3d", "dask", "distributed")


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is installed but what comes with nuno: to import one of these fails, and to look for it finds none."""
    for name in EXTRAS:
        monkeypatch.setitem(sys.modules, name, None)


@pytest.mark.parametrize(
    ("command", "packages", "extra"),
    [
        ("bench peers", "matplotlib", "bench"),
        ("bench peers contact", "ipctk", "peers"),
        ("bench precision net", "matplotlib", "bench"),
        ("bench stability net", "matplotlib", "bench"),
        ("bench integrators skirt-paper", "matplotlib", "bench"),
        ("validate --html page.html", "matplotlib", "bench"),
        ("validate --dask tcp://127.0.0.1:1", "Dask", "sweep"),
    ],
)
def test_what_is_missing_is_named_with_what_installs_it(
    bare: None, command: str, packages: str, extra: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """As bad input: nothing has run, and there is no trace."""
    assert main(command.split()) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("error: ")
    assert packages in said.err and f"pip install 'nuno[{extra}]'" in said.err and "Traceback" not in said.err


def test_a_named_peer_that_is_missing_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setitem(sys.modules, "newton", None)
    assert main(["bench", "peers", "--only", "numpy,newton-vbd"]) == 2
    assert "needs newton, which is not installed" in (said := capsys.readouterr().err)
    assert "pip install 'nuno[peers]'" in said


def test_peers_that_are_missing_are_named_before_anything_is_measured(bare: None, capsys: Any) -> None:
    told = leave_out(choose(SHEET_KINDS, None), None)
    assert capsys.readouterr().err.splitlines() == told
    assert "(pip install 'nuno[peers]')" in told[0]
    assert [("mujoco-edges" in text, "newton-vbd" in text) for text in told] == [(True, False), (False, True)]


def test_all_cases_go_on_without_a_peer_that_is_missing(
    bare: None, monkeypatch: pytest.MonkeyPatch, capsys: Any, tmp_path: Path
) -> None:
    """Said before the first, and in what is kept; nothing has failed."""
    monkeypatch.setattr(speed, "CASES", {name: speed.CASES[name] for name in ("wrinkle", "closest")})
    monkeypatch.setattr(speed, "run_case", lambda name, repeats: [Result(name, "what", "unit", (1.0,))])
    kept = tmp_path / "speed.json"
    assert main(["bench", "speed", "--json", str(kept)]) == 0
    out, err = capsys.readouterr()
    rtree = "closest has fewer peers: rtree is not installed (pip install 'nuno[peers]'), igl is"
    assert err.splitlines()[0].startswith(rtree) and err.splitlines()[1] == "wrinkle ..."
    assert rtree in out and "closest has fewer peers" in kept.read_text()
