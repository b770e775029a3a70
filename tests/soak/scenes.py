"""Scenes that are run at length: small ones with every service, and one for each kind of work that a run does."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Fields = dict[str, Any]
RATE = 50
"""Frames a second."""
SOLVER = {"plugin": "symplectic_euler", "dt": "auto"}


def write(folder: Path, fields: Fields) -> Path:
    """A scene's file in a folder, by its name; JSON is YAML."""
    path = folder / f"{fields['name']}.yaml"
    path.write_text(json.dumps({"nuno": 1, "frame_rate": RATE, "solver": SOLVER} | fields))
    return path


def sheet(folder: Path, duration: float, columns: int = 6, **fields: Any) -> Path:
    """A sheet of columns x columns vertices that hangs and meets a ball: all services but the dye's; duration [s]."""
    model = {"plugin": "sheet", "resolution": [columns, columns], "fabric": "denim", "pin": ["top-corners"]}
    scene: Fields = {
        "name": f"sheet-{columns}", "duration": duration, "damping": 0.5,
        "objects": [{"name": "sheet", "model": model}],
        "bodies": [{"name": "ball", "collider": {"plugin": "sphere", "centre": [0.0, -0.3, 0.05], "radius": 0.15}}],
        "record": {"checkpoint_every": 0.5},
    }  # fmt: skip
    return write(folder, scene | fields)


def everything(folder: Path, duration: float) -> Path:
    """A dyed sheet on a ball and a few stitches, of which pictures are drawn: every service that a run can have.

    A checkpoint comes every second frame, so that a random moment often falls into one.
    """
    knit = {"plugin": "knit", "wales": 3, "courses": 3, "spacing": [0.04, 0.04], "centre": [1, 0, 0], "mass": "0.1 kg",
            "yarns": [{"name": "soft", "k": 10}], "pin": ["all-rim"]}  # fmt: skip
    small = {"plugin": "sheet", "size": [0.3, 0.3], "resolution": [6, 6], "pin": ["top-corners"], "fabric": "denim"}
    bath = {"kind": "bath", "maintained": True, "liquor": 5.0,
            "region": {"shape": "rectangle", "low": [0, 0], "high": ["0.2 mm", 1]}}  # fmt: skip
    cloth = {"plugin": "woven", "cells": [12, 12], "cell_size": "0.05 mm", **WOVEN,
             "tau3": {"I": 0.5, "II": 0.5, "III": 0.1}, "supply": [bath]}  # fmt: skip
    blue = {"name": "blue", "D0": "1.93 mm^2/h", "adsorption": 0.5, "isotherm": {"plugin": "langmuir", "K": 2.0}}
    return sheet(
        folder, duration, name="everything", damping=0,
        objects=[{"name": "sheet", "model": small}, {"name": "knit", "model": knit}],
        bodies=[{"name": "ball", "collider": {"plugin": "sphere", "radius": 0.1, "centre": [0, -0.2, 0]}}],
        record={"checkpoint_every": 2 / RATE},
        dye={"object": "sheet", "speed": "3600 s/s", "cloth": cloth, "dyes": [blue], "solver": "explicit"},
        view={"size": [48, 64], "pictures": "0.5 s", "yarns": {"plugin": "yarns", "samples": 2, "radius": "3 mm"}},
    )  # fmt: skip


