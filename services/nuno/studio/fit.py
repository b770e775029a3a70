"""The fit of a recording's garments on its body, as the page shows it: tables, remarks, and maps over the cloth."""

from __future__ import annotations

import functools
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
from nuno_schemas.fabric import Float

MOST = 8
"""Fits that are kept."""


class Fits:
    """Measures recordings in a workshop, at their last frame, in which a garment is worn and no longer put on."""

    def __init__(self, recordings: Recordings, workshop: Workshop) -> None:
        self._recordings, self._turn = recordings, threading.Lock()
        self._measure = functools.lru_cache(MOST)(
            lambda path, stamp, body: workshop.make(path.name, _measure, path, body)
        )

    def fit(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fit of each garment on a body, which may be omitted if it is the only one. Raises BadInput."""
        path, body = self._recordings.find(request.get("recording")), request.get("body")
        with self._turn:  # a page may ask twice for one that takes long
            found: dict[str, Any] = self._measure(path, stamp_of(path), None if body is None else str(body))
        return found


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
