"""Figures as inline SVG, by matplotlib, in one sober style; failures are marked, never left out."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_bench import extras

COLOURS = ("#2f5d8a", "#b3541e", "#3b7d4f", "#7a4a8c", "#8a7a2f", "#555b66", "#2a9d9f", "#c2558f", "#7fa23a", "#5a3a22")
BAD = "#a3262a"
STYLE = {
    "svg.fonttype": "path",
    "font.family": "serif",
    "font.serif": ["Charter", "Bitstream Charter", "Georgia", "DejaVu Serif"],
    "font.size": 9.0,
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#5b616b",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.color": "#3a3f47",
    "ytick.color": "#3a3f47",
    "lines.linewidth": 1.0,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
}


@dataclass(frozen=True)
class Curve:
    """A named series; `ended` says why it stops early, and is marked at its last finite point.

    colour is an index into COLOURS; a dashed curve pairs with the solid one of the same colour.
    """

    name: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    colour: int
    dashed: bool = False
    ended: str = ""


def require_matplotlib() -> None:
    """Raises BadInput where figures cannot be drawn."""
    extras.require("pages with figures need", ["matplotlib"])


def curves(panels: Mapping[str, Sequence[Curve]], xlabel: str, log: Sequence[str] = ()) -> str:
    """Panels side by side, each named after its quantity; those in `log` have a logarithmic axis.

    Why a curve ends is written in the first panel only, and marked in all.
    """
    plt = pyplot()
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, len(panels), figsize=(8.0, 3.1), layout="constrained", squeeze=False)
        for axis, (name, series) in zip(axes[0], panels.items(), strict=True):
            for curve in series:
                _draw(axis, curve, label=axis is axes[0][0])
            axis.set_title(name)
            axis.set_xlabel(xlabel)
            if name in log:
                axis.set_yscale("log")
        handles, names = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=min(4, len(names)))
        return svg(figure, "-".join(panels))


def _draw(axis: Any, curve: Curve, label: bool) -> None:
    finite = np.isfinite(curve.x) & np.isfinite(curve.y)
    x, y, colour = curve.x[finite], curve.y[finite], COLOURS[curve.colour % len(COLOURS)]
    axis.plot(x, y, color=colour, linestyle=(0, (4, 2)) if curve.dashed else "-", label=curve.name)
    if curve.ended and x.size:
        axis.plot(x[-1:], y[-1:], marker="x", markersize=7, markeredgewidth=1.8, color=BAD, clip_on=False, zorder=5)
        if label:
            axis.annotate(curve.ended, (x[-1], y[-1]), (6, -3), textcoords="offset points", color=BAD, fontsize=7.5)


def bars(
    names: Sequence[str],
    samples: Sequence[Sequence[float]],
    wanted: Sequence[tuple[float | None, float | None]],
    xlabel: str,
) -> str:
    """Horizontal bars of medians with min and max; a line at each bar to reach, a dotted one at its aim.

    No samples: the row says that it failed.
    """
    plt = pyplot()
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(8.0, 0.6 + 0.3 * len(names)), layout="constrained")
        for row, (values, (bar, aim)) in enumerate(zip(samples, wanted, strict=True)):
            if not values:
                axis.text(0, row, " failed", color=BAD, va="center")
                continue
            median = float(np.median(values))
            missed = bar is not None and median < bar
            axis.barh(row, median, height=0.62, color=BAD if missed else COLOURS[0], alpha=0.85)
            axis.plot([min(values), max(values)], [row, row], color="#1b1d21", linewidth=1.0)
            for value, style in ((bar, "-"), (aim, ":")):
                if value is not None:
                    axis.plot([value, value], [row - 0.42, row + 0.42], color="#1b1d21", linestyle=style, linewidth=1.4)
        axis.set_yticks(range(len(names)), names)
        axis.set_xlabel(xlabel)
        axis.invert_yaxis()
        return svg(figure, "bars")


def pyplot() -> Any:
    """matplotlib.pyplot, drawing without a screen. Raises BadInput where it is missing."""
    require_matplotlib()
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot

    return matplotlib.pyplot


def svg(figure: Any, salt: str) -> str:
    """Markup that may stand in HTML: no prologue, no metadata, identifiers of its own."""
    import matplotlib.pyplot as plt

    stream = io.StringIO()
    with plt.rc_context({"svg.hashsalt": salt}):
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    plt.close(figure)
    text = stream.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    prefix = "f" + re.sub(r"\W", "", salt)[:24]
    return re.sub(r'(id="|href="#|url\(#)', lambda match: match[0] + prefix, text)
