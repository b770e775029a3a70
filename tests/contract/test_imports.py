"""Imports form a V, plugins -> schemas <- services, with the benchmarks over all of it, and go in no circle, neither
between files nor between parts of the host.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
OWN = {
    path.name
    for folder in ("schemas", "services", "plugins", "bench")
    for path in (ROOT / folder).iterdir()
    if path.is_dir()
}
PLUGINS = {path.name for path in (ROOT / "plugins").iterdir() if path.is_dir()}
HOST_LIBRARIES = {"zenoh", "mcap", "rerun", "foxglove"}


def allowed(package: str) -> set[str]:
    """Packages of this project that `package` may import."""
    if package == "nuno_schemas":
        return {"nuno_schemas"}
    if package == "nuno_kernels":
        return {"nuno_schemas", "nuno_kernels"}
    if package == "nuno_geometry":
        return {"nuno_schemas", "nuno_kernels", "nuno_geometry"}
    if package in PLUGINS:
        return {"nuno_schemas", "nuno_kernels", "nuno_geometry", package}
    if package == "nuno_bench":  # a tool over the rest: it also times the parts of a plugin one by one
        return {"nuno_schemas", "nuno", package} | PLUGINS
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
        ROOT / kind / package
        for kind in ("schemas", "services", "plugins", "bench")
        if (ROOT / kind / package).is_dir()
    )
    wrong = {}
    for path in folder.rglob("*.py"):
        names = imported(path)
        if path == ROOT / "services" / "nuno" / "__init__.py":
            names -= {"nuno_bench"}  # for type checkers alone: `nuno.sweep` is loaded when it is first used
        bad = (names & OWN) - allowed(package)
        if package in PLUGINS or package == "nuno_schemas":
            bad |= names & HOST_LIBRARIES
        if bad:
            wrong[str(path.relative_to(ROOT))] = sorted(bad)
    assert not wrong


def find_modules() -> dict[str, Path]:
    """Every file of the project by the name it is imported by, a folder's __init__ by the folder's."""
    found = {}
    for kind in ("schemas", "services", "plugins", "bench"):
        for path in (ROOT / kind).rglob("*.py"):
            parts = path.relative_to(ROOT / kind).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def each_import(node: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Imports wherever in a file, also those of functions; what is there for types alone (TYPE_CHECKING) never runs."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif not (isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING"):
            yield from each_import(child)


MODULES = find_modules()


def modules_in(path: Path) -> set[str]:
    """Modules that a file imports, the project's by their files and others as they are named."""
    found = set()
    for node in each_import(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif node.module:
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else node.module for name in inner}
    return found


def circle(imports: dict[str, set[str]]) -> list[str]:
    """One circle, if there is any."""
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_no_circle_of_files() -> None:
    imports = {name: (modules_in(path) & MODULES.keys()) - {name} for name, path in MODULES.items()}
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}}), "a circle is not seen"
    assert circle(imports) == []


def test_no_circle_of_the_hosts_parts() -> None:
    """A part is a folder of the host, or a file beside them."""
    imports: dict[str, set[str]] = {}
    for name, path in MODULES.items():
        if name.startswith("nuno."):
            parts = {".".join(one.split(".")[:2]) for one in modules_in(path) if one.startswith("nuno.")}
            part = ".".join(name.split(".")[:2])
            imports.setdefault(part, set()).update(parts - {part})
    assert {"nuno.bus", "nuno.scene"} <= imports.keys() and "nuno.scene" in imports["nuno.runtime"]
    assert circle(imports) == []


def test_no_test_imports_another_test() -> None:
    """What tests share is a helper module or a fixture."""
    for path in (ROOT / "tests").rglob("*.py"):
        assert not [name for name in imported(path) if name.startswith("test_")], path


def test_the_bus_imports_nothing_above_it() -> None:
    """It imports the standard library, libraries, the schemas, and itself."""
    bus = [path for name, path in MODULES.items() if name.startswith("nuno.bus")]
    own = {one for path in bus for one in modules_in(path) if one.split(".")[0] in OWN}
    assert bus and {one.split(".")[0] for one in own if not one.startswith("nuno.bus")} == {"nuno_schemas"}
