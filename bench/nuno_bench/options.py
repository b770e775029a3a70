"""Options shared by several measurements, and checks of their values and of installed packages."""

from __future__ import annotations

import argparse
import importlib.util
import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from nuno_schemas.errors import BadInput, nearest

SHARED: dict[str, dict[str, Any]] = {
    "scenes": {"nargs": "+", "metavar": "SCENE", "help": "a scene file, or the name of a shipped one"},
    "--set": {"action": "append", "default": [], "metavar": "KEY=VALUE", "dest": "overrides",
              "help": "change a field of the scene"},
    "--solvers": {"metavar": "A,B", "help": "solver plugins (default: all that are installed)"},
    "--resume": {"action": "store_true", "help": "go on with an interrupted sweep of the same arguments"},
    "--out": {"type": Path, "default": Path("recordings/bench"), "metavar": "DIR",
              "help": "where results go, and what is finished meanwhile (default: %(default)s)"},
    "--json": {"type": Path, "metavar": "FILE", "help": "write every figure as JSON"},
    "--html": {"type": Path, "metavar": "FILE", "help": "write a page"},
    "--rrd": {"type": Path, "metavar": "FILE", "help": "write the series as a rerun file, too"},
    "--docs": {"type": Path, "metavar": "FILE", "help": "put tables and pictures into this Markdown page's sections"},
}  # fmt: skip
INSTALL = {"matplotlib": "nuno[bench]"}
INSTALL |= dict.fromkeys(("mujoco", "newton", "ipctk", "rtree", "igl"), "nuno[peers]")
"""Requirements for pip of packages that only measurements use, if they differ from the package's name."""


def add_shared(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add shared options by name."""
    for name in names:
        parser.add_argument(name, **SHARED[name])


def add_count(parser: argparse.ArgumentParser, name: str, what: str, default: int | None = None) -> None:
    """Add an option for a number of at least 1."""

    def count(text: str) -> int:
        if (number := int(text)) < 1:
            raise BadInput("at least one is needed", field=name, value=number)
        return number

    parser.add_argument(name, type=count, default=default, metavar="N", help=what)


def add_seconds(parser: argparse.ArgumentParser, name: str, default: float, what: str) -> None:
    """Add an option for a positive wall time [s]."""

    def seconds(text: str) -> float:
        if not 0.0 < (number := float(text)) < math.inf:
            raise BadInput("some time is needed", field=name, value=number, limit="more than 0 s")
        return number

    what = f"{what} (default: %(default)g)"
    parser.add_argument(name, type=seconds, default=default, metavar="SECONDS", help=what)


def names_of(text: str | None) -> list[str]:
    """Split names at commas."""
    return [name for name in (text or "").split(",") if name]


def require_known(names: Sequence[str], known: Collection[str], what: str, field: str) -> None:
    """Raise BadInput for an unknown name, with the nearest known one."""
    for name in names:
        if name not in known:
            raise BadInput(f"no such {what}", field=field, value=name, remedy=nearest(name, known))


def missing_package(package: str) -> str:
    """Return an error with the way to install a package; empty if it is installed."""
    installed = importlib.util.find_spec(package) is not None
    return "" if installed else f"{package} is not installed (pip install '{INSTALL.get(package, package)}')"


def require_package(what: str, package: str, field: str | None = None) -> None:
    """Raise BadInput, that begins with `what`, if a package is not installed."""
    if missing_package(package):
        remedy = f"pip install '{INSTALL.get(package, package)}'"
        raise BadInput(f"{what} {package}, which is not installed", field=field, remedy=remedy)
