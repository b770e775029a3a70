"""Error over wall time of every engine: a line per kind from coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nuno_bench.peers.process import Point
from nuno_bench.report import plots
from nuno_bench.speed.steps.stiff import CENTRE, STRAIN

MARKERS = {"nuno": "o", "numpy": "D", "scipy": "^", "mujoco": "s", "newton": "v"}
STRIP = 1.04
"""Height, in the axis' own measure, at which failures are marked: above every error."""


def error_over_time(points: Sequence[Point]) -> str:
    """SVG. Ours are solid lines, others dashed ones; a kind whose strain is off is hollow there."""
    plt = plots.pyplot()
    kinds = list(dict.fromkeys(point.kind for point in points))
    with plt.rc_context(plots.STYLE):
        figure, axis = plt.subplots(figsize=(8.0, 5.4), layout="constrained")
        axis.set_xscale("log")
        axis.set_yscale("log")
        for index, kind in enumerate(kinds):
            _draw(axis, [point for point in points if point.kind == kind], _look(index, kind), 0.025 * index)
        axis.axhline(1e3 * CENTRE, color="#1b1d21", linewidth=0.9, linestyle=(0, (4, 2)), zorder=1)
        axis.set_xlabel("wall time of a simulated second [s]")
        axis.set_ylabel("centre of mass off by [mm]")
        axis.grid(True, which="major", color="#e6e8ec", linewidth=0.5, zorder=0)
        axis.set_axisbelow(True)
        axis.plot([], [], color="#1b1d21", marker="x", linestyle="", markersize=5.5, label="failed (above)")
        figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=4)
        return plots.svg(figure, "peers")


def _look(index: int, kind: str) -> dict[str, Any]:
    dashed = not kind.startswith("nuno-") or index >= len(plots.COLOURS)
    return {
        "color": plots.COLOURS[index % len(plots.COLOURS)],
        "marker": MARKERS.get(kind.partition("-")[0], "P"),
        "markersize": 5.0,
        "linestyle": (0, (3, 1.5)) if dashed else "-",
    }


def _draw(axis: Any, own: Sequence[Point], look: dict[str, Any], edge: float) -> None:
    """`edge`, a share of the axis, is where failures are marked that took no time."""
    shown = [(point, point.score) for point in own if point.score is not None]
    times, errors = [point.median for point, _ in shown], [1e3 * score.centre for _, score in shown]
    low = [point.median - min(point.seconds) for point, _ in shown]
    high = [max(point.seconds) - point.median for point, _ in shown]
    axis.errorbar(times, errors, xerr=[low, high], elinewidth=0.8, capsize=1.5, zorder=3, label=own[0].kind, **look)
    off = [(p.median, 1e3 * score.centre) for p, score in shown if abs(score.strain - 1.0) > STRAIN]
    if off:
        hollow = look | {"linestyle": "", "markerfacecolor": "white"}
        axis.plot(*zip(*off, strict=True), zorder=4, **hollow)
    place = {"clip_on": False, "linestyle": "", "marker": "x", "markersize": 5.5, "markeredgewidth": 1.6, "zorder": 4}
    for point in own:
        if point.score is None and point.seconds:
            axis.plot(point.median, STRIP, color=look["color"], transform=axis.get_xaxis_transform(), **place)
        elif point.score is None:
            axis.plot(edge, STRIP, color=look["color"], transform=axis.transAxes, **place)
