"""Where cloth passes through cloth in rerun, and how near it comes."""

from __future__ import annotations

import math
from typing import Any

import rerun as rr

from nuno.viewer import layout
from nuno_schemas.messages import Penetration

PASSES = [214, 39, 40]
"""Red, which no fabric is shown in."""
POINT = 5.0
"""Radius of a point on the screen, from near and far."""


class CrossingsView:
    """Logs red points where edges of cloth pass through triangles, one label for each two objects, and the least
    distance of cloth from cloth as a curve, with a gap where it is more than the thickness.
    """

    def __init__(self, recording: Any) -> None:
        self.recording = recording
        self._shown: set[str] = set()
        recording.log("/plots/distance", layout.names(["least distance"]), static=True, strict=True)

    def log(self, report: Penetration) -> None:
        """What is found in the present frame."""
        distance = math.nan if report.distance is None else 1000.0 * report.distance
        self.recording.log("/plots/distance", rr.Scalars(distance), strict=True)
        found: dict[str, list[tuple[float, float, float]]] = {}
        labels: dict[str, str] = {}
        for place, pair in zip(report.places, report.objects, strict=True):
            one, other = sorted(pair)
            path = layout.entity("world", "crossings", one, other)
            found.setdefault(path, []).append(place)
            labels[path] = f"{one} passes through {'itself' if one == other else other}"
        for path in self._shown - found.keys():
            self.recording.log(path, rr.Clear(recursive=False), strict=True)
        for path, places in found.items():
            points = rr.Points3D(
                places, radii=rr.Radius.ui_points(POINT), colors=[PASSES], labels=[labels[path]], show_labels=True
            )
            self.recording.log(path, points, strict=True)
        self._shown = set(found)
