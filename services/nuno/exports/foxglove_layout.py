"""The layout that shows an exported recording in Foxglove and Lichtblick."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from nuno.exports.camera import place_camera, read_view, z_up
from nuno.exports.shapes import ROOT
from nuno.recording.reader import Recording
from nuno_schemas.drawing import Camera, Mesh
from nuno_schemas.fabric import Float
from nuno_schemas.messages import PENETRATION, STATUS


class Topics(NamedTuple):
    """What the 3-D panel shows, and the transforms it places that by."""

    cloth: str = "scene/cloth"
    bodies: str = "scene/bodies"
    skins: str = "scene/skins"
    frames: str = "scene/frames"
    fixed: str = "scene/fixed"


SCENE, EVENTS = Topics(), "log"
PANEL = (720, 720)
"""The shape that the camera is fitted to: the scene is whole in any panel that is not higher than wide."""
BACKGROUND, GRID = "#e2e6ea", "#b3bac2"
CURVES = ("#e69f00", "#56b4e9", "#009e73", "#cc79a7", "#d55e00", "#0072b2", "#808080")
"""Told apart with the common colour-vision deficiencies (Okabe and Ito, 2008), and a grey."""


def arrange(
    recording: Recording, points: Sequence[Float], floor: float | None, frames: Sequence[str],
    topics: Collection[str], kinds: Mapping[str, Any],
) -> dict[str, Any]:  # fmt: skip
    """The layout, as both import it: the scene on the left, on the right curves of energy and penetration, and the log.

    points  (n, 3) each [m]: what should be in view, by the scene's view
    floor   where the grid is [m], the lowest point for None
    frames  names of all frames, whose axes are not shown
    topics  those that the file has; what it has not is left out
    kinds   the JSON Schemas of some
    """
    cloud = z_up(np.concatenate(points))
    camera = place_camera(read_view(recording), [Mesh(cloud, np.zeros((0, 3), np.int32))], PANEL)
    height = float(cloud[:, 2].min()) if floor is None else floor
    shown = [topic for topic in (SCENE.cloth, SCENE.bodies, SCENE.skins) if topic in topics]
    panels: dict[str, Any] = {"3D!scene": _scene(camera, height, frames, shown)}
    if STATUS.name in topics:
        energy = kinds[STATUS.name]["properties"].get("energy", {}).get("properties", {})
        panels["Plot!energy"] = _plot("Energy [J]", {name: f"{STATUS.name}.energy.{name}" for name in energy})
    if PENETRATION.name in topics:
        depths = {"deepest": "depth", "mean of those inside": "mean"}
        told = {label: f"{PENETRATION.name}.{field}" for label, field in depths.items()}
        panels["Plot!depth"] = _plot("Penetration [m]", told)
    if EVENTS in topics:
        panels["RosOut!log"] = {"topicToRender": EVENTS, "minLogLevel": 1, "searchTerms": []}
    main, *beside = panels
    # One that was changed in a viewer and saved from there begins otherwise: `target.MAGIC`.
    return {
        "globalVariables": {"nuno": str(recording.scene.get("name", ""))},
        "configById": panels,
        "layout": _split("row", 68.0, main, _stack(beside)) if beside else main,
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
    }


def _stack(panels: Sequence[str]) -> Any:
    """Panels below each other, of one height."""
    first, *others = panels
    return first if not others else _split("column", 100.0 / len(panels), first, _stack(others))


def _split(direction: str, share: float, first: Any, second: Any) -> dict[str, Any]:
    return {"direction": direction, "splitPercentage": share, "first": first, "second": second}


def _scene(camera: Camera, floor: float, frames: Sequence[str], topics: Sequence[str]) -> dict[str, Any]:
    return {
        "cameraState": camera_state(camera),
        "followTf": ROOT,
        "followMode": "follow-none",
        "scene": {"backgroundColor": BACKGROUND},
        "transforms": {f"frame:{name}": {"visible": False} for name in (ROOT, *frames)},
        "topics": {topic: {"visible": True} for topic in topics},
        "layers": {
            "grid": {
                "layerId": "foxglove.Grid", "instanceId": "grid", "label": "Grid", "visible": True, "order": 1,
                "frameId": ROOT, "frameLocked": True, "size": 4.0, "divisions": 8, "lineWidth": 1.0, "color": GRID,
                "position": [0.0, 0.0, floor], "rotation": [0.0, 0.0, 0.0],
            }
        },
    }  # fmt: skip


def camera_state(camera: Camera) -> dict[str, Any]:
    """A camera, z up, as the 3-D panel has it.

    phi is the angle from the vertical, theta that round it: the panel puts its eye at the target and
    d (sin phi sin theta, -sin phi cos theta, cos phi), where theta is minus `thetaOffset`.
    """
    x, y, z = (camera.eye - camera.target).tolist()
    distance = math.hypot(x, y, z)
    return {
        "perspective": True,
        "distance": distance,
        "phi": math.degrees(math.acos(z / distance)),
        "thetaOffset": -math.degrees(math.atan2(x, -y)),
        "targetOffset": camera.target.tolist(),
        "target": [0.0, 0.0, 0.0],
        "targetOrientation": [0.0, 0.0, 0.0, 1.0],
        "fovy": math.degrees(camera.fov),
        "near": 0.01 * distance,
        "far": 100.0 * distance,
    }


def _plot(title: str, curves: Mapping[str, str]) -> dict[str, Any]:
    paths = [
        {"value": value, "label": label, "enabled": True, "timestampMethod": "receiveTime", "color": colour}
        for (label, value), colour in zip(curves.items(), CURVES * len(curves), strict=False)
    ]
    return {
        "foxglovePanelTitle": title, "lichtblickPanelTitle": title, "paths": paths, "xAxisVal": "timestamp",
        "isSynced": True, "showLegend": True, "legendDisplay": "top", "showPlotValuesInLegend": False,
        "showXAxisLabels": True, "showYAxisLabels": True, "sidebarDimension": 240,
    }  # fmt: skip
