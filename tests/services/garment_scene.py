"""A garment that is dyed while it moves, its scene, and that of its dye alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from dye_scene import CELL, arrays

SHEET = {
    "plugin": "sheet",
    "size": [0.3, 0.3],
    "resolution": [6, 6],
    "pin": ["top-corners"],
    "fabric": "denim",
}
BALL = {"name": "ball", "collider": {"plugin": "sphere", "radius": 0.1, "centre": [0, -0.2, 0]}}
BATH = {"kind": "bath", "maintained": True, "liquor": 5.0, "region": {"shape": "rectangle", "low": [0, 0],
        "high": [5 * CELL, 1]}}  # fmt: skip
DROP = {"kind": "drop", "place": [3 * CELL, 4 * CELL], "diameter": 4 * CELL, "start": "36 s"}
PASTE = {"kind": "paste", "points": [[0, 5 * CELL], [1, 5 * CELL]], "width": 3 * CELL}


def scene(**fields: Any) -> dict[str, Any]:
    """A sheet over a ball, an hour of dyeing in a second; `dye` replaces fields of the dye, None leaves it out."""
    cloth = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": {"I": 0.5, "II": 0.5, "III": 0.1}}
    blue = {"name": "blue", "D0": "1.93 mm^2/h", "adsorption": 0.5, "isotherm": {"plugin": "langmuir", "K": 2.0}}
    dye = {
        "object": "sheet",
        "speed": "3600 s/s",
        "cloth": cloth | {"supply": [BATH, DROP]},
        "dyes": [blue],
        "solver": "explicit",
    }
    changed = fields.pop("dye", {})
    return {
        "nuno": 1, "name": "garment", "duration": 0.2, "frame_rate": 50,
        "solver": {"plugin": "symplectic_euler", "dt": "auto"},
        "objects": [{"name": "other", "model": SHEET | {"centre": [1, 0, 0]}}, {"name": "sheet", "model": SHEET}],
        "bodies": [BALL], "record": {"checkpoint_every": 0.08}, "dye": None if changed is None else dye | changed,
    } | fields  # fmt: skip


def write(folder: Path, **fields: Any) -> Path:
    np.savez(folder / "cells.npz", allow_pickle=False, **arrays())
    path = folder / "scene.yaml"
    data = {name: value for name, value in scene(**fields).items() if value is not None}
    path.write_text(yaml.safe_dump(data))
    return path


def alone(folder: Path, **fields: Any) -> Path:
    """The same dye by itself."""
    data = scene(**fields)
    del data["dye"]["object"]
    for name in ("objects", "bodies", "solver"):
        del data[name]
    path = write(folder)
    path.write_text(yaml.safe_dump(data))
    return path
