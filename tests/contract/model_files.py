"""Files that the models' tests build from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from nuno_cloth.models.sheet import Sheet
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric


class Folder:
    """Files in one folder."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def resolve(self, name: str) -> Path:
        path = self.root / name
        if not path.is_file():
            raise BadInput("no such file", field="file", value=name)
        return path


@pytest.fixture
def files(tmp_path: Path) -> Folder:
    write_obj(tmp_path / "sheet.obj", build(Sheet(), {"resolution": (5, 6), "size": (0.4, 0.5)}, Folder(tmp_path)))
    np.savez(tmp_path / "net.npz", **net_arrays())  # type: ignore[arg-type]
    Image.new("RGB", (2, 2)).save(tmp_path / "image.png")
    return Folder(tmp_path)


def build(model: Any, config: dict[str, Any], files: Folder) -> Fabric:
    fabric: Fabric = model.build(model.Config.model_validate(config), files, 0)
    return fabric


def write_obj(path: Path, fabric: Fabric, order: slice = slice(None)) -> None:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in fabric.position.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (fabric.faces[:, order] + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")


def net_arrays() -> dict[str, np.ndarray[Any, Any]]:
    return {
        "x": np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]),
        "v": np.zeros((3, 3)),
        "m": np.array([1.0, 2.0, 3.0]),
        "pinned": np.array([True, False, False]),
        "springs": np.array([[0, 1], [1, 2]]),
        "k": np.array([10.0, 20.0]),
        "rest": np.array([1.0, 1.5]),
        "c": np.array([0.0, 0.1]),
    }
