"""What a recording says about where it comes from, so that it can be run again from itself."""

from __future__ import annotations

import contextlib
import json
import platform
from collections.abc import Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from nuno import registry
from nuno.scene.scene_file import Loaded
from nuno_schemas import SCHEMA_VERSION
from nuno_schemas.errors import BadInput

PACKAGES = ("nuno", "numpy", "numba", "llvmlite", "pydantic", "eclipse-zenoh", "mcap", "foxglove-sdk")


def describe_run(loaded: Loaded, run: str) -> dict[str, dict[str, str]]:
    """The opening metadata: run, scene, versions, plugins."""
    scene = loaded.scene
    return {
        "run": {"id": run, "scene": scene.name, "seed": str(scene.seed), "schema_version": str(SCHEMA_VERSION)},
        "scene": {"json": json.dumps(loaded.data), "file": Path(loaded.file).name, "chosen": loaded.why},
        "versions": versions(),
        "plugins": plugins(loaded),
    }


def versions() -> dict[str, str]:
    """Versions of what can change a result, and the processor that kernels are compiled for."""
    found = {"python": platform.python_version(), "platform": platform.platform(), "machine": platform.machine()}
    found["processor"] = processor()
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def processor() -> str:
    """The processor's name, as far as the system tells."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def plugins(loaded: Loaded) -> dict[str, str]:
    """`group/name` of every plugin in the scene -> package and version that provides it."""
    return {f"{c.group}/{c.name}": registry.package_version(c.group, c.name) for c in loaded.chosen}


def assets(loaded: Loaded) -> dict[str, Path]:
    """The files that the scene uses, by the names it gives them.

    These are the existing files among the strings of all plugin configurations. Building the
    models would tell exactly, but costs their memory a second time; a string that happens to
    name a file beside the scene only adds that file.
    """
    for chosen in loaded.chosen:
        for _, text in texts_in(chosen.config.model_dump()):
            with contextlib.suppress(BadInput, OSError, ValueError):
                loaded.files.resolve(text)
    return dict(loaded.files.used)


def texts_in(value: object, field: str = "") -> Iterator[tuple[str, str]]:
    """Texts in a configuration, each with the innermost field that it stands in."""
    if isinstance(value, str):
        yield field, value
    elif isinstance(value, Mapping):
        for name, item in value.items():
            yield from texts_in(item, name)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from texts_in(item, field)
