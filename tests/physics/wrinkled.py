"""Cloth of triangles, and lines drawn on it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nuno.plugin_contract import registry
from nuno.scene.files import SceneFiles
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.operation import Outcome

BY_HAND = {"density": 0.2, "structural": 50.0, "bending": 5.0, "hinge": 1e-5, "damping_ratio": 0.01}


def sheet(columns: int = 12, rows: int = 12, fabric: Any = BY_HAND, **fields: Any) -> Fabric:
    """A flat square of triangles in the plane z = 0, its outside to +z."""
    model = registry.load("nuno.models", "sheet")
    settings = {"resolution": [columns, rows], "cells": "triangles", "fabric": fabric} | fields
    built: Fabric = model.build(model.Config.model_validate(settings), SceneFiles(Path(".")), 0)
    return built


def draw(fabric: Fabric, *lines: dict[str, Any], x: Float | None = None, **settings: Any) -> Outcome:
    """Apply the operation where the fabric starts, or at x (n, 3) [m]."""
    wrinkle = registry.load("nuno.operations", "wrinkle")
    config = wrinkle.Config.model_validate({"lines": list(lines)} | settings)
    at = fabric.position if x is None else x
    made: Outcome = wrinkle.apply(config, fabric, State(at.copy(), np.zeros_like(at), 0.0), None)
    return made


def ridge(*points: tuple[float, float], height: float = 0.02, **fields: Any) -> dict[str, Any]:
    """A line in the plane z = 0."""
    return {"points": [[x, y, 0.0] for x, y in points], "height": height} | fields
