"""Export of a recording as an MCAP file for Foxglove and Lichtblick: meshes, bodies, curves and log, with a layout."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from nuno.exports.camera import place_camera, read_view, z_up
from nuno.exports.meshes import CLOTH, ROOT, WORLD, follow, show_recording
from nuno.exports.viewer_messages import ViewerMessages
from nuno.output_files import Progress, check_target, writing
from nuno.recording.mcap_file import McapFile
from nuno.recording.reader import Recording, opened
from nuno_schemas.fabric import Float
from nuno_schemas.messages import PENETRATION, STATE, STATUS
from nuno_schemas.pictures import Camera, Mesh

# The layout that shows an exported recording in Foxglove and Lichtblick.

SCENE, EVENTS = ("scene/cloth", "scene/bodies", "scene/skins"), "log"
PANEL = (720, 720)
"""Panel size for the fitted camera: the whole scene is visible in any panel that is not higher than wide."""
BACKGROUND, GRID = "#e2e6ea", "#b3bac2"
CURVES = ("#e69f00", "#56b4e9", "#009e73", "#cc79a7", "#d55e00", "#0072b2", "#808080")
"""Distinguishable with the common colour-vision deficiencies (Okabe and Ito, 2008), and a grey."""


def arrange(
    recording: Recording, points: Sequence[Float], floor: float | None, frames: Sequence[str],
    topics: Collection[str], numbers: Sequence[str],
) -> dict[str, Any]:  # fmt: skip
    """Return the layout for both: the scene on the left, on the right curves of energy and penetration, and the log.

    points  (n, 3) each [m]: points that must be in view, by the scene's view
    floor   height of the grid [m], None for the lowest point
    frames  names of all frames, whose axes are hidden
    topics  topics of the file; panels of other topics are left out
    numbers names of the numbers in the simulation's status
    """
    cloud = z_up(np.concatenate(points))
    camera = place_camera(read_view(recording), [Mesh(cloud, np.zeros((0, 3), np.int32))], PANEL)
    height = float(cloud[:, 2].min()) if floor is None else floor
    shown = [topic for topic in SCENE if topic in topics]
    panels: dict[str, Any] = {"3D!scene": _scene(camera, height, frames, shown)}
    if energy := [name for name in numbers if name.startswith("energy_")]:
        curves = {name.removeprefix("energy_"): f"numbers/{STATUS.name}.{name}" for name in energy}
        panels["Plot!energy"] = _plot("Energy [J]", curves)
    if (topic := f"numbers/{PENETRATION.name}") in topics:
        curves = {"deepest": f"{topic}.depth", "mean of those inside": f"{topic}.mean"}
        panels["Plot!depth"] = _plot("Penetration [m]", curves)
    if EVENTS in topics:
        panels["RosOut!log"] = {"topicToRender": EVENTS, "minLogLevel": 1, "searchTerms": []}
    main, *side = panels
    # `target.MAGIC` relies on the first key: a layout saved by a viewer begins differently.
    return {
        "globalVariables": {"nuno": str(recording.scene.get("name", ""))},
        "configById": panels,
        "layout": _split("row", 68.0, main, _stack(side)) if side else main,
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
    }


def _stack(panels: Sequence[str]) -> Any:
    """Stack panels of equal height."""
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
    """Return the 3-D panel's state of a camera, z up.

    phi is the angle from the vertical, theta the angle about it: the panel's eye is at the target plus
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


SUFFIX, LAYOUT = ".mcap", ".layout.json"
LIBRARY = "nuno export"
"""Library in the file's header, which distinguishes it from a recording."""
LOOKS = 16
"""Number of frames to which the camera is fitted."""


def export_foxglove(source: Recording | Path | str, path: Path, progress: Progress | None = None) -> list[Path]:
    """Write a whole recording, .mcap, and next to it its layout, .layout.json; return both paths.

    scene/cloth has a foxglove.SceneUpdate per frame, with one entity per object, by its name; scene/bodies the rigid
    bodies, once, in their frames, which scene/frames moves; scene/skins the bending bodies, each frame. Log times are
    times of the scene. Every message for viewers that a recording may have is there, in every frame. Raises
    BadInput for another ending, a file that would be lost, a recording of dye alone, positions that are not finite,
    and damage.
    """
    layout_path = check_foxglove(path)
    with opened(source) as recording, writing(path, SUFFIX) as new, writing(layout_path, ".json") as layout:
        with new.open("wb") as stream:
            export = _Export(recording, stream)
            export.write(progress)
        layout.write_text(json.dumps(export.layout(), indent=1) + "\n", encoding="utf-8")
    return [path, layout_path]


def check_foxglove(path: Path) -> Path:
    """Return the path of the layout. Raises BadInput for another ending, and a file that would be lost."""
    check_target(path, SUFFIX)
    check_target(layout := path.with_suffix(LAYOUT), ".json")
    return layout


class _Export:
    """Writes a recording's messages for viewers, all of them, each at its own time, to a stream."""

    def __init__(self, recording: Recording, stream: BinaryIO) -> None:
        self.recording, self.show = recording, show_recording(recording)
        self.number = recording.counts[STATE.name]
        self.messages = ViewerMessages(self.show, self.number)
        self.points: list[Float] = []
        """Points to which the camera is fitted, (n, 3) each [m]."""
        self._file, self._topics = McapFile(stream, "", LIBRARY), set[str]()

    def write(self, progress: Progress | None) -> None:
        """Write the whole recording. Raises BadInput."""
        looks = set(np.linspace(0, self.number - 1, LOOKS).round().astype(int).tolist())
        frame = 0
        for message, x in follow(self.recording, self.show, progress):
            if x is not None:
                self.points += [self.show.points(x)] if frame in looks else []
                frame += 1
            with self.recording.damage_reported(message):
                for shown in self.messages.of(message.topic, message.log_time, message.payload):
                    self._file.add_shown(shown, message.log_time, message.log_time)
                    self._topics.add(shown.topic)
        self._file.finish()

    def layout(self) -> dict[str, Any]:
        """Return the layout of the written file."""
        floor = None if self.show.bodies is None else self.show.bodies.floor
        energy = self.messages.names.get(STATUS.name, [()])[-1]
        frames = [WORLD, CLOTH, *(self.show.frames[i] for i in self.show.own.tolist())]
        return arrange(self.recording, self.points, floor, frames, self._topics, energy)
