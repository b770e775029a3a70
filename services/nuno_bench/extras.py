"""Packages that a measurement uses beside those that come with nuno: whether they are there, and what installs them."""

from __future__ import annotations

import importlib.util

from nuno_schemas.errors import BadInput

INSTALL = {
    "matplotlib": "nuno[bench]",
    "mujoco": "nuno[peers]",
    "newton": "nuno[peers]",
    "ipctk": "nuno[peers]",
    "rtree": "nuno[peers]",
    "igl": "nuno[peers]",
    "open3d": "open3d",
}
"""What pip takes for each; Open3D is no extra of ours, since it holds other packages back."""


def missing(package: str) -> str:
    """That it is not installed, and how it is; empty where it is."""
    there = importlib.util.find_spec(package) is not None
    return "" if there else f"{package} is not installed (pip install '{INSTALL.get(package, package)}')"


def require(what: str, package: str, field: str | None = None) -> None:
    """Raises BadInput where `what`, in words, needs a package that is not installed."""
    if missing(package):
        remedy = f"pip install '{INSTALL.get(package, package)}'"
        raise BadInput(f"{what} {package}, which is not installed", field=field, remedy=remedy)
