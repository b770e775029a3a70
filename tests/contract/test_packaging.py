"""The distribution: a wheel holds only `nuno*`, and every entry point in it can be loaded."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import nuno

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    return zipfile.ZipFile(next(folder.glob("*.whl")))


def test_wheel_holds_only_this_project(wheel: zipfile.ZipFile) -> None:
    tops = {name.split("/")[0] for name in wheel.namelist()}
    assert all(top.startswith("nuno") for top in tops), tops


def test_wheel_holds_every_module_and_scene(wheel: zipfile.ZipFile) -> None:
    names = set(wheel.namelist())
    for kind in ("schemas", "services", "plugins"):
        for path in (ROOT / kind).rglob("*.py"):
            assert str(path.relative_to(ROOT / kind)) in names
    for folder in ("nuno/pages/shared", "nuno/studio/page"):
        for path in (ROOT / "services" / folder).iterdir():
            assert f"{folder}/{path.name}" in names
    for path in (ROOT / "scenes").glob("*.yaml"):
        assert f"nuno/scenes/{path.name}" in names


@pytest.mark.full
def test_another_projects_type_checker_knows_what_nuno_gives(tmp_path: Path) -> None:
    """Every name of `nuno` has a type of its own, that of `nuno.sweep` too, which is loaded when it is first used."""
    shows = "\n".join(f"reveal_type(nuno.{name})" for name in nuno.__all__)
    (tmp_path / "other.py").write_text(f"import nuno\n{shows}\nreveal_type(nuno.sweep('net', {{}}).rows)\n")
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), "other.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    told = [line for line in done.stdout.splitlines() if "Revealed type" in line]
    assert done.returncode == 0, done.stdout
    assert len(told) == len(nuno.__all__) + 1 and not [line for line in told if '"Any"' in line]
