"""A net on a vertical line, whose motion is known exactly, for tests of the bench."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nuno.scene import scene_file
from nuno_bench.problem import Problem, make_problem
from nuno_bench.reference import Reference, make_reference


def write_net(folder: Path, **fields: Any) -> Path:
    """Two masses of 10 g under a held one, on a vertical line: springs of 10 and 5 N/m, slightly damped, 0.4 s."""
    np.savez(
        folder / "line.npz",
        x=np.array([[0.0, 0.0, 0.0], [0.0, -0.1, 0.0], [0.0, -0.25, 0.0]]),
        v=np.array([[0.0, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, -0.1, 0.0]]),
        m=np.full(3, 0.01),
        pinned=np.array([True, False, False]),
        springs=np.array([[0, 1], [2, 1]]),
        k=np.array([10.0, 5.0]),
        rest=np.array([0.1, 0.15]),
        c=np.array([0.0, 0.003]),
    )
    scene: dict[str, Any] = {
        "nuno": 1,
        "name": "line",
        "duration": 0.4,
        "frame_rate": 50,
        "solver": {"plugin": "rk4"},
        "damping": 0.1,
        "objects": [{"name": "line", "model": {"plugin": "net", "file": "line.npz"}}],
    }
    path = folder / "line.yaml"
    path.write_text(yaml.safe_dump(scene | fields))
    return path


def problem_of(path: Path, *overrides: str) -> Problem:
    return make_problem(scene_file.read(path, ["allow_unstable=true", *overrides]))


def reference_of(problem: Problem) -> Reference:
    return make_reference(problem, 30.0, lambda text: None)
