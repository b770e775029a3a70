"""The camera of a recording's pictures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from pydantic import ValidationError

from nuno.recording.reader import Recording
from nuno_schemas.camera import frame as fit_camera
from nuno_schemas.drawing import Camera, Mesh
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.view import View


def z_up(points: Float) -> Float:
    """Scenes have y up and look along -z; this turns y to z and -z to y."""
    return np.ascontiguousarray(points[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0]))


def read_view(recording: Recording) -> View:
    """How the scene wants pictures taken. Raises BadInput where that is damaged."""
    try:
        return View.model_validate(recording.scene.get("view", {}))
    except ValidationError as error:
        first = error.errors()[0]["msg"]
        raise BadInput(f"the recording's view is damaged: {first}", str(recording.path), field="view") from None


MARGIN = 0.08
"""Share of a picture that is left free on each side."""


def place_camera(view: View, meshes: Iterable[Mesh], size: tuple[int, int], room: float = 0.0) -> Camera:
    """Fitted to the meshes, with so much more `room` on each side; target and distance of the view win."""
    fitted = fit_camera(meshes, view.azimuth, view.elevation, size, margin=MARGIN + room)
    if view.target is None and view.distance is None:
        return fitted
    toward = fitted.eye - fitted.target
    distance = float(np.linalg.norm(toward)) if view.distance is None else view.distance
    target = fitted.target if view.target is None else z_up(np.array([view.target]))[0]
    return replace(fitted, eye=target + toward / np.linalg.norm(toward) * distance, target=target)
