"""Irregular meshes whose vertices stand row by row or at random, and simulations of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scenes import write_scene
from scipy.spatial import Delaunay

from nuno.scene import scene_file
from nuno.simulation.renumbering import invert
from nuno.simulation.run import Simulation
from nuno_schemas.fabric import Float, Int

SIDE = 46
"""Vertices along a side: more than nuno.simulation.renumbering.FEWEST in all."""
BALL = {"name": "ball", "friction": 0.5, "collider": {"plugin": "sphere", "radius": 0.1, "centre": [0.4, 0.5, -0.103]}}
DOWN = {"gravity": [0, 0, -9.81]}


def irregular(side: int) -> tuple[Float, Int]:
    """Vertices (n, 3) near those of a grid, row by row, and triangles of a square metre."""
    ticks = np.linspace(0.0, 1.0, side)
    x = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    inside = ((x > 0.0) & (x < 1.0)).all(axis=1)
    x[inside] += np.random.default_rng(1).uniform(-0.3, 0.3, (int(inside.sum()), 2)) / (side - 1)
    faces = Delaunay(x).simplices
    one, other = x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]]
    area = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    faces = np.where(area[:, None] < 0.0, faces[:, ::-1], faces)[np.abs(area) > 1e-9]
    return np.column_stack([x, np.zeros(len(x))]), faces.astype(np.int32)


def shuffled(x: Float, faces: Int) -> tuple[Float, Int, Int]:
    """The same with vertex old[i] as number i, and old (n,)."""
    old = np.random.default_rng(2).permutation(len(x)).astype(np.int32)
    return x[old], invert(old)[faces], old


def mesh(folder: Path, name: str, x: Float, faces: Int, **fields: Any) -> dict[str, Any]:
    """A model of a file with these vertices and triangles."""
    lines = [f"v {a!r} {b!r} {c!r}" for a, b, c in x.tolist()] + [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    (folder / name).write_text("\n".join(lines) + "\n")
    return {"plugin": "mesh", "file": name} | fields


def simulated(folder: Path, model: dict[str, Any], threads: int = 1, **fields: Any) -> Simulation:
    given = {"objects": [{"name": "cloth", "model": model}], "solver": {"plugin": "symplectic_euler", "dt": "0.1 ms"}}
    return Simulation.with_bodies(scene_file.read(write_scene(folder, **given | DOWN | fields)), threads)
