"""The camera of a recording's pictures."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from nuno.recording.reader import Recording
from nuno.scene.override import apply_override, overridden
from nuno.scene.validation_errors import validated
from nuno.scene.warnings import implausible_fields
from nuno.scene.yaml_lines import Path
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.pictures import Camera, Mesh
from nuno_schemas.pictures import frame as fit_camera
from nuno_schemas.scene import View


def z_up(points: Float) -> Float:
    """Rotate points (n, 3) of a scene, with y up and a view along -z, to z up and a view along y."""
    return np.ascontiguousarray(points[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0]))


Side = Literal["front", "left", "back", "right", "close"]
SIDES: dict[str, str] = {
    **{side: f"view.azimuth={angle}deg" for side, angle in (("front", 0), ("left", 90), ("back", 180), ("right", 270))},
    "close": "view.close=true",
}
"""Change of the view by a camera's name: the visible side of a body that faces +z, or the cloth alone."""
CAMERA = re.compile(r"view\.(azimuth|elevation|target|distance|close|size)\b")
"""Fields of a recorded scene that change only the camera."""


def of_camera(recording: Recording, overrides: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split overrides, key=value, into those of the camera and those of dye. Raises BadInput without dye."""
    camera = tuple(item for item in overrides if CAMERA.match(item))
    others = tuple(item for item in overrides if item not in camera)
    if others and recording.scene.get("dye") is None:
        problem, limit = "this field is no matter of pictures of cloth that is not dyed", "where view looks from"
        raise BadInput(problem, "--set", value=others[0], limit=limit, remedy="for example --set view.azimuth=90deg")
    return camera, others


def read_view(recording: Recording, overrides: Sequence[str] = ()) -> View:
    """Return the scene's view with overrides, key=value. Raises BadInput for an invalid view."""
    data = {"view": copy.deepcopy(recording.scene.get("view", {}))}
    lines: dict[Path, int] = {}
    for item in overrides:
        lines = overridden(lines, apply_override(data, item))
    return validated(View, data["view"], str(recording.path), lines, ("view",))


def view_doubts(recording: Recording, overrides: Sequence[str]) -> list[str]:
    """Return warnings of bare numbers in overrides of the view whose unit was probably forgotten. Raises BadInput."""
    given, camera = {"view": dict[str, Any]()}, [item for item in overrides if CAMERA.match(item)]
    for item in camera:
        apply_override(given, item)
    return implausible_fields(given["view"], read_view(recording, camera), "view.")


def turned(camera: Camera, angle: float) -> Camera:
    """Rotate the eye about the vertical through its target, by an angle [rad]."""
    return replace(camera, eye=camera.target + turn(camera.eye - camera.target, angle))


def turn(points: Float, angle: float) -> Float:
    """Rotate points (..., 3) about the vertical, z, by an angle [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]))


MARGIN, NARROW = 0.08, 0.03
"""Free margin of a picture on each side, as a share of it, and that of a close camera."""


def place_camera(view: View, meshes: Iterable[Mesh], size: tuple[int, int], room: float = 0.0) -> Camera:
    """Fit a camera to the meshes, with additional `room` on each side, except for the view's target and distance."""
    fitted = fit_camera(meshes, view.azimuth, view.elevation, size, margin=(NARROW if view.close else MARGIN) + room)
    if view.target is None and view.distance is None:
        return fitted
    toward = fitted.eye - fitted.target
    distance = float(np.linalg.norm(toward)) if view.distance is None else view.distance
    target = fitted.target if view.target is None else z_up(np.array([view.target]))[0]
    return replace(fitted, eye=target + toward / np.linalg.norm(toward) * distance, target=target)
