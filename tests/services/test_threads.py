"""The same bits on any number of threads and whichever processor's kernels numpy takes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest
import yaml

import nuno
from nuno_integrators.packing import PARALLEL_FROM

SIDES = [129, 130]
"""Enough vertices to run on several threads, in numbers that no block divides."""


@pytest.mark.full
@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one core")
def test_more_threads_than_cores_give_the_same_bits(tmp_path: Path) -> None:
    """A sheet of springs and hinges that falls askew onto a ball in the wind: all that is parallel."""
    model = {
        "plugin": "sheet", "resolution": SIDES, "size": [0.5, 0.5], "plane": "xz", "centre": [0, 0.105, 0],
        "rotate": {"axis": [1, 0, 1], "angle": 0.1}, "velocity": [0, -1, 0], "fabric": "jacket",
    }  # fmt: skip
    scene = {
        "nuno": 1, "name": "threads", "duration": 0.02, "frame_rate": 100, "damping": 0.5,
        "solver": {"plugin": "symplectic_euler"}, "objects": [{"name": "cloth", "model": model}],
        "bodies": [{"name": "ball", "collider": {"plugin": "sphere", "radius": 0.1}}],
        "forces": [{"plugin": "wind", "velocity": [3, 0, 1]}], "contact": {"plugin": "penalty", "margin": 0},
    }  # fmt: skip
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    many, one = (nuno.run(path, threads=threads, record=tmp_path / f"{threads}.mcap") for threads in (10**6, 1))
    assert SIDES[0] * SIDES[1] >= PARALLEL_FROM
    assert many.report["threads"].startswith(f"{numba.config.NUMBA_NUM_THREADS} threads of ")
    assert one.report["threads"].startswith("1 thread of ")
    assert many.report["penetration"] > 0
    assert many.digest == one.digest
    with nuno.open(tmp_path / "1000000.mcap") as ours, nuno.open(tmp_path / "1.mcap") as reference:
        assert [f.digest for f in ours.frames()] == [f.digest for f in reference.frames()]


CORES = ("Haswell", "Prescott")
"""One fuses products with sums and the other does not."""

PROGRAM = """
import hashlib, sys
import numpy as np
import nuno
from nuno_contact.body_shapes.leg import leg_mesh
from nuno_contact.body_shapes.person import torso_mesh

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
