"""The same bits whichever processor's kernels of BLAS numpy takes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

CORES = ("Haswell", "Prescott")
"""One fuses products with sums and the other does not."""

PROGRAM = """
import hashlib, sys
import numpy as np
import nuno
from nuno_contact.figures.leg import leg_mesh
from nuno_contact.figures.person import torso_mesh

random = np.random.default_rng(0).random((2, 100, 3, 3))
print(hashlib.sha256(np.array([a @ b for a, b in zip(*random)]).tobytes()).hexdigest())
for make in (leg_mesh, torso_mesh):
    print(hashlib.sha256(make(24)[0].tobytes()).hexdigest())
print(nuno.run(sys.argv[1], record=sys.argv[2]).digest)
"""


@pytest.mark.full
def test_a_dancer_and_what_she_wears_move_in_the_same_bits(tmp_path: Path) -> None:
    """A skirt that is turned and attached, on a skeleton that is turned joint by joint, beside a box that tumbles."""
    model = {
        "plugin": "skirt", "columns": 24, "rows": 6, "centre": [0, 0.94, 0], "fabric": "jacket",
        "rotate": {"axis": [1, 2, 3], "angle": 0.05}, "attach": {"body": "dancer", "frame": "hips"},
    }  # fmt: skip
    dancer = {"name": "dancer", "collider": {"plugin": "skeleton"}, "motion": {"plugin": "hula", "ramp": 0}}
    tumbles = {"plugin": "keyframes", "times": [0, 1], "rotations": [[0, 0, 0], [1, 2, 3]]}
    box = {"name": "box", "collider": {"plugin": "box", "size": [0.1, 0.1, 0.1], "centre": [0.3, 0.7, 0]}}
    scene = {
        "nuno": 1, "name": "processors", "duration": 0.05, "frame_rate": 100, "solver": "symplectic_euler",
        "objects": [{"name": "skirt", "model": model}], "bodies": [dancer, box | {"motion": tumbles}],
    }  # fmt: skip
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    found = []
    for core in CORES:
        made = subprocess.run(
            [sys.executable, "-c", PROGRAM, str(path), str(tmp_path / f"{core}.mcap")],
            env=os.environ | {"OPENBLAS_CORETYPE": core}, check=True, capture_output=True, text=True,
        )  # fmt: skip
        found.append(made.stdout.split()[-4:])
    if found[0][0] == found[1][0]:
        pytest.skip("numpy's BLAS here has one kernel for all processors")
    assert found[0][1:] == found[1][1:]
