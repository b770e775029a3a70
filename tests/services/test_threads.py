"""The same bits on one thread and on as many as there are, however many are asked for."""

from __future__ import annotations

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
        "forces": [{"plugin": "wind", "velocity": [3, 0, 1]}],
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
