"""Panels of curves as a rerun file, the same that nuno_bench.report.plots draws as SVG.

rerun has no logarithmic axes, and plots only over a timeline. So each panel is a plane of WIDTH by HEIGHT units that
draws its own frame, and points show their labels under the pointer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from nuno.recording.writer import part_of
from nuno.viewer.layout import entity
from nuno_bench.report.page import number
from nuno_bench.report.plots import Panel
from nuno_schemas.fabric import Float

WIDTH, HEIGHT, MARGIN = 9.0, 6.0, 1.5
GRID, INK = [205, 209, 215], [40, 43, 48]
LEAST = 1e-17
"""Least value on a logarithmic axis: smaller ones, such as 0, are drawn there."""
DOT, RULE, LETTER = -4.0, -1.0, -0.1
"""Radii; negative ones are in points of the screen instead of the plane's units."""


def write(path: Path, application: str, tabs: Mapping[str, Sequence[Panel]]) -> None:
    """Log the panels of each tab, and their views; the file is renamed when it is complete."""
    views = [rrb.Grid(*(_view((name, panel.title), panel) for panel in panels), name=name)
             for name, panels in tabs.items()]  # fmt: skip
    recording = rr.RecordingStream(application, send_properties=False)
    closed = (panel(state="collapsed") for panel in (rrb.BlueprintPanel, rrb.SelectionPanel, rrb.TimePanel))
    blueprint = rrb.Blueprint(rrb.Tabs(*views), *closed, auto_views=False, auto_layout=False)
    recording.save(part_of(path), default_blueprint=blueprint)
    for name, panels in tabs.items():
        for panel in panels:
            _log_panel(recording, (name, panel.title), panel)
    recording.flush(timeout_sec=60.0)
    recording.disconnect()
    part_of(path).replace(path)
    print(f"written {path}")


def _view(place: Sequence[str], panel: Panel) -> Any:
    bounds = rrb.VisualBounds2D(x_range=[-MARGIN, WIDTH + 2.0 * MARGIN], y_range=[-HEIGHT - MARGIN, MARGIN])
    name = f"{panel.title}: {panel.ylabel} over {panel.xlabel}" if panel.ylabel else f"{panel.title}, {panel.xlabel}"
    return rrb.Spatial2DView(name=name, origin=entity(*place), visual_bounds=bounds, background=[255, 255, 255])


class Axis:
    """Maps the values of all curves of a panel to 0 to `length`, with names at `ticks`."""

    def __init__(self, values: Float, log: bool, length: float) -> None:
        """Fit the axis to values; a logarithmic axis covers whole decades."""
        self.log, self.length = log, length
        scaled = self._scaled(values)
        scaled = scaled[np.isfinite(scaled)]
        low, high = (float(scaled.min()), float(scaled.max())) if scaled.size else (0.0, 0.0)
        if log:
            low, high = math.floor(low), math.ceil(high)
        self.low, self.high = (low, high) if high > low else (low - 0.5, low + 0.5)
        decades = np.arange(low, high + 0.5, max(1, round((high - low) / 8.0)))
        ticks = decades if log else np.linspace(low, high, 5)
        self.names = [f"1e{tick:g}" if log else number(float(tick)) for tick in ticks]
        self.ticks = self._placed(ticks)

    def at(self, values: Float) -> Float:
        """Return the positions (m,) of values (m,); infinite ones are a little above the end."""
        return self._placed(self._scaled(values))

    def _scaled(self, values: Float) -> Float:
        return np.log10(np.maximum(values, LEAST)) if self.log else values

    def _placed(self, scaled: Float) -> Float:
        share: Float = (scaled - self.low) / (self.high - self.low)
        return self.length * np.where(np.isposinf(share), 1.05, share)


def axes_of(panel: Panel) -> tuple[Axis, Axis]:
    """Return the axes of x and y."""
    x, y = np.concatenate([np.zeros((2, 0)), *(np.stack([curve.x, curve.y]) for curve in panel.curves)], axis=1)
    return Axis(x, "x" in panel.log, WIDTH), Axis(y, "y" in panel.log, HEIGHT)


def _log_panel(recording: Any, place: Sequence[str], panel: Panel) -> None:
    """Log a frame with lines at its ticks; points and line of each curve; to the right its name, in its colour."""

    def log(shown: Any, *what: str) -> None:
        recording.log(entity(*place, *what), shown, static=True)

    x, y = axes_of(panel)
    grid = [[(t, 0.0), (t, -HEIGHT)] for t in x.ticks] + [[(0.0, -t), (WIDTH, -t)] for t in y.ticks]
    log(rr.LineStrips2D(grid, colors=GRID, radii=-0.5), "grid")
    marks = [*((t, 0.4) for t in x.ticks), *((-0.7, -t) for t in y.ticks), (0.5 * WIDTH, 1.0)]
    names = [*x.names, *y.names, panel.xlabel]
    log(rr.Points2D(marks, colors=INK, radii=LETTER, labels=names, show_labels=True), "ticks")
    for i, curve in enumerate(panel.curves):
        shade = [int(curve.shade[k : k + 2], 16) for k in (1, 3, 5)]
        # rerun's second axis points down.
        points = np.stack([x.at(curve.x), -y.at(curve.y)], axis=1)
        seen = np.isfinite(points).all(axis=1)
        labels = [curve.labels[k] for k in np.flatnonzero(seen).tolist()] if curve.labels else None
        log(rr.Points2D(points[seen], colors=shade, radii=DOT, labels=labels, show_labels=False), "curves", curve.name)
        if not curve.loose:
            log(rr.LineStrips2D([points[seen]], colors=shade, radii=RULE), "curves", curve.name, "line")
        at, name = [(WIDTH + 0.5, -HEIGHT + 0.4 * i)], curve.name + (f", {curve.ended}" if curve.ended else "")
        log(rr.Points2D(at, colors=shade, radii=DOT, labels=[name], show_labels=True), "names", curve.name)
