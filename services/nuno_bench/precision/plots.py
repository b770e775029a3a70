"""Error over wall time: a line per solver, ranges of repeats as bars, failures as crosses, the floor as a line.

A point beyond the stability limit that reached its end all the same is hollow. A ring marks the scene as it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from nuno_bench.precision.point import Point
from nuno_bench.report import plots

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p")
RING = {"marker": "o", "markersize": 10.0, "markerfacecolor": "none", "markeredgecolor": "#1b1d21", "linestyle": ""}
STRIP = 1.06
"""Height, in the axes' own measure, at which failures are marked: above every error."""


@dataclass(frozen=True)
class Panel:
    """One quantity: what its axis says, and the floor of its errors (0: none is drawn)."""

    quantity: str
    title: str
    floor: float


def error_over_time(
    points: Sequence[Point], panels: Sequence[Panel], solvers: Sequence[str], own: tuple[str, str]
) -> str:
    """SVG of panels, two a row; a solver keeps its colour and marker in all figures of a page.

    A ring marks the point whose key is `own`: the scene as it is.
    """
    ringed = [point for point in points if point.key == own and point.done and point.seconds]
    plt = plots.pyplot()
    columns = min(2, len(panels))
    rows = math.ceil(len(panels) / columns)
    with plt.rc_context(plots.STYLE):
        size = (8.0, 0.7 + (3.0 if columns > 1 else 3.9) * rows)
        figure, axes = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
        for axis, panel in zip(axes.flat, panels, strict=False):
            _draw(axis, panel, points, solvers)
            _ring(axis, panel, ringed)
        for axis in axes.flat[len(panels) :]:
            axis.set_visible(False)
        _legend(figure, axes[0][0], solvers, bool(ringed))
        return plots.svg(figure, "errors-" + "-".join(panel.quantity for panel in panels))


def _draw(axis: Any, panel: Panel, points: Sequence[Point], solvers: Sequence[str]) -> None:
    axis.set_xscale("log")
    axis.set_yscale("log")
    for i, name in enumerate(solvers):
        own = [point for point in points if point.solver == name]
        _line(axis, panel, own, i)
        _failures(axis, own, i)
    if panel.floor > 0.0:
        axis.axhline(panel.floor, color="#1b1d21", linewidth=0.9, linestyle=(0, (1, 1.5)), zorder=1)
        place = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points", "fontsize": 7.5}
        place["bbox"] = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.8}
        axis.annotate("floor: the references' disagreement", (1.0, panel.floor), (-2, 3), ha="right", **place)
    axis.set_title(panel.title, pad=20)
    axis.set_xlabel("wall time [s]")
    axis.grid(True, which="major", color="#e6e8ec", linewidth=0.5, zorder=0)
    axis.set_axisbelow(True)


def _line(axis: Any, panel: Panel, own: Sequence[Point], index: int) -> None:
    """The finished points from coarse to fine, each with the range of its repeats."""
    timed = [(point, error) for point in own if point.seconds and (error := point.error(panel.quantity)) is not None]
    found = [(point, error) for point, error in timed if error > 0.0]
    if not found:
        return
    found.sort(key=lambda pair: -pair[0].finer)
    times, errors = [point.median for point, _ in found], [error for _, error in found]
    low = [point.median - min(point.seconds) for point, _ in found]
    high = [max(point.seconds) - point.median for point, _ in found]
    colour, marker = _look(index)
    style = {"color": colour, "marker": marker, "markersize": 4.2, "linewidth": 1.0, "elinewidth": 0.8, "capsize": 1.5}
    axis.errorbar(times, errors, xerr=[low, high], zorder=3, **style)
    beyond = [(point.median, error) for point, error in found if point.beyond]
    if beyond:
        hollow = {"color": colour, "marker": marker, "markersize": 4.2, "markerfacecolor": "white", "linestyle": ""}
        axis.plot(*zip(*beyond, strict=True), zorder=4, **hollow)


def _failures(axis: Any, own: Sequence[Point], index: int) -> None:
    failed = [point.median for point in own if not point.done and point.seconds]
    if failed:
        place = {"transform": axis.get_xaxis_transform(), "clip_on": False, "linestyle": "", "zorder": 4}
        colour = _look(index)[0]
        axis.plot(failed, [STRIP] * len(failed), marker="x", markersize=5.5, markeredgewidth=1.6, color=colour, **place)


def _look(index: int) -> tuple[str, str]:
    return plots.COLOURS[index % len(plots.COLOURS)], MARKERS[index % len(MARKERS)]


def _ring(axis: Any, panel: Panel, ringed: Sequence[Point]) -> None:
    for point in ringed:
        error = point.error(panel.quantity)
        if error is not None and error > 0.0:
            axis.plot([point.median], [error], zorder=5, **RING)


def _legend(figure: Any, axis: Any, solvers: Sequence[str], ringed: bool) -> None:
    handles = []
    for i, name in enumerate(solvers):
        colour, marker = _look(i)
        handles += axis.plot([], [], color=colour, marker=marker, markersize=4.2, label=name)
    handles += axis.plot([], [], color="#1b1d21", marker="x", linestyle="", markersize=5.5, label="not done (above)")
    if ringed:
        handles += axis.plot([], [], label="this scene as it is", **RING)
    figure.legend(handles=handles, loc="outside lower center", ncols=min(5, len(handles)))
