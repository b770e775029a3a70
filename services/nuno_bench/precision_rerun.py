"""The series of precision sweeps as a rerun file: error over wall time, and over the frames of each run.

rerun has no logarithmic axes and no plots but over time. So errors over time are their decimal
logarithms, and error over wall time is drawn in a plane whose unit is a decade, with its own grid.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nuno.viewer.layout import CURVES, TIMELINE, entity
from nuno.viewer.require import part_of
from nuno_bench.precision_findings import solvers_of
from nuno_bench.precision_page import Findings
from nuno_bench.precision_point import Point

APPLICATION = "nuno bench precision"
GRID, INK = [205, 209, 215], [40, 43, 48]
WIDE = 3.0
"""Width of a decade of time, in heights of a decade of error: errors span more of them."""
LEAST = 1e-17
"""Errors below it, such as 0, are drawn there."""


def write(path: Path, found: Sequence[Findings]) -> Path:
    """Log all scenes into one file, which gets its name when it is whole, with the views that show them."""
    import rerun as rr
    import rerun.blueprint as rrb

    recording = rr.RecordingStream(APPLICATION, send_properties=False)
    views = [rrb.Tabs(*_views(one), name=one.scene) for one in found]
    panels = (rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed"))
    time = rrb.TimePanel(state="collapsed", timeline=TIMELINE)
    blueprint = rrb.Blueprint(rrb.Tabs(*views), *panels, time, auto_views=False, auto_layout=False)
    recording.save(part_of(path), default_blueprint=blueprint)
    for one in found:
        for name in one.quantities:
            _log_plane(recording, one, name)
            _log_frames(recording, one, name)
    recording.flush(timeout_sec=60.0)
    recording.disconnect()
    part_of(path).replace(path)
    return path


def _views(found: Findings) -> list[Any]:
    """A tab for each quantity: wall time on the left, frames on the right."""
    import rerun.blueprint as rrb

    tabs = []
    for name in found.quantities:
        low, high = _bounds(found, name)
        across, up = [WIDE * low[0] - 1.2, WIDE * high[0] + 1.2], [-high[1] - 0.6, -low[1] + 0.9]
        plane = rrb.Spatial2DView(
            name=f"{name}: error over wall time [s]",
            origin=entity(found.scene, name, "wall time"),
            visual_bounds=rrb.VisualBounds2D(x_range=across, y_range=up),
            background=[255, 255, 255],
        )
        frames = rrb.TimeSeriesView(
            name=f"{name}: log10 of the error over simulated time",
            origin=entity(found.scene, name, "frames"),
            plot_legend=rrb.PlotLegend(visible=False),
        )
        tabs.append(rrb.Horizontal(plane, frames, name=name))
    return tabs


def _timed(found: Findings, name: str) -> list[tuple[Point, float, float]]:
    """Points that have both, with log10 of the time and of the error."""
    return [
        (point, math.log10(point.median), math.log10(max(error, LEAST)))
        for point in found.points
        if point.seconds and (error := point.error(name)) is not None
    ]


def _bounds(found: Findings, name: str) -> tuple[tuple[int, int], tuple[int, int]]:
    """Whole decades around all points and the floor: the least time and error, and the largest."""
    timed = _timed(found, name)
    times = [t for _, t, _ in timed] or [0.0]
    errors = [error for _, _, error in timed] + [math.log10(max(found.floors[name].l2, LEAST))]
    return (math.floor(min(times)), math.floor(min(errors))), (math.ceil(max(times)), math.ceil(max(errors)))


def _log_plane(recording: Any, found: Findings, name: str) -> None:
    """A line per solver from coarse to fine over a grid of decades, and the floor."""
    import rerun as rr

    (left, low), (right, high) = _bounds(found, name)
    place = (found.scene, name, "wall time")
    across = [[[WIDE * left, -e], [WIDE * right, -e]] for e in range(low, high + 1)]
    up = [[[WIDE * t, -low], [WIDE * t, -high]] for t in range(left, right + 1)]
    recording.log(entity(*place, "grid"), rr.LineStrips2D(across + up, colors=GRID, radii=-0.5), static=True)
    marks = [([WIDE * left - 0.35, -e], f"1e{e}") for e in range(low, high + 1)]
    marks += [([WIDE * t, 0.35 - low], f"1e{t} s") for t in range(left, right + 1)]
    shown = {"colors": INK, "radii": -0.1, "show_labels": True}
    at, labels = zip(*marks, strict=True)
    recording.log(entity(*place, "decades"), rr.Points2D(at, labels=labels, **shown), static=True)
    floor = -math.log10(max(found.floors[name].l2, LEAST))
    ends = [[WIDE * left, floor], [WIDE * right, floor]]
    line = rr.LineStrips2D([ends], colors=INK, radii=-1.0, labels="floor", show_labels=True)
    recording.log(entity(*place, "floor"), line, static=True)
    timed = _timed(found, name)
    for i, solver in enumerate(solvers_of(found.points)):
        own = sorted((one for one in timed if one[0].solver == solver), key=lambda one: -one[0].finer)
        if not own:
            continue
        points, colour = np.array([[WIDE * t, -error] for _, t, error in own]), CURVES[i % len(CURVES)]
        settings = [point.setting for point, _, _ in own]
        dots = rr.Points2D(points, colors=colour, radii=-4.0, labels=settings, show_labels=False)
        recording.log(entity(*place, "solvers", solver), dots, static=True)
        recording.log(entity(*place, "solvers", solver, "line"), rr.LineStrips2D([points], colors=colour, radii=-1.0),
                      static=True)  # fmt: skip
        name_at = rr.Points2D([points[-1] + [0.15, 0.15]], labels=solver, **shown)
        recording.log(entity(*place, "solvers", solver, "name"), name_at, static=True)


def _log_frames(recording: Any, found: Findings, name: str) -> None:
    """log10 of each run's error at every compared frame but the first, over simulated time."""
    import rerun as rr

    for i, solver in enumerate(solvers_of(found.points)):
        for point in found.points:
            if point.solver != solver or not point.history.get(name):
                continue
            place = entity(found.scene, name, "frames", solver, point.setting)
            look = rr.SeriesLines(names=f"{solver}, {point.setting}", colors=CURVES[i % len(CURVES)])
            recording.log(place, look, static=True)
            errors = np.log10(np.maximum(np.array(point.history[name]), LEAST))
            times = rr.TimeColumn(TIMELINE, duration=found.frame * np.arange(1, len(errors) + 1))
            recording.send_columns(place, [times], rr.Scalars.columns(scalars=errors))
