"""A command that needs what is not installed says so first, with what installs it, and then does nothing."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from nuno.cli import main
from nuno_bench.peers.command import choose, leave_out
from nuno_bench.peers.process import SHEET_KINDS
from nuno_bench.report.page import Result
from nuno_bench.speed import command as speed

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
