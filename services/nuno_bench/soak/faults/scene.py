"""The scene that is disturbed: small, with every service that a run can have."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

FRAMES, RATE = 100, 50
"""Two seconds, which take about as long."""


def scene(duration: float = FRAMES / RATE, everything: bool = True) -> dict[str, Any]:
    """A dyed sheet on a ball; with `everything` also a few stitches, of which pictures are drawn.

    A checkpoint comes every second frame, so that a random moment often falls into one.
    """
    size = {"size": [0.3, 0.3], "resolution": [6, 6]}
    sheet = {"plugin": "sheet", **size, "pin": ["top-corners"], "fabric": "denim"}
    knit = {
        "plugin": "knit", "wales": 3, "courses": 3, "spacing": [0.04, 0.04], "centre": [1, 0, 0], "mass": "0.1 kg",
        "yarns": [{"name": "soft", "k": 10}], "pin": ["all-rim"],
    }  # fmt: skip
    data: dict[str, Any] = {
        "nuno": 1,
        "name": "faults",
        "duration": duration,
        "frame_rate": RATE,
        "solver": {"plugin": "symplectic_euler", "dt": "auto"},
        "objects": [{"name": "sheet", "model": sheet}],
        "bodies": [{"name": "ball", "collider": {"plugin": "sphere", "radius": 0.1, "centre": [0, -0.2, 0]}}],
        "record": {"checkpoint_every": 2 / RATE},
    }
    if everything:
        data["objects"].append({"name": "knit", "model": knit})
        view = {"size": [48, 64], "pictures": "0.5 s", "yarns": {"plugin": "yarns", "samples": 2, "radius": "3 mm"}}
        data |= {"view": view, "dye": _dye()}
    return data


def _dye() -> dict[str, Any]:
    bath = {"kind": "bath", "maintained": True, "liquor": 5.0, "region": {"shape": "rectangle", "low": [0, 0],
            "high": ["0.2 mm", 1]}}  # fmt: skip
    cloth = {
        "plugin": "woven", "cells": [12, 12], "cell_size": "0.05 mm", "tau3": {"I": 0.5, "II": 0.5, "III": 0.1},
        "weft": {"width": 1, "gap": 0, "porosity": 0.5}, "warp": {"width": 1, "gap": 0, "porosity": 0.5},
        "supply": [bath],
    }  # fmt: skip
    blue = {"name": "blue", "D0": "1.93 mm^2/h", "adsorption": 0.5, "isotherm": {"plugin": "langmuir", "K": 2.0}}
    return {"object": "sheet", "speed": "3600 s/s", "cloth": cloth, "dyes": [blue], "solver": "explicit"}


def write(folder: Path, **options: Any) -> Path:
    """The scene's file in a folder."""
    path = folder / "scene.yaml"
    path.write_text(json.dumps(scene(**options)))  # JSON is YAML
    return path
