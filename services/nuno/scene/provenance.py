"""Provenance of a recording, from which its run can be repeated."""

from __future__ import annotations

import contextlib
import json
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from nuno.plugin_contract import registry
from nuno.scene.scene_file import Loaded
from nuno.scene.yaml_lines import walk
from nuno_schemas import SCHEMA_VERSION
from nuno_schemas.errors import BadInput

PACKAGES = ("nuno", "numpy", "numba", "llvmlite", "pydantic", "eclipse-zenoh", "mcap", "foxglove-sdk")
CHANGE_RESULTS = ("python", "nuno", "numpy", "numba", "llvmlite")
"""Packages whose versions can change a result."""


def describe_run(loaded: Loaded, run: str) -> dict[str, dict[str, str]]:
    """Return the opening metadata: run, scene, versions, plugins."""
    scene = loaded.scene
    return {
        "run": {"id": run, "scene": scene.name, "seed": str(scene.seed), "schema_version": str(SCHEMA_VERSION)},
        "scene": {"json": json.dumps(loaded.data), "file": Path(loaded.file).name, "chosen": loaded.why},
        "versions": versions(),
        "plugins": plugins(loaded),
    }


def versions() -> dict[str, str]:
    """Return the versions of packages that can change a result, and the processor that kernels are compiled for."""
    names = {"python": platform.python_version(), "platform": platform.platform(), "machine": platform.machine()}
    names["processor"] = processor()
    for package in PACKAGES:
        try:
            names[package] = version(package)
        except PackageNotFoundError:
            names[package] = "not installed"
    return names


def processor() -> str:
    """Return the processor's name, as far as the system has one."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def plugins(loaded: Loaded) -> dict[str, str]:
    """Return package and version of every plugin in the scene, by `group/name`."""
    return {f"{c.group}/{c.name}": registry.package_version(c.group, c.name) for c in loaded.chosen}


def assets(loaded: Loaded) -> dict[str, Path]:
    """Return the files that the scene uses, by their names in it.

    These are the existing files among the strings of all plugin configurations. Building the
    models would be exact, but takes their memory a second time; a string that happens to be
    a file's name only adds that file.
    """
    for chosen in loaded.chosen:
        for text in (text for _, text in walk(chosen.config.model_dump()) if isinstance(text, str)):
            with contextlib.suppress(BadInput, OSError, ValueError):
                loaded.files.resolve(text)
        if hasattr(chosen.plugin, "resolve"):  # files of a sequence, whose first alone is named
            with contextlib.suppress(BadInput, OSError, ValueError):
                chosen.plugin.resolve(chosen.config, loaded.files)
    return dict(loaded.files.used)
