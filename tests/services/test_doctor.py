"""`nuno doctor` says of each thing whether a run would work, and what to do where it would not."""

from __future__ import annotations

from pathlib import Path

import pytest

from nuno.cli import doctor, main


def test_a_machine_that_runs_nuno_passes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["doctor"]) == 0
    rows = {line[7:21].strip(): line[:6].strip() for line in capsys.readouterr().out.splitlines()}
    wanted = {"python", "memory", "kernels", "threads", "kernel cache", "gpu", "bus", "port", "recordings"}
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
