"""The commands that README and docs show are commands: each is read by its own parser, the cheap ones run."""

from __future__ import annotations

import argparse
import re
import shlex
import shutil
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from doc_pages import ROOT, blocks
from refusals import sheet
from scenes import write_scene

import nuno
import nuno_bench.cli
from nuno.cli import COMMANDS, main, parser_of
from nuno_schemas.errors import BadInput

sys.path.insert(0, str(ROOT / "docs"))
import durations

PAGES = [
    ROOT / "README.md",
    *sorted(page for page in (ROOT / "docs").rglob("*.md") if page.parent.name != "tutorials"),  # test_tutorials.py
]
START, TOUR = "docs/start/index.md", "docs/start/tour.md"


def commands(page: Path) -> list[list[str]]:
    """Every `nuno ...` line of a page's code, fenced or indented, without comment and `&`, as words."""
    indented = re.findall(r"^    (nuno .*)$", page.read_text(), re.MULTILINE)
    lines = [*"\n".join(blocks(page, "sh")).splitlines(), *indented]
    return [
        shlex.split(line, comments=True) for line in (line.rstrip(" &") for line in lines) if line.startswith("nuno ")
    ]


SHOWN = [(str(page.relative_to(ROOT)), words) for page in PAGES for words in commands(page)]


def test_the_pages_show_commands() -> None:
    shown = {name: {words[1] for page, words in SHOWN if page == name} for name in ("README.md", TOUR)}
    assert shown["README.md"] >= {"scenes", "plan", "run", "info", "replay", "verify", "export", "bench"}
    assert shown[TOUR] >= set(COMMANDS) - {"serve", "certs", "plugins", "schema", "fabric", "yarns"}
    assert {page for page, _ in SHOWN} >= {"README.md", "docs/how-to/hosts.md", "docs/how-to/viewing.md"}


@pytest.mark.parametrize(
    ("page", "words"), SHOWN, ids=lambda value: value if isinstance(value, str) else " ".join(value)
)
def test_every_command_is_read_by_its_parser(page: str, words: list[str]) -> None:
    _, parser = parser_of(words[1])
    args = parser.parse_args(words[2:])
    if words[1] == "bench":
        nuno_bench.cli.parser_of(args.kind)[1].parse_args(args.arguments)


def test_an_option_with_one_value_is_not_given_two() -> None:
    """Of all commands, and whatever the first value is; a parser may be used again."""
    parsers = [parser_of(name)[1] for name in COMMANDS]
    parsers += [nuno_bench.cli.parser_of(kind)[1] for kind in nuno_bench.cli.COMMANDS]
    known = [(parser, action) for parser in parsers for action in parser._actions if action.option_strings]
    single = [(parser, action) for parser, action in known if isinstance(action, argparse._StoreAction)]
    assert {action.option_strings[-1] for _, action in single} >= {"--frame", "--record", "--repeats", "--threads"}
    for parser, action in single:
        number = action.nargs if isinstance(action.nargs, int) else 1
        given = [action.option_strings[-1], *[str(next(iter(action.choices or "1")))] * number]
        for _ in range(2):
            with pytest.raises(BadInput, match=f"{action.option_strings[-1]}.*more than once"):
                parser.parse_args([*given, *given])


def test_the_readme_is_short_and_says_how_long_each_command_takes() -> None:
    """All but those that go on until they are ended, and what needs other packages."""
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 120
    first, measuring = (text.split(f"## {name}\n")[1].split("\n## ")[0] for name in ("First ten minutes", "Measuring"))
    untimed = [
        shlex.split(line, comments=True)[1:3]
        for line in (first + measuring).splitlines()
        if line.startswith("nuno ") and not durations.TIMED.match(line)
    ]
    assert untimed == [["replay", "last"], ["studio"], ["bench", "peers"]]


def test_durations_are_written_where_they_stand() -> None:
    text = "nuno a --b  # c (d) (7 s)\nnuno e  # f\nnuno g  # h (9 min)\n    nuno i  # j (2 s)\n"
    asked: list[str] = []

    def run(command: str) -> float:
        asked.append(command)
        return 0.2 if command == "nuno a --b" else 150.0

    written = durations.write_durations(text, run)
    assert written == text.replace("(7 s)", "(1 s)").replace("(9 min)", "(2 min)")
    assert asked == ["nuno a --b", "nuno g"]
    assert [durations.describe(seconds) for seconds in (0.1, 1.6, 119.4, 120.0)] == ["1 s", "2 s", "119 s", "2 min"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("readme")
    scene = write_scene(folder, objects=sheet(), solver={"plugin": "symplectic_euler"}, duration=0.1)
    nuno.run(scene, record=folder / "RUN.mcap")
    return folder / "RUN.mcap"


FIRST = list({
    tuple(words): words for page, words in SHOWN
    if page in ("README.md", START, TOUR)
    and (words[1] in ("scenes", "fabrics", "info", "export", "verify", "new") or "--resume" in words)
}.values())  # fmt: skip
CHEAP = [words for words in FIRST if not any(set(words) < set(other) for other in FIRST)]
"""Of two of which one says all that the other does only that one."""


@pytest.mark.parametrize("words", CHEAP, ids=" ".join)
def test_cheap_commands_of_the_first_pages_run(
    words: list[str], recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nuno.viewer.live.has_screen", lambda: False)
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
