"""A person and its walk as files, and its bent skin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from nuno_schemas.fabric import Float
from nuno_schemas.plugin import BodyShape

WALK = Path(__file__).resolve().parents[2] / "scenes" / "walk.bvh"


class Folder:
    """Files in one folder, or by their whole name."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def resolve(self, name: str) -> Path:
        return self.root / name

    def read(self, name: str, kind: Any) -> Any:
        raise NotImplementedError


def bent(shape: BodyShape, t: float) -> Float:
    """(v, 3) where its vertices are [m]."""
    assert shape.pose is not None
    return shape.skins[0].bend(shape.vertices, *shape.pose(t))
