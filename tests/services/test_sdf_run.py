"""A run with a body whose mesh is open: it says so by name, and inside is still inside."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scenes import write_scene

import nuno
from nuno.bus.encodings import decode_points
from nuno.recording.reader import open_recording
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.messages import PENETRATION, STATE

TOLERANCE = 2e-3


@pytest.mark.full
def test_an_open_body_is_told_of_by_name_and_measured_by_its_winding_number(tmp_path: Path) -> None:
    """A piece of cloth is put 1 cm into a ball with a hole below: its depth is that below the triangles."""
    ball = trimesh.creation.icosphere(3, 0.3)
    kept = ball.faces[ball.triangles_center[:, 1] > -0.25]
    holed = trimesh.Trimesh(ball.vertices, kept, process=False)
    holed.export(tmp_path / "open.ply")
    cloth = {"plugin": "sheet", "size": [0.04, 0.04], "resolution": [4, 4], "plane": "xz", "centre": [0, 0.29, 0]}
    scene = write_scene(
        tmp_path, duration=0.02, solver={"plugin": "symplectic_euler", "dt": "auto"},
        objects=[{"name": "cloth", "model": cloth}],
        bodies=[{"name": "ball", "collider": {"plugin": "sdf", "file": "open.ply", "tolerance": TOLERANCE}}],
    )  # fmt: skip
    recorded = tmp_path / "run.mcap"
    nuno.run(scene, record=recorded)
    with open_recording(recorded) as recording:
        (warning,) = [json.loads(m.payload)["text"] for m in recording.messages(["run/event/collision"])]
        x = decode_points(next(iter(recording.messages([STATE.name]))).payload)
        depth = json.loads(next(iter(recording.messages([PENETRATION.name]))).payload)["depth"]
    rim = len(trimesh.grouping.group_rows(holed.edges_sorted, require_count=1))
    assert warning.startswith(f"ball: the mesh has a hole: edges with one triangle ({rim}): edge ")
    assert warning.endswith("inside is where its winding number says")
    below = np.abs(closest_points(build_tree(ball.vertices, kept.astype(np.int32)), x).distance).max()
    assert depth == pytest.approx(below, abs=TOLERANCE) and depth > 2.0 * TOLERANCE
