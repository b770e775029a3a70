"""Scenes whose bits are compared: one for each kind of work that a run does, and some changed as they go on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

Fields = dict[str, Any]

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


@dataclass(frozen=True)
class Case:
    """A scene, shipped or as fields, overrides, and what is done to it while it goes on, at frames."""

    scene: str | Fields
    overrides: tuple[str, ...] = ()
    changes: tuple[tuple[int, str, str], ...] = ()
    """Frame after which, set or add, and the item."""


def cloth(model: Fields, solver: Fields | str, **fields: Any) -> Fields:
    """A scene of one cloth, with a checkpoint each tenth of a second."""
    scene = {"nuno": 1, "name": "cloth", "duration": 0.6, "frame_rate": 50, "damping": 0.5, "solver": solver}
    return scene | {"objects": [{"name": "sheet", "model": model}], "record": {"checkpoint_every": 0.1}} | fields


def auto(plugin: str) -> Fields:
    """A solver with a step of its own choice."""
    return {"plugin": plugin, "dt": "auto"}


CASES: dict[str, Case] = {
    "net": Case(*NET),
    "net, changed": Case(*NET, ((5, "set", "gravity=[0, -1.6, 0]"), (11, "set", "damping=2"))),
    "sheet on a ball": Case(cloth(LYING, auto("symplectic_euler"), bodies=BALL)),
    "large sheet on a ball": Case(
        cloth(LYING | {"resolution": [120, 120]}, auto("symplectic_euler"), bodies=BALL, duration=0.24)
    ),
    "leapfrog, changed": Case(cloth(HUNG, auto("leapfrog")), (), ((7, "set", "gravity=[0, -1.6, 0]"),)),
    "wind, changed": Case(
        cloth(HUNG, auto("symplectic_euler")),
        (),
        ((6, "set", "forces=[{plugin: wind, velocity: [3, 0, 1]}]"), (14, "set", "forces.wind.velocity=[-2, 0, 4]")),
    ),
    "dopri5": Case(cloth(LYING, {"plugin": "dopri5"}, bodies=BALL)),
    "implicit_euler": Case(cloth(LYING, auto("implicit_euler"), bodies=BALL)),
    "tr_bdf2": Case(cloth(LYING, auto("tr_bdf2"), bodies=BALL)),
    "xpbd": Case(cloth(LYING, auto("xpbd"), bodies=BALL)),
    "solver auto": Case(cloth(HUNG, "auto", accuracy="preview")),
    "until rest": Case(cloth(HUNG, auto("symplectic_euler"), until="rest", duration=8.0, damping=20.0)),
    "wrinkle of the scene": Case(
        cloth(HUNG, auto("symplectic_euler"), operations=[{"plugin": "wrinkle", "at": 0.2, **WRINKLE}])
    ),
    "wrinkle, added": Case(
        cloth(HUNG, auto("symplectic_euler")),
        (),
        ((9, "add", "wrinkle: {lines: [{texture: [[0.2, 0.4], [0.8, 0.5]], height: 2 cm}]}"),),
    ),
    "dye": Case({"nuno": 1, "name": "dye", "duration": "1 h", "frame_rate": "20/h", "dye": DYE}),
    "dye, added": Case(
        {"nuno": 1, "name": "dye", "duration": "1 h", "frame_rate": "20/h", "dye": DYE},
        (),
        ((6, "add", "supply: {kind: drop, place: [0.5 mm, 1.5 mm], diameter: 0.6 mm}"),),
    ),
    "dyed garment": Case(
        cloth(LYING, auto("symplectic_euler"), bodies=BALL, dye=DYE | {"object": "sheet", "speed": "1 h/s"}),
        (),
        ((8, "add", "supply: {kind: drop, place: [0.5 mm, 1.5 mm], diameter: 0.6 mm}"),),
    ),
    "dyed garment, wrinkled": Case(
        cloth(HUNG, auto("symplectic_euler"), dye=DYE | {"object": "sheet", "speed": "1 h/s"}),
        (),
        ((8, "add", "wrinkle: {lines: [{texture: [[0.2, 0.4], [0.8, 0.5]], height: 2 cm}]}"),),
    ),
    "stocking": Case("knit/stocking-150", ("objects.0.model.wales=12", "objects.0.model.courses=16", *BRIEF)),
}
