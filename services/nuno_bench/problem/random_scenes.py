"""Scenes that nobody tuned a step for: sheets of random cloth, held and let go at random, by a seed."""

from __future__ import annotations

from typing import Any

import numpy as np

FABRICS = ("denim", "interlock", "rib-knit", "polyester", "jacket", "trousers")
PINS: tuple[list[str], ...] = (["top-corners"], ["top-row"], ["top-left"], ["left-column"], [])


def random_fabric(rng: np.random.Generator) -> Any:
    """The name of a preset, or springs of stiffness 10 to 10,000 N/m."""
    if rng.random() < 0.5:
        return str(rng.choice(FABRICS))
    structural = float(f"{10 ** rng.uniform(1.0, 4.0):.3g}")
    shear, bending = (float(f"{structural * rng.uniform(low, high):.3g}") for low, high in ((0.05, 0.5), (0, 0.05)))
    fabric = {"density": round(float(rng.uniform(0.1, 0.4)), 3), "structural": structural, "shear": shear}
    return fabric | {"bending": bending, "damping_ratio": round(float(rng.uniform(0, 0.1)), 3)}


def random_scene(seed: int) -> dict[str, Any]:
    """A scene's data: a preset or springs of stiffness 10 to 10,000 N/m, with or without wind, ball and damping."""
    rng = np.random.default_rng(seed)
    side = int(rng.integers(12, 33))
    width = round(float(rng.uniform(0.3, 1.5)), 3)
    fabric = random_fabric(rng)
    pins = PINS[int(rng.integers(len(PINS)))]
    angle = round(float(rng.uniform(-90, 90)), 1)
    model = {"plugin": "sheet", "size": [width, width], "resolution": [side, side], "fabric": fabric, "pin": pins}
    model |= {"centre": [0.02, 1.0, 0.01], "rotate": {"axis": [1, 0, 0], "angle": f"{angle} deg"}}
    scene: dict[str, Any] = {"nuno": 1, "name": f"random-{seed}", "duration": 0.5, "frame_rate": 60}
    scene |= {"damping": round(float(rng.uniform(0, 1)), 2), "objects": [{"name": "cloth", "model": model}]}
    if rng.random() < 0.5 or not pins:
        reach = round(0.3 * width, 3)
        ball = {"plugin": "sphere", "centre": [0.0, round(0.9 - width / 2 - reach, 3), 0.0], "radius": reach}
        scene["bodies"] = [{"name": "ball", "collider": ball}]
    if rng.random() < 0.5:
        scene["forces"] = [{"plugin": "wind"}]
    return scene
