"""Requirements of cloth for drawing lines."""

from __future__ import annotations

import numpy as np

from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric

STRUCTURAL = 0
"""Kind of the springs along the cloth's threads (nuno_schemas.fabric.Springs)."""


def require_lines(loaded: Loaded, fabric: Fabric) -> None:
    """Raise BadInput for cloth on which lines are impossible: they need springs along edges of its triangles."""
    if not len(fabric.faces):
        remedy = "draw on a sheet, a skirt or a mesh; a net of yarns has no surface"
        raise loaded.at("objects[0].model", BadInput("cloth without triangles cannot be drawn on", remedy=remedy))
    springs = fabric.springs
    count = fabric.number
    structural = np.zeros((0, 2), np.int64)
    if springs is not None:
        structural = springs.pairs()[springs.of_kind(STRUCTURAL)].astype(np.int64)
    keys = np.sort(structural, axis=1) @ np.array([count, 1])
    edges = np.sort(np.stack([fabric.faces, np.roll(fabric.faces, -1, axis=1)], axis=2).astype(np.int64), axis=2)
    if not np.isin(edges @ np.array([count, 1]), keys).all(axis=1).any():
        remedy = "give a mesh or a shirt tension: springs, a sheet or skirt cells: triangles"
        problem = "lines cannot be drawn on this cloth: it has no springs along the edges of its triangles"
        raise loaded.at("objects[0].model", BadInput(problem, remedy=remedy))
