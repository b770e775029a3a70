"""Imports form a V: plugins -> schemas <- services."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
OWN = {
    path.name for folder in ("schemas", "services", "plugins") for path in (ROOT / folder).iterdir() if path.is_dir()
}
PLUGINS = {path.name for path in (ROOT / "plugins").iterdir() if path.is_dir()}
HOST_LIBRARIES = {"zenoh", "mcap", "rerun", "foxglove"}


def allowed(package: str) -> set[str]:
    """Packages of this project that `package` may import."""
    if package == "nuno_schemas":
        return {"nuno_schemas"}
    if package == "nuno_kernels":
        return {"nuno_schemas", "nuno_kernels"}
    if package in PLUGINS:
        return {"nuno_schemas", "nuno_kernels", package}
    return {"nuno_schemas", "nuno", package}


def imported(path: Path) -> set[str]:
    """Top-level packages that a file imports, wherever in the file."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            found.add(node.module.split(".")[0])
    return found


@pytest.mark.parametrize("package", sorted(name for name in OWN if not name.startswith((".", "_"))))
def test_package_imports_only_what_it_may(package: str) -> None:
    folder = next(
        ROOT / kind / package for kind in ("schemas", "services", "plugins") if (ROOT / kind / package).is_dir()
    )
    wrong = {}
    for path in folder.rglob("*.py"):
        names = imported(path)
        bad = (names & OWN) - allowed(package)
        if package in PLUGINS or package == "nuno_schemas":
            bad |= names & HOST_LIBRARIES
        if bad:
            wrong[str(path.relative_to(ROOT))] = sorted(bad)
    assert not wrong
