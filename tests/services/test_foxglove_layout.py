"""The layout for Foxglove and Lichtblick: it shows what is in the file, and its camera has the scene in view."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_file import known_at, placed, read, vectors
from recorded_sheet import Sheet, write

from nuno.exports.foxglove import export_foxglove

pytest.importorskip("mcap_protobuf", reason="needs mcap-protobuf-support, of nuno[dev]")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foxglove") / "run.mcap"
    write(path, Sheet(), 5)
    return path


def test_the_layout_shows_what_is_in_the_file(path: Path, tmp_path: Path) -> None:
    out, beside = export_foxglove(path, tmp_path / "out.mcap")
    heard, layout = read(out), json.loads(beside.read_text())
    panels = layout["configById"]

    def leaves(part: Any) -> list[str]:
        return [part] if isinstance(part, str) else leaves(part["first"]) + leaves(part["second"])

    assert sorted(leaves(layout["layout"])) == sorted(panels)
    assert sorted(panels) == ["3D!scene", "Plot!depth", "Plot!energy", "RosOut!log"]
    scene = panels["3D!scene"]
    assert set(scene["topics"]) == {"scene/cloth", "scene/bodies"} <= set(heard)
    assert panels["RosOut!log"]["topicToRender"] in heard
    frames = {t.child_frame_id for topic in ("scene/fixed", "scene/frames") for t in heard[topic][0].value.transforms}
    assert {name.removeprefix("frame:") for name in scene["transforms"]} == frames | {scene["followTf"]}
    curves = {curve["label"]: curve["value"] for name in panels if name[0] == "P" for curve in panels[name]["paths"]}
    assert set(curves) == {"kinetic", "springs", "total", "deepest", "mean of those inside"}
    for value in curves.values():
        topic, field = value.split(".")
        assert all(isinstance(getattr(numbers, field), float) for _, numbers in heard[topic])


def test_the_layouts_camera_has_the_scene_in_view(path: Path, tmp_path: Path) -> None:
    """By the panel's own rule: the eye is at the target and d (sin phi sin theta, -sin phi cos theta, cos phi)."""
    out, beside = export_foxglove(path, tmp_path / "out.mcap")
    heard, panel = read(out), json.loads(beside.read_text())["configById"]["3D!scene"]
    camera = panel["cameraState"]
    phi, theta, half = np.radians(camera["phi"]), -np.radians(camera["thetaOffset"]), np.radians(camera["fovy"]) / 2
    back = np.array([np.sin(phi) * np.sin(theta), -np.sin(phi) * np.cos(theta), np.cos(phi)])
    right = np.array([np.cos(theta), np.sin(theta), 0.0])
    seen = []
    for at, update in heard["scene/cloth"]:
        shapes = [*update.entities, *heard["scene/bodies"][0].value.entities]
        points = [placed(known_at(heard, at), vectors(one.triangles[0].points), one.frame_id, "map") for one in shapes]
        away = np.concatenate(points) - camera["targetOffset"]
        depth = camera["distance"] - away @ back
        assert camera["near"] < depth.min() and depth.max() < camera["far"]
        seen.append(np.stack([away @ right, away @ np.cross(back, right)], axis=1) / (depth * np.tan(half))[:, None])
    most = np.abs(np.concatenate(seen)).max()
    assert 0.8 < most < 0.85  # 8 % are free on each side
    first = heard["scene/bodies"][0].value.entities[0]
    low = placed(known_at(heard, 0), vectors(first.triangles[0].points), first.frame_id, "map")[:, 2].min()
    assert panel["layers"]["grid"]["position"] == [0.0, 0.0, pytest.approx(min(low, 0.0), abs=1e-6)]
