"""The camera of a recording's pictures."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import ValidationError

from nuno.recording.reader import Recording
from nuno.scene.override import apply_override, overridden
from nuno.scene.validation_errors import explain
from nuno.scene.yaml_lines import Path
from nuno_schemas.camera import frame as fit_camera
from nuno_schemas.drawing import Camera, Mesh
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.view import View


def z_up(points: Float) -> Float:
    """Scenes have y up and look along -z; this turns y to z and -z to y."""
    return np.ascontiguousarray(points[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0]))


Side = Literal["front", "left", "back", "right", "close"]
SIDES: dict[str, str] = {
    **{side: f"view.azimuth={angle}deg" for side, angle in (("front", 0), ("left", 90), ("back", 180), ("right", 270))},
    "close": "view.close=true",
}
"""What changes a view by a camera's name: the side of a body that it sees, which faces +z, or the cloth, near by."""
CAMERA = re.compile(r"view\.(azimuth|elevation|target|distance|close|size)\b")
"""Fields of a recorded scene that only change where it is looked at from."""


def of_camera(recording: Recording, overrides: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Those of some overrides, key=value, that are the camera's, and others, of dye. Raises BadInput without dye."""
    camera = tuple(item for item in overrides if CAMERA.match(item))
    others = tuple(item for item in overrides if item not in camera)
    if others and recording.scene.get("dye") is None:
        problem, limit = "this field is no matter of pictures of cloth that is not dyed", "where view looks from"
        raise BadInput(problem, "--set", value=others[0], limit=limit, remedy="for example --set view.azimuth=90deg")
    return camera, others


def read_view(recording: Recording, overrides: Sequence[str] = ()) -> View:
    """How the scene wants pictures taken, but for some key=value of it. Raises BadInput for what no view can be."""
    data = {"view": copy.deepcopy(recording.scene.get("view", {}))}
    lines: dict[Path, int] = {}
    for item in overrides:
        lines = overridden(lines, apply_override(data, item))
    try:
        return View.model_validate(data["view"])
    except ValidationError as error:
        raise explain(error, data["view"], ("view",), str(recording.path), lines, View) from None


def turned(camera: Camera, angle: float) -> Camera:
    """The eye gone round the vertical through its target, by an angle [rad]."""
    return replace(camera, eye=camera.target + turn(camera.eye - camera.target, angle))


def turn(points: Float, angle: float) -> Float:
    """Points (..., 3) turned about the vertical, z."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]))


MARGIN, NARROW = 0.08, 0.03
"""Share of a picture that is left free on each side, and by a camera that is close."""


def place_camera(view: View, meshes: Iterable[Mesh], size: tuple[int, int], room: float = 0.0) -> Camera:
    """Fitted to the meshes, with so much more `room` on each side; target and distance of the view win."""
    fitted = fit_camera(meshes, view.azimuth, view.elevation, size, margin=(NARROW if view.close else MARGIN) + room)
    if view.target is None and view.distance is None:
        return fitted
    toward = fitted.eye - fitted.target
    distance = float(np.linalg.norm(toward)) if view.distance is None else view.distance
    target = fitted.target if view.target is None else z_up(np.array([view.target]))[0]
    return replace(fitted, eye=target + toward / np.linalg.norm(toward) * distance, target=target)
