"""The series of precision sweeps as a rerun file: error over wall time, and over the frames of each run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nuno.viewer.layout import TIMELINE, entity
from nuno_bench.precision.findings import solvers_of
from nuno_bench.precision.page import Findings
from nuno_bench.precision.point import Point
from nuno_bench.report.planes import Plane, colour, decades, log_curve, logs, written

WIDE = 3.0
"""Width of a decade of time, in heights of a decade of error: errors span more of them."""


def write(path: Path, found: Sequence[Findings]) -> Path:
    """Log all scenes into one file, which gets its name when it is whole, with the views that show them."""
    import rerun.blueprint as rrb

    tabs = [rrb.Tabs(*(_view(one, name) for name in one.quantities), name=one.scene) for one in found]
    with written(path, "nuno bench precision", tabs) as recording:
        for one in found:
            for name in one.quantities:
                _log_plane(recording, one, name)
                _log_frames(recording, one, name)
    return path


def _view(found: Findings, name: str) -> Any:
    """A quantity's tab: wall time on the left, frames on the right."""
    import rerun.blueprint as rrb

    frames = rrb.TimeSeriesView(
        name=f"{name}: log10 of the error over simulated time",
        origin=entity(found.scene, name, "frames"),
        plot_legend=rrb.PlotLegend(visible=False),
    )
    return rrb.Horizontal(_plane(found, name).view(f"{name}: error over wall time [s]"), frames, name=name)


def _timed(found: Findings, name: str) -> list[tuple[Point, float]]:
    """Points that have a time, with their errors."""
    return [(point, error) for point in found.points if point.seconds and (error := point.error(name)) is not None]


def _plane(found: Findings, name: str) -> Plane:
    """Whole decades around all points and the floor."""
    timed = _timed(found, name)
    errors = [*(error for _, error in timed), found.floors[name].l2]
    x, y = decades(point.median for point, _ in timed), decades(errors)
    return Plane((found.scene, name, "wall time"), x, y, WIDE, " s")


def _log_plane(recording: Any, found: Findings, name: str) -> None:
    """A line per solver from coarse to fine over a grid of decades, and the floor."""
    plane, floor = _plane(found, name), float(logs([found.floors[name].l2])[0])
    plane.draw_grid(recording)
    plane.draw_rule(recording, ("floor",), [plane.at(plane.x, [floor, floor])], "floor")
    timed = _timed(found, name)
    for i, solver in enumerate(solvers_of(found.points)):
        own = sorted((one for one in timed if one[0].solver == solver), key=lambda one: -one[0].finer)
        if own:
            points = plane.at(logs([point.median for point, _ in own]), logs([error for _, error in own]))
            settings = [point.setting for point, _ in own]
            plane.draw_line(recording, ("solvers", solver), points, colour(i), solver, settings)


def _log_frames(recording: Any, found: Findings, name: str) -> None:
    """log10 of each run's error at every compared frame but the first, over simulated time."""
    import rerun as rr

    for i, solver in enumerate(solvers_of(found.points)):
        for point in found.points:
            if point.solver != solver or not point.history.get(name):
                continue
            place = entity(found.scene, name, "frames", solver, point.setting)
            errors = logs(point.history[name])
            times = rr.TimeColumn(TIMELINE, duration=found.frame * np.arange(1, len(errors) + 1))
            log_curve(recording, place, f"{solver}, {point.setting}", colour(i), times, errors)
