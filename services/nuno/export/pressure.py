"""Pressure of a recording's knits, frame by frame: the scene is built again, its positions are the recording's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nuno.cloth import build
from nuno.cloth.pressure import find_pressure, has_pressure
from nuno.recording.reader import Recording
from nuno.recording.restore import restored_scene
from nuno_schemas.fabric import Float

Pressures = Callable[[Float], Float]
"""Pressure (n,) [Pa] at positions (n, 3) [m]."""


def read_pressure(recording: Recording) -> Pressures | None:
    """What finds it, or None where the recording has no knit."""
    arrays, _ = recording.fabric()
    if "edge_yarn" not in arrays:
        return None
    with restored_scene(recording) as loaded:
        fabric, _ = build.build_fabric(loaded)
    if not has_pressure(fabric):
        return None

    def measure(x: Float) -> Float:
        return np.asarray(find_pressure(loaded, fabric, np.asarray(x, np.float64)).arrays["pressure"])

    return measure
