"""The fit of a recording's garments on its body, as the page shows it: tables, remarks, and maps over the cloth."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from nuno.python_api.fit import map_fits
from nuno.recording.reader import open_recording
from nuno.report.fit_report import pressing, remarks, tables, verdict
from nuno.scene.files import stamp_of
from nuno.studio.processes import Workshop
from nuno.studio.recordings import Recordings
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

MOST = 8
"""Fits that are kept."""


class Fits:
    """Measures recordings in a workshop, at their last frame, in which a garment is worn and no longer put on."""

    def __init__(self, recordings: Recordings, workshop: Workshop) -> None:
        self._recordings, self._workshop = recordings, workshop
        self._turn = threading.Lock()
        self._kept: dict[tuple[Path, tuple[int, int], str | None], dict[str, Any]] = {}

    def fit(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fit of each garment on a body, which may be omitted if it is the only one. Raises BadInput."""
        path, body = self._recordings.find(request.get("recording")), request.get("body")
        if not isinstance(body, str | None):
            raise BadInput("a body has a name", field="body", value=body)
        key = path, stamp_of(path), body
        with self._turn:  # a page may ask twice for one that takes long
            if key not in self._kept:
                self._kept[key] = self._workshop.make(path.name, _measure, path, body)
                for old in list(self._kept)[:-MOST]:
                    del self._kept[old]
            return self._kept[key]


def _measure(path: Path, body: str | None) -> dict[str, Any]:
    with open_recording(path) as recording:
        found, frame = map_fits(recording, body=body), max(number for number, _ in recording.marks().values())
    garments = [
        {
            "name": fit.name, "on": fit.on, "verdict": verdict(fit), "tables": tables(fit),
            "remarks": [*pressing(fit), *remarks(fit)], "start": over.start,
            "pressure": _numbers(over.pressure), "stretch": _numbers(100.0 * over.strain),
        }
        for fit, over in found
    ]  # fmt: skip
    return {"frame": frame, "garments": garments}


def _numbers(values: Float) -> list[float | None]:
    """Return values with four digits for JSON, None for those that are not finite."""
    return [float(f"{v:.4g}") if np.isfinite(v) else None for v in values.tolist()]
