"""The distributions hold all of the project and nothing else, and no code runs what a file or message says."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterator
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


SOURCES = sorted(path for kind in ("schemas", "services", "plugins", "bench") for path in (ROOT / kind).rglob("*.py"))
MODULES = {"pickle", "cPickle", "dill", "marshal", "shelve", "joblib", "imp", "runpy", "code"}
CALLS = {
    "eval", "exec", "compile", "os.system", "os.popen", "yaml.load", "yaml.full_load", "yaml.unsafe_load",
    "importlib.util.spec_from_file_location", "importlib.machinery.SourceFileLoader", "tempfile.mktemp",
    "ssl._create_unverified_context", "tarfile.open",
}  # fmt: skip
BY_NAME = (
    "nuno/cli/__init__.py", "nuno/runtime/service.py", "nuno_bench/cli.py", "nuno_bench/speed/command.py",
    "nuno_bench/peers/process.py", "nuno_kernels/__init__.py",
)  # fmt: skip
"""Where modules are imported by a name that a table in the code gives, not a file or a message."""
OF_TYPES = "nuno_kernels/terms.py"
"""Makes a function for the types in a tuple, whose source names kernels by their numbers alone."""


def findings(source: str, place: str = "") -> list[str]:
    """What in a module's text could run foreign code."""
    return [f"{place}:{line} {what}" for line, what in _found(ast.parse(source), place)]


def _found(tree: ast.AST, place: str) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            bad = [name for name in names if name.partition(".")[0] in MODULES]
            yield from ((node.lineno, f"imports {name}") for name in bad)
        if not isinstance(node, ast.Call):
            continue
        name = _dotted(node.func)
        given = {word.arg: _constant(word.value) for word in node.keywords if word.arg in ("shell", "allow_pickle")}
        if name in CALLS and not (name == "exec" and place.endswith(OF_TYPES)):
            yield node.lineno, f"calls {name}"
        if given.get("shell", False) is not False:
            yield node.lineno, "starts a shell"
        if name in ("np.load", "numpy.load") and given.get("allow_pickle") is not False:
            yield node.lineno, "np.load without allow_pickle=False"
        if name in ("importlib.import_module", "__import__") and not place.endswith(BY_NAME):
            yield node.lineno, f"calls {name}"


def _dotted(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f"{_dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def _constant(node: ast.expr) -> object:
    return node.value if isinstance(node, ast.Constant) else "unknown"


def test_no_code_is_run_that_is_not_the_projects() -> None:
    found = [text for path in SOURCES for text in findings(path.read_text(), str(path.relative_to(ROOT)))]
    assert found == []


def test_what_is_installed_in_containers_is_pinned_by_hash() -> None:
    """Every requirement of deploy/requirements.txt has one version and hashes, and none of the project's is missing."""
    text = (ROOT / "deploy" / "requirements.txt").read_text().replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.strip()]
    assert all("==" in line and "--hash=sha256:" in line for line in lines)
    pinned = {line.partition("==")[0] for line in lines}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = {text.partition(">=")[0] for text in project["dependencies"]}
    assert "rerun-sdk" in wanted <= pinned


@pytest.mark.parametrize(
    "bad",
    [
        "import pickle",
        "from marshal import loads",
        "eval(text)",
        "yaml.load(text)",
        "subprocess.run(text, shell=True)",
        "np.load(path)",
        "np.load(path, allow_pickle=True)",
        "importlib.import_module(name)",
    ],
)
def test_the_search_finds_it(bad: str) -> None:
    assert len(findings(bad)) == 1
