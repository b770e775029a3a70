"""Distributions of others, in folders of their own, found as installed ones are."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

import pytest

HEAD = """\
import numpy as np
from nuno_schemas.plugin import Config, Mover
from nuno_schemas.system import Term
"""
PAGE = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "plugins.md").read_text()


def blocks(language: str) -> list[str]:
    """The blocks of code in a language that the page on plugins shows."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.M | re.S)


POINTS = {
    value.split(":")[0]: (group, f"{name} = {value}", value.split(":")[1])
    for group, points in tomllib.loads("".join(blocks("toml")))["project"]["entry-points"].items()
    for name, value in points.items()
}
"""Group, entry point and class of each module that the page shows."""


def shown(module: str) -> str:
    """The source of a module, as the page shows it."""
    (source,) = (code for code in blocks("python") if f"class {POINTS[module][2]}(" in code or
                 f"class {POINTS[module][2]}:" in code)  # fmt: skip
    return source


class Packages:
    """Distributions in folders of their own, found as installed ones are."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.monkeypatch = folder, monkeypatch

    def add_shown(self, module: str, more: str = "", *points: str) -> None:
        """The distribution that the page shows, with `more` at the end of its module."""
        group, point, _ = POINTS[module]
        self.add(module, shown(module) + more, point, *points, group=group, head="")

    def add(self, name: str, code: str, *points: str, group: str = "nuno.forces", head: str = HEAD) -> None:
        """A distribution whose only module is of its own name; `points` are lines `name = module:class`."""
        place = self.folder / name
        about = place / f"{name}-1.2.dist-info"
        about.mkdir(parents=True)
        (place / f"{name}.py").write_text(head + code)
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
        (about / "entry_points.txt").write_text("\n".join([f"[{group}]", *points]) + "\n")
        self.monkeypatch.syspath_prepend(str(place))
        self.monkeypatch.delitem(sys.modules, name, raising=False)


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Packages:
    return Packages(tmp_path / "packages", monkeypatch)
