"""Maps as pictures: one panel a solver, classes in colours that colour-blind people tell apart, and with marks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from nuno_bench.report import plots
from nuno_bench.report.plots import Curve
from nuno_bench.report.result import number
from nuno_bench.stability.drift import Amplification, Drift
from nuno_bench.stability.sweep import Row

COLOURS = {
    "exact": "#0072b2",
    "accurate": "#7fc4ee",
    "damped away": "#f0e442",
    "drifting": "#e69f00",
    "diverged": "#b03a00",
    "refused": "#8a8f98",
    "left out": "#ffffff",
}
"""After Okabe & Ito 2008; classes also differ in lightness."""
MARKS = {"diverged": "x", "refused": "_", "drifting": "o"}
COLUMNS = 3


def maps(rows: Sequence[Row], axis: str, name: str) -> str:
    """(axis value x dt) of each solver; the black line is the limit that the solver states."""
    solvers = list(dict.fromkeys(row.solver for row in rows))
    plt = plots.pyplot()
    with plt.rc_context(plots.STYLE):
        height = math.ceil(len(solvers) / COLUMNS)
        figure, axes = plt.subplots(
            height, COLUMNS, figsize=(8.0, 0.9 + 2.0 * height), layout="constrained",
            squeeze=False, sharex=True, sharey=True,
        )  # fmt: skip
        for panel, solver in zip(axes.flat, sorted(solvers), strict=False):
            _panel(panel, sorted((r for r in rows if r.solver == solver), key=place_of), solver)
        for panel in list(axes.flat)[len(solvers) :]:
            panel.set_visible(False)
        axes[-1][0].set_xlabel(name, loc="left")
        figure.supylabel("step [s]", fontsize=9)
        _legend(figure, plt)
        return plots.svg(figure, f"map-{axis}")


def place_of(row: Row) -> float:
    """Where a row stands: its factor, or the shortest spring [mm]."""
    return 1e3 * row.edge if row.axis == "mesh" else row.value


def _edges(values: Sequence[float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Borders half-way between values on a logarithmic axis, (n + 1,)."""
    logs = np.log(np.asarray(values, float))
    inner = 0.5 * (logs[1:] + logs[:-1])
    first = 2.0 * logs[0] - inner[0] if inner.size else logs[0] - 0.5
    last = 2.0 * logs[-1] - inner[-1] if inner.size else logs[-1] + 0.5
    borders: np.ndarray[Any, np.dtype[np.float64]] = np.exp(np.concatenate([[first], inner, [last]]))
    return borders


def _panel(panel: Any, rows: Sequence[Row], solver: str) -> None:
    borders = _edges([place_of(row) for row in rows])
    for row, left, right in zip(rows, borders, borders[1:], strict=False):
        for point in row.points:
            low, high = point.dt / math.sqrt(2.0), point.dt * math.sqrt(2.0)
            hatch = "////" if point.outcome == "left out" else None
            panel.fill_between(
                [left, right], low, high, facecolor=COLOURS[point.outcome], hatch=hatch, edgecolor="#c9cdd3",
                linewidth=0.3,
            )  # fmt: skip
            if point.outcome in MARKS:
                panel.plot(
                    [math.sqrt(left * right)], [point.dt], MARKS[point.outcome], color="#1b1d21", markersize=2.6,
                    markeredgewidth=0.6, fillstyle="none",
                )  # fmt: skip
        if math.isfinite(row.limit) and row.limit > 0.0:
            panel.plot([left, right], [row.limit, row.limit], color="#000000", linewidth=1.8, zorder=5)
    limited = any(math.isfinite(row.limit) and row.limit > 0.0 for row in rows)
    none = all(row.limit == 0.0 for row in rows)
    panel.set_title(solver + ("" if limited else ", no stable step" if none else ", no limit"))
    panel.set_xscale("log")
    panel.set_yscale("log")
    places = [place_of(row) for row in rows]
    panel.set_xticks(places, [number(place) for place in places])
    panel.minorticks_off()
    steps = [point.dt for row in rows for point in row.points]
    panel.set_ylim(min(steps) / 2.0, max(steps) * 2.0)


def _legend(figure: Any, plt: Any) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Patch(facecolor=colour, edgecolor="#8a8f98", linewidth=0.4, label=name, hatch="////" * (name == "left out"))
        for name, colour in COLOURS.items()
    ]
    handles.append(Line2D([], [], color="#000000", linewidth=1.8, label="stated limit"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4)


def amplifications(found: Sequence[Amplification]) -> str:
    """Growth of a step and frequency over omega dt; both are 1 for the exact solution."""
    sizes = [Curve(a.solver, np.log10(a.h), np.clip(a.size, 0.0, 2.0), i, i % 2 == 1) for i, a in enumerate(found)]
    waves = [Curve(a.solver, np.log10(a.h), a.frequency, i, i % 2 == 1) for i, a in enumerate(found)]
    return plots.curves(
        {"growth of a step (exact: 1)": sizes, "frequency over the exact one": waves}, "log10 of omega dt"
    )


def drifts(found: Sequence[Drift]) -> str:
    """|Energy / start - 1| over the steps."""
    series = []
    for i, drift in enumerate(found):
        size = np.clip(np.abs(drift.change[1:]), 1e-17, 1e3)
        series.append(Curve(drift.solver, drift.steps[1:] / 1000, size, i, i % 2 == 1, drift.ended))
    name = "energy off its start, as a share"
    return plots.curves({name: series}, "thousand steps", (name,))
