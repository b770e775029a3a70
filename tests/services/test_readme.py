"""The commands that README and docs show are commands: each is read by its own parser, the cheap ones run."""

from __future__ import annotations

import argparse
import importlib
import re
import shlex
import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from refusals import sheet
from scenes import write_scene

import nuno
import nuno_bench.cli
from nuno.cli import main, parser_of

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    *sorted(page for page in (ROOT / "docs").rglob("*.md") if page.parent.name != "tutorials"),  # test_tutorials.py
]


def blocks(page: Path, language: str) -> list[str]:
    """Fenced code of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


def commands(page: Path) -> list[list[str]]:
    """Every `nuno ...` line of a page's code, fenced or indented, without comment and `&`, as words."""
    indented = re.findall(r"^    (nuno .*)$", page.read_text(), re.MULTILINE)
    lines = [*"\n".join(blocks(page, "sh")).splitlines(), *indented]
    return [
        shlex.split(line, comments=True) for line in (line.rstrip(" &") for line in lines) if line.startswith("nuno ")
    ]


SHOWN = [(str(page.relative_to(ROOT)), words) for page in PAGES for words in commands(page)]


def test_the_pages_show_commands() -> None:
    tour = {words[1] for page, words in SHOWN if page == "README.md"}
    assert tour >= {"scenes", "plan", "run", "control", "info", "replay", "export", "bench"}
    assert {page for page, _ in SHOWN} >= {"README.md", "docs/explanation/services.md", "docs/how-to/viewing.md"}


@pytest.mark.parametrize(
    ("page", "words"), SHOWN, ids=lambda value: value if isinstance(value, str) else " ".join(value)
)
def test_every_command_is_read_by_its_parser(page: str, words: list[str]) -> None:
    _, parser = parser_of(words[1])
    args = parser.parse_args(words[2:])
    if words[1] == "bench":
        parser = argparse.ArgumentParser(exit_on_error=False)
        importlib.import_module(nuno_bench.cli.COMMANDS[args.kind][0]).add_arguments(parser)
        parser.parse_args(args.arguments)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("readme")
    scene = write_scene(folder, objects=sheet(), solver={"plugin": "symplectic_euler"}, duration=0.1)
    nuno.run(scene, record=folder / "RUN.mcap")
    return folder / "RUN.mcap"


CHEAP = [
    words for page, words in SHOWN
    if page == "README.md"
    and (words[1] in ("scenes", "fabrics", "info", "export", "verify") or "--resume" in words)
]  # fmt: skip


@pytest.mark.parametrize("words", CHEAP, ids=" ".join)
def test_cheap_commands_of_the_readme_run(
    words: list[str], recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nuno.viewer.require.has_screen", lambda: False)
    (tmp_path / "recordings").mkdir()
    shutil.copy(recording, tmp_path / "recordings")
    longer = ["--set", "duration=0.2 s"] if "--resume" in words else []  # the recorded run has come to its end
    shorter = ["0.1" if before == "--turn" else word for before, word in pairwise(words)]
    assert main([*shorter, *longer]) == 0
    for name in (word for word in words if word.startswith("out.")):
        assert (tmp_path / name).stat().st_size > 0


def test_the_script_of_the_readme_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (script,) = blocks(ROOT / "README.md", "python")
    assert "duration=1" in script
    found: dict[str, Any] = {}
    exec(script.replace("duration=1", "duration=0.1"), found)
    assert found["frame"].x.shape == found["result"].x.shape
    assert str(found["result"].x.shape) in capsys.readouterr().out
