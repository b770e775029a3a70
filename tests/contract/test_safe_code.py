"""No code of the project runs what a file or a message says: no pickle, no eval, no shell, nothing loaded by path."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
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
