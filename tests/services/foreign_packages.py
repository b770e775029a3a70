"""Distributions of others, in folders of their own, found as installed ones are."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

HEAD = """\
import numpy as np
from nuno_schemas.plugin import Config, Mover
from nuno_schemas.system import Term
"""


class Packages:
    """Distributions in folders of their own, found as installed ones are."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.monkeypatch = folder, monkeypatch

    def add(self, name: str, code: str, *points: str, group: str = "nuno.forces") -> None:
        """A distribution whose only module is of its own name; `points` are lines `name = module:class`."""
        place = self.folder / name
        about = place / f"{name}-1.2.dist-info"
        about.mkdir(parents=True)
        (place / f"{name}.py").write_text(HEAD + code)
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
        (about / "entry_points.txt").write_text("\n".join([f"[{group}]", *points]) + "\n")
        self.monkeypatch.syspath_prepend(str(place))
        self.monkeypatch.delitem(sys.modules, name, raising=False)


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Packages:
    return Packages(tmp_path / "packages", monkeypatch)
