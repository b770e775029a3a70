"""Files of a dyed cloth that cannot be used: named with the very field that names them, and its line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from PIL import Image

from nuno.dye.run import DyeRun
from nuno.scene import scene_file
from nuno_schemas.errors import BadInput

STENCIL = {"kind": "image", "file": "stencil.png"}
CLOTH = {"plugin": "woven", "cells": [12, 8], "tau3": {"I": 1, "II": 1, "III": 1}}


def grey(path: Path, *size: int) -> None:
    Image.new("L", size).save(path)


def red(path: Path, *size: int) -> None:
    Image.new("RGB", size, (200, 0, 0)).save(path)


def write(folder: Path, **cloth: Any) -> Path:
    """A scene, a field a line."""
    dye = {"cloth": CLOTH | cloth, "dyes": [{"name": "blue", "D0": 1e-9}]}
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump({"nuno": 1, "name": "dyed", "duration": 10, "frame_rate": 1, "dye": dye}))
    return path


Fault = tuple[dict[str, Any], str, Callable[[Path], object], str, str]
FAULTS: dict[str, Fault] = {
    "no WIF": (
        {"weave": {"plugin": "wif", "file": "mine.wif"}}, "mine.wif",
        lambda path: path.write_text("[WARP]\nThreads=2\n"), "dye.cloth.weave.file", "no section [WIF]",
    ),
    "stencil of another size": (
        {"resist": [{"kind": "paste", "points": [[0, 0]], "width": 1e-4}, STENCIL]}, "stencil.png",
        lambda path: grey(path, 12, 9), "dye.cloth.resist[1].file", "the image has not the cloth's size",
    ),
    "coloured stencil": (
        {"resist": [STENCIL]}, "stencil.png", lambda path: red(path, 12, 8), "dye.cloth.resist[0].file",
        "the image is in colour",
    ),
    "stencil that is none": (
        {"resist": [STENCIL]}, "stencil.png", lambda path: path.write_text("x"), "dye.cloth.resist[0].file",
        "cannot be read as PNG",
    ),
    "arrays that are none": (
        {"plugin": "cells", "file": "mine.npz", "cell_size": 1e-4, "cells": None}, "mine.npz",
        lambda path: path.write_text("x"), "dye.cloth.file", "not a readable .npz file",
    ),
    "photograph that is none": (
        {"plugin": "photograph", "file": "cloth.png", "colours": {"warp": "#ff0000", "weft": "#0000ff"},
         "tau3": {"I": 1, "II": 1}, "cells": None}, "cloth.png",
        lambda path: path.write_text("x"), "dye.cloth.file", "cannot be read as PNG or JPEG",
    ),
}  # fmt: skip


@pytest.mark.parametrize("overridden", [False, True])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_file_s_fault_names_the_field_that_names_it(fault: str, overridden: bool, tmp_path: Path) -> None:
    cloth, name, make, field, words = FAULTS[fault]
    make(tmp_path / name)
    scene = write(tmp_path, **{key: value for key, value in cloth.items() if value is not None})
    text = scene.read_text()
    if cloth.get("cells", 0) is None:
        text = text.replace("    cells:\n    - 12\n    - 8\n", "")
    overrides = []
    if overridden:
        text = text.replace(name, "another")
        overrides = [f"{field}={name}"]
    scene.write_text(text)
    with pytest.raises(BadInput) as refused:
        DyeRun(scene_file.read(scene, overrides), 1)
    line = next((n for n, line in enumerate(text.splitlines(), 1) if name in line), None)
    place = "--set" if overridden else f"{scene}:{line}"
    said = str(refused.value)
    assert said.startswith(f"{tmp_path / name}:") and words in said
    assert f"(the file is named in {place}: {field})" in said
