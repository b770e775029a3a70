"""Packages that a measurement uses beside those that come with nuno: whether they are there, and what installs them."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable

from nuno_schemas.errors import BadInput

INSTALL = {
    "matplotlib": "nuno[bench]",
    "mujoco": "nuno[peers]",
    "newton": "nuno[peers]",
    "rtree": "nuno[peers]",
    "igl": "nuno[peers]",
    "open3d": "open3d",
}
"""What pip takes for each; Open3D is no extra of ours, since it holds other packages back."""


def missing(packages: Iterable[str]) -> list[str]:
    """Those of them that are not installed."""
    return [package for package in packages if importlib.util.find_spec(package) is None]


def told(packages: Iterable[str]) -> str:
    """That they are not installed, and how each is."""
    return ", ".join(f"{package} is not installed ({_command(package)})" for package in packages)


def require(what: str, packages: Iterable[str], field: str | None = None) -> None:
    """Raises BadInput where `what`, in words, needs a package that is not installed."""
    if lacking := missing(packages):
        problem = f"{what} {' and '.join(lacking)}, which {'is' if len(lacking) == 1 else 'are'} not installed"
        raise BadInput(problem, field=field, remedy="; ".join(dict.fromkeys(map(_command, lacking))))


def _command(package: str) -> str:
    return f"pip install '{INSTALL.get(package, package)}'"