BRIEF = ("until=rest", "damping=5", "duration=1")
NET = ("net", ("duration=0.4", "record.checkpoint_every=0.1"))
FABRIC = {"density": 0.12, "structural": 60, "bending": 2, "hinge": 2e-5, "damping_ratio": 0.05}
SHEET = {"plugin": "sheet", "size": [0.4, 0.4], "resolution": [12, 12], "cells": "triangles", "fabric": FABRIC}
HUNG = SHEET | {"pin": ["top-corners"]}
LYING = SHEET | {"plane": "xz", "centre": [0.02, 0, 0.01]}
BALL = [{"name": "ball", "collider": {"plugin": "sphere", "centre": [0, -0.12, 0], "radius": 0.1}, "friction": 0.4}]
WRINKLE = {"lines": [{"texture": [[0.2, 0.4], [0.8, 0.5]], "height": 0.02}]}
WOVEN = {"weft": {"width": 1, "gap": 0, "porosity": 0.5}, "warp": {"width": 1, "gap": 0, "porosity": 0.5}}
TAU3 = {"I": 0.02, "II": 0.005, "III": 0, "V": 0.02}
DROP = {"kind": "drop", "place": ["1 mm", "1 mm"], "diameter": "1 mm"}
DYE = {
    "cloth": {"plugin": "woven", "cells": [24, 24], "cell_size": "0.1 mm", **WOVEN, "tau3": TAU3, "supply": [DROP]},
    "dyes": [{"name": "indigo", "D0": "1.93 mm^2/h", "adsorption": 0.01, "isotherm": {"plugin": "langmuir", "K": 5}}],
}
DYED = {"nuno": 1, "name": "dye", "duration": "1 h", "frame_rate": "20/h", "dye": DYE}
WORN = {"dye": DYE | {"object": "sheet", "speed": "1 h/s"}}
MOON = "gravity=[0, -1.6, 0]"
ADDED_DROP = "supply: {kind: drop, place: [0.5 mm, 1.5 mm], diameter: 0.6 mm}"
ADDED_LINE = "wrinkle: {lines: [{texture: [[0.2, 0.4], [0.8, 0.5]], height: 2 cm}]}"
GUST = "forces=[{plugin: wind, velocity: [3, 0, 1]}]"

Changes = tuple[tuple[int, str, str], ...]


@dataclass(frozen=True)
class Case:
    """A scene, shipped or as fields, overrides, and what is done to it while it goes on.

    changes  frame after which, `set` or `add`, and the item
    """

    scene: str | Fields
    overrides: tuple[str, ...] = ()
    changes: Changes = ()


def cloth(model: Fields, plugin: str, *changes: tuple[int, str, str], **fields: Any) -> Case:
    """One cloth, stepped by a solver with a step of its own choice, with a checkpoint each tenth of a second."""
    solver: Any = plugin if plugin == "auto" else {"plugin": plugin, **({} if plugin == "dopri5" else {"dt": "auto"})}
    scene = {"nuno": 1, "name": "cloth", "duration": 0.6, "frame_rate": RATE, "damping": 0.5, "solver": solver}
    scene |= {"objects": [{"name": "sheet", "model": model}], "record": {"checkpoint_every": 0.1}}
    return Case(scene | fields, (), changes)


EULER = "symplectic_euler"
CASES: dict[str, Case] = {
    "net": Case(*NET),
    "net, changed": Case(*NET, ((5, "set", MOON), (11, "set", "damping=2"))),
    "sheet on a ball": cloth(LYING, EULER, bodies=BALL),
    "large sheet on a ball": cloth(LYING | {"resolution": [120, 120]}, EULER, bodies=BALL, duration=0.24),
    "leapfrog, changed": cloth(HUNG, "leapfrog", (7, "set", MOON)),
    "wind, changed": cloth(HUNG, EULER, (6, "set", GUST), (14, "set", "forces.wind.velocity=[-2, 0, 4]")),
    **{plugin: cloth(LYING, plugin, bodies=BALL) for plugin in ("dopri5", "implicit_euler", "tr_bdf2", "xpbd")},
    "solver auto": cloth(HUNG, "auto", accuracy="preview"),
    "until rest": cloth(HUNG, EULER, until="rest", duration=8.0, damping=20.0),
    "wrinkle of the scene": cloth(HUNG, EULER, operations=[{"plugin": "wrinkle", "at": 0.2, **WRINKLE}]),
    "wrinkle, added": cloth(HUNG, EULER, (9, "add", ADDED_LINE)),
    "dye": Case(DYED),
    "dye, added": Case(DYED, (), ((6, "add", ADDED_DROP),)),
    "dyed garment": cloth(LYING, EULER, (8, "add", ADDED_DROP), bodies=BALL, **WORN),
    "dyed garment, wrinkled": cloth(HUNG, EULER, (8, "add", ADDED_LINE), **WORN),
    "stocking": Case("knit/stocking-150", ("objects.0.model.wales=12", "objects.0.model.courses=16", *BRIEF)),
}
