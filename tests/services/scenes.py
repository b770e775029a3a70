"""Small scenes for tests of services."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

CHAIN: dict[str, Any] = {
    "nuno": 1,
    "name": "chain",
    "duration": 0.1,
    "frame_rate": 50,
    "solver": {"plugin": "symplectic_euler", "dt": "1 ms"},
    "objects": [{"name": "chain", "model": {"plugin": "net", "file": "chain.npz"}}],
}
"""The scene of the net that `write_chain` writes."""


def write_chain(folder: Path, vertices: int = 6) -> None:
    """chain.npz: masses on a line, the first one pinned."""
    x = np.zeros((vertices, 3))
    x[:, 0] = 0.1 * np.arange(vertices)
    pairs = np.stack([np.arange(vertices - 1), np.arange(1, vertices)], 1)
    links = len(pairs)
    np.savez(
        folder / "chain.npz",
        x=x,
        v=np.zeros_like(x),
        m=np.full(vertices, 0.01),
        pinned=np.arange(vertices) == 0,
        springs=pairs,
        k=np.full(links, 100.0),
        rest=np.full(links, 0.1),
        c=np.zeros(links),
    )


def write_scene(folder: Path, **fields: Any) -> Path:
    """A chain that swings for half a second, with any field replaced."""
    write_chain(folder)
    scene: dict[str, Any] = {
        "nuno": 1,
        "name": "chain",
        "duration": 0.5,
        "frame_rate": 50,
        "solver": {"plugin": "symplectic_euler", "dt": "1 ms"},
        "objects": [{"name": "chain", "model": {"plugin": "net", "file": "chain.npz"}}],
        "record": {"checkpoint_every": 0.1},
    }
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(scene | fields))
    return path


BALL = [{"name": "ball", "collider": {"plugin": "sphere", "centre": [0.3, -0.2, 0.0], "radius": 0.1}}]
