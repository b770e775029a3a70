"""The distributions: they hold all of the project and nothing else, and one version is told everywhere."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from distributions import ROOT, build
from packaging.requirements import Requirement
from packaging.version import Version

import nuno

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LARGEST = 4_000_000
"""Bytes of a wheel that is small beside what it needs (numba, rerun, SciPy: some hundred megabytes)."""


def test_no_version_of_numba_is_taken_that_was_not_tried() -> None:
    """Kernels reach into its compiler, which changes from one minor version to the next."""
    (numba,) = (one for one in map(Requirement, PROJECT["project"]["dependencies"]) if one.name == "numba")
    here = Version(version("numba"))
    assert numba.specifier.contains(here)
    assert not numba.specifier.contains(Version(f"{here.major}.{here.minor + 1}"))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("wheel", tmp_path_factory.mktemp("wheel"))


def test_a_wheel_holds_all_of_the_packages_and_nothing_else(wheel: Path) -> None:
    """Modules, pages, templates, scenes with their files: each as it is in the source, with its bytes."""
    settings = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    places = {ROOT / path: Path(path).name for path in settings["packages"]}
    places |= {ROOT / path: name for path, name in settings["force-include"].items()}
    kept = subprocess.run(["git", "ls-files", "-coz", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True)
    files = [ROOT / name for name in kept.stdout.split("\0") if name and (ROOT / name).is_file()]
    if kept.returncode != 0:
        files = [path for path in ROOT.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    expected = {
        f"{name}/{path.relative_to(place).as_posix()}": path.read_bytes()
        for place, name in places.items() for path in files if path.is_relative_to(place)
    }  # fmt: skip
    with zipfile.ZipFile(wheel) as packed:
        found = {name: packed.read(name) for name in packed.namelist() if ".dist-info/" not in name}
    assert len(expected) > 500
    assert found == expected


def test_a_wheel_has_every_package_and_each_says_that_it_is_typed(wheel: Path) -> None:
    packages = {
        path.parent.name for kind in ("schemas", "services", "plugins", "bench") for path in ROOT.glob(f"{kind}/*/*.py")
    }
    with zipfile.ZipFile(wheel) as packed:
        names = set(packed.namelist())
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == packages
    assert {f"{package}/py.typed" for package in packages} <= names


def test_a_wheel_is_small(wheel: Path) -> None:
    assert wheel.stat().st_size < LARGEST


@pytest.mark.full
def test_a_source_distribution_builds_the_same_wheel_from_itself(wheel: Path, tmp_path: Path) -> None:
    source = build("sdist", tmp_path / "source")
    with tarfile.open(source) as packed:
        packed.extractall(tmp_path, filter="data")
    again = build("wheel", tmp_path / "again", tmp_path / source.name.removesuffix(".tar.gz"))
    assert again.name == wheel.name and again.read_bytes() == wheel.read_bytes()


def test_what_is_told_of_the_version_is_the_projects() -> None:
    version = PROJECT["project"]["version"]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    notes = re.findall(r"^## (\S+) \((\S+)\)$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert cited["version"] == version
    assert notes[0] == (version, str(cited["date-released"]))
    assert cited["license"] == PROJECT["project"]["license"]


def test_the_citation_is_one_by_its_schema() -> None:
    checker = shutil.which("check-jsonschema", path=str(Path(sys.executable).parent))
    if checker is None:
        pytest.skip("needs check-jsonschema, of nuno[dev]")
    command = [checker, "--builtin-schema", "vendor.citation-file-format", "--output-format", "json", "CITATION.cff"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, json.loads(done.stdout)


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
