"""A small scene that has every service but the dye's: a hanging sheet that meets a ball."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml


def write(folder: Path, duration: float, columns: int = 6, **fields: Any) -> Path:
    """A sheet of columns x columns vertices, 50 frames in a second of `duration` [s]."""
    model = {"plugin": "sheet", "resolution": [columns, columns], "fabric": "denim", "pin": ["top-corners"]}
    scene: dict[str, Any] = {
        "nuno": 1,
        "name": f"sheet-{columns}",
        "duration": duration,
        "frame_rate": 50,
        "damping": 0.5,
        "solver": {"plugin": "symplectic_euler", "dt": "auto"},
        "objects": [{"name": "sheet", "model": model}],
        "bodies": [{"name": "ball", "collider": {"plugin": "sphere", "centre": [0.0, -0.3, 0.05], "radius": 0.15}}],
        "record": {"checkpoint_every": 0.5},
    }
    path = folder / f"{scene['name']}.yaml"
    path.write_text(yaml.safe_dump(scene | fields))
    return path
