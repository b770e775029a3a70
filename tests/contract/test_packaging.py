"""The distribution: a wheel holds only `nuno*`, and every entry point in it can be loaded."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

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
    for path in (ROOT / "services/nuno/draw/page").iterdir():
        assert f"nuno/draw/page/{path.name}" in names
    for path in (ROOT / "scenes").glob("*.yaml"):
        assert f"nuno/scenes/{path.name}" in names
