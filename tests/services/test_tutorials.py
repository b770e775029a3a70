"""Each tutorial runs as it is written, from an empty folder, prints what it says it prints, and draws its pictures."""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from PIL import Image

import nuno_bench.cli
from nuno.cli import parser_of
from nuno.recording.reader import open_recording
from nuno.scene import scene_file
from nuno_schemas.messages import PENETRATION

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "tutorials"
TUTORIALS = sorted(path for path in FOLDER.glob("*.md") if path.stem != "index")
FENCE = re.compile(r"^```(\S*)[ ]?([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PICTURE = re.compile(r"!\[[^\]]*\]\((?:\.\./pictures/)?(tutorial-[^)]+)\)")
KNOWN = ("python", "pip", "echo", "cat", "sed", "kill", "sleep", "wait")
"""What commands of a page are beside those of nuno."""
LIMIT = 1800.0
"""Seconds that a tutorial may take, kernels compiled anew, beside other tests."""


@dataclass(frozen=True)
class Fence:
    """A block of a page: commands (`sh`), what they print (`text`), or a file, which is named behind its language."""

    language: str
    file: str
    code: str


def fences(page: Path) -> list[Fence]:
    return [Fence(*found) for found in FENCE.findall(page.read_text(encoding="utf-8"))]


def commands(page: Path) -> list[list[str]]:
    """All simple commands of a page's shell, as words, up to where they are redirected."""
    found: list[list[str]] = []
    for fence in fences(page):
        for line in fence.code.replace("\\\n", " ").splitlines() if fence.language == "sh" else ():
            lexer = shlex.shlex(line, posix=True, punctuation_chars=";|&<>")
            lexer.whitespace_split, lexer.commenters = True, ""
            words: list[str] = []
            for word in [*lexer, ";"]:
                if set(word) <= set(";|&"):
                    found += [list(takewhile(lambda word: not set(word) <= set("<>"), words))] if words else []
                    words = []
                elif word not in ("until", "do", "done"):
                    words.append(word)
    return found


def script(page: Path) -> str:
    """The page for bash: files are written, commands run; a line after each block of commands tells which it was."""
    lines = ["set -e -o pipefail", "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT"]
    for number, fence in enumerate(fences(page)):
        if fence.file:
            folder = Path(fence.file).parent
            lines += [f"mkdir -p {shlex.quote(str(folder))}", f"cat > {shlex.quote(fence.file)} <<'END OF THE FILE'"]
            lines += [fence.code + "END OF THE FILE"]
        elif fence.language == "sh":
            lines += [fence.code, f"printf '\\nend of block {number}\\n'"]
    return "\n".join(lines) + "\n"


def is_printed(shown: str, said: str) -> bool:
    """Whether lines were printed in this order: `...` stands for anything, on a line of its own for lines."""
    rest = [" ".join(line.split()) for line in said.splitlines()]
    for line in (" ".join(line.split()) for line in shown.splitlines()):
        if line in ("", "..."):
            continue
        pattern = re.compile(re.escape(line).replace(re.escape("..."), ".*"))
        place = next((i for i, printed in enumerate(rest) if pattern.fullmatch(printed)), None)
        if place is None:
            return False
        rest = rest[place + 1 :]
    return True


def differing(shown: Path, drawn: Path) -> float:
    """Mean difference of two pictures, as a share of white; the one in the page is smaller, and of fewer colours."""
    with Image.open(shown) as one, Image.open(drawn) as other:
        assert abs(one.width / one.height - other.width / other.height) < 0.01
        a, b = (np.asarray(image.convert("RGB").resize((160, 120)), np.float64) for image in (one, other))
    return float(np.abs(a - b).mean() / 255.0)


