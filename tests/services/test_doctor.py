"""`nuno doctor` says of each thing whether a run would work, and what to do where it would not."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from nuno.cli import doctor, main


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