def test_the_index_has_each() -> None:
    index = (FOLDER / "index.md").read_text(encoding="utf-8")
    assert TUTORIALS and all(f"({path.name})" in index for path in TUTORIALS)


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_all_code_is_told_apart_and_read(page: Path) -> None:
    """A block is shell, output of the shell above it, or a named file; commands are known, and files can be read."""
    before = ""
    for fence in fences(page):
        assert (fence.language in ("sh", "text")) != bool(fence.file), "no block is of no one's business"
        assert fence.language != "text" or before == "sh", "what is printed stands below what prints it"
        before = fence.language
        if fence.file.endswith((".yaml", ".yml")):
            assert yaml.safe_load(fence.code)
        elif fence.file.endswith(".py"):
            ast.parse(fence.code)
    for words in commands(page):
        if words[0] == "nuno":
            _, parser = parser_of(words[1])
            args = parser.parse_args(words[2:])
            if words[1] == "bench":
                _, parser = nuno_bench.cli.parser_of(args.kind)
                parser.parse_args(args.arguments)
        else:
            assert words[0] in KNOWN, words


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_scenes_are_scenes(page: Path, tmp_path: Path) -> None:
    """Their fields and values; what their files hold is looked at where they are run."""
    for fence in fences(page):
        if fence.file and fence.code.startswith("nuno: 1"):
            (tmp_path / fence.file).write_text(fence.code, encoding="utf-8")
            assert scene_file.read(tmp_path / fence.file).scene.name


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_pictures_are_small_and_made_by_its_commands(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    shown = PICTURE.findall(text)
    assert shown and all((ROOT / "docs" / "pictures" / name).stat().st_size <= 120_000 for name in shown)
    assert all(drawn_as(name, page) in text for name in shown)


def drawn_as(name: str, page: Path) -> str:
    """The file that a tutorial's commands draw, of which `tutorial-PAGE-FILE.png` is a smaller copy."""
    return name.removeprefix(f"tutorial-{page.stem}-")


@pytest.mark.full
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_runs_as_it_is_written(page: Path, tmp_path: Path) -> None:
    folder, tools, packages = tmp_path / "empty", tmp_path / "bin", tmp_path / "packages"
    folder.mkdir()
    tools.mkdir()
    for name, what in (("nuno", " -m nuno"), ("python", ""), ("pip", " -m pip")):
        (tools / name).write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)}{what} "$@"\n')
        (tools / name).chmod(0o755)
    parts = [packages, *(ROOT / part for part in ("schemas", "services", "plugins", "bench")), *sys.path]
    # A package of the tutorial's own is built by what is installed, and goes with the test.
    pip = {"TARGET": str(packages), "NO_BUILD_ISOLATION": "0", "NO_DEPS": "1", "NO_INDEX": "1"}
    env = os.environ | {f"PIP_{name}": value for name, value in pip.items()}
    env |= {"PATH": os.pathsep.join([str(tools), os.environ["PATH"]]), "PYTHONPATH": os.pathsep.join(map(str, parts))}
    with (tmp_path / "said").open("w+", encoding="utf-8") as said:
        done = subprocess.run(
            ["bash", "-c", script(page)], cwd=folder, env=env, stdin=subprocess.DEVNULL, stdout=said,
            stderr=subprocess.STDOUT, timeout=LIMIT, start_new_session=True,
        )  # fmt: skip
        said.seek(0)
        printed = said.read()
    assert done.returncode == 0, printed[-4000:]
    blocks = fences(page)
    start = 0
    for number, fence in enumerate(blocks):
        if fence.language == "sh":
            end = printed.index(f"\nend of block {number}\n")
            below = blocks[number + 1] if number + 1 < len(blocks) else None
            if below and below.language == "text":
                assert is_printed(below.code, printed[start:end]), (
                    f"{below.code}\nwas not printed:\n{printed[start:end]}"
                )
            start = end
    exported = {folder / name for name in re.findall(r"--(?:foxglove|ros2) (\S+)", page.read_text(encoding="utf-8"))}
    for recorded in folder.rglob("*.mcap"):
        if exported & {recorded, *recorded.parents}:
            continue
        with open_recording(recorded) as recording:
            reports = [json.loads(message.payload) for message in recording.messages([PENETRATION.name])]
        assert not any(report["area"] for report in reports), f"{recorded.name} has cloth inside bodies"
    for name in PICTURE.findall(page.read_text(encoding="utf-8")):
        assert differing(ROOT / "docs" / "pictures" / name, folder / drawn_as(name, page)) < 0.02, name


@pytest.mark.parametrize("script", ["body.py", "scan.py"])
def test_a_tutorials_body_stands_where_the_glb_file_puts_it(
    script: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A box on the floor, moved there by its node, beside cloth of another place; scan.py makes a scan in mm, z up."""
    scene, raised = trimesh.Scene(), trimesh.transformations.translation_matrix([0.0, 0.5, 0.0])
    scene.add_geometry(trimesh.creation.box(), geom_name="bodies", transform=raised)
    scene.add_geometry(trimesh.creation.box(), geom_name="skirt")
    monkeypatch.chdir(tmp_path)
    for name in ("skirt.glb", "leg.glb"):
        scene.export(name)
    (code,) = (fence.code for page in TUTORIALS for fence in fences(page) if fence.file == script)
    exec(code, {})
    (made,) = tmp_path.glob("mine.*")
    up, unit = (2, 1000.0) if script == "scan.py" else (1, 1.0)
    assert trimesh.load_mesh(made).bounds[:, up] == pytest.approx([0.0, unit], abs=1e-6)
