"""Panels of curves as inline SVG, by matplotlib, in a common style; failures are marked, never left out.

nuno_bench.report.rerun draws the same panels into a rerun file.
"""

from __future__ import annotations

import io
import math
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.viewer.live import require as require_viewer
from nuno_bench import options

COLOURS = ("#2f5d8a", "#b3541e", "#3b7d4f", "#7a4a8c", "#8a7a2f", "#555b66", "#2a9d9f", "#c2558f", "#7fa23a", "#5a3a22")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p")
BAD, INK = "#a3262a", "#1b1d21"
STYLE = Path(__file__).parent / "figures.mplstyle"


@dataclass(frozen=True)
class Curve:
    """A named series x, y (m,), or, if `loose`, points without a line.

    An infinite y is shown by a cross above the panel.

    colour  an index into COLOURS, or #rrggbb; a dashed curve pairs with the solid one of the same colour
    ended   reason for an early end, which is marked at the last finite point
    marker  matplotlib's marker of each point, of `size` [points]; hollow (m,): whether it is not filled
    spread  (m, 2) smallest and largest x of each point, drawn as a bar
    labels  (m,) label of each point, for a viewer
    """

    name: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    colour: int | str
    dashed: bool = False
    ended: str = ""
    marker: str = ""
    size: float = 4.2
    loose: bool = False
    hollow: Sequence[bool] = ()
    spread: Sequence[tuple[float, float]] = ()
    labels: Sequence[str] = ()

    @property
    def shade(self) -> str:
        """The curve's colour as #rrggbb."""
        return COLOURS[self.colour % len(COLOURS)] if isinstance(self.colour, int) else self.colour


@dataclass(frozen=True)
class Panel:
    """Curves on one pair of axes; `log` names the logarithmic ones: "", "x", "y" or "xy"."""

    title: str
    curves: Sequence[Curve]
    xlabel: str
    ylabel: str = ""
    log: str = ""


def require_matplotlib() -> None:
    """Raise BadInput if figures cannot be drawn."""
    options.require_package("pages with figures need", "matplotlib")


def require_drawing(rrd: Path | None) -> None:
    """Raise BadInput if figures cannot be drawn, or if a rerun file is asked for that cannot be written."""
    require_matplotlib()
    require_viewer(None, rrd, "--rrd")


def draw(panels: Sequence[Panel], columns: int = 2, height: float = 3.0, shared: bool = False) -> str:
    """Return the SVG of panels in `columns`, each of a height [inches], with one legend and equal axes if `shared`."""
    plt = pyplot()
    columns = min(columns, len(panels))
    rows = math.ceil(len(panels) / columns)
    with plt.style.context(STYLE):
        size, share = (8.0, 0.7 + height * rows), {"sharex": shared, "sharey": shared}
        figure, axes = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False, **share)
        for axis, panel in zip(axes.flat, panels, strict=False):
            _draw_panel(axis, panel, first=axis is axes[0][0])
        for axis in axes.flat[len(panels) :]:
            axis.set_visible(False)
        named: dict[str, Any] = {}
        for axis in axes.flat:
            handles, names = axis.get_legend_handles_labels()
            named = dict(zip(names, handles, strict=True)) | named
        if named:
            figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=min(5, len(named)))
        return svg(figure, "-".join(f"{panel.title}-{panel.xlabel}" for panel in panels))


def _draw_panel(axis: Any, panel: Panel, first: bool) -> None:
    """Draw a panel; the reason for the end of a curve is written in the first panel only, and marked in all."""
    axis.set_xscale("log" if "x" in panel.log else "linear")
    axis.set_yscale("log" if "y" in panel.log else "linear")
    for curve in panel.curves:
        _draw_curve(axis, curve)
        seen = np.flatnonzero(np.isfinite(curve.x) & np.isfinite(curve.y))
        if curve.ended and seen.size:
            end = (curve.x[seen[-1]], curve.y[seen[-1]])
            axis.plot(*end, marker="x", markersize=7, markeredgewidth=1.8, color=BAD, clip_on=False, zorder=5)
            if first:
                axis.annotate(curve.ended, end, (6, -3), textcoords="offset points", color=BAD, fontsize=7.5)
    above = any(np.isinf(curve.y).any() for curve in panel.curves)
    axis.set_title(panel.title, pad=20 if above else None)
    axis.set_xlabel(panel.xlabel)
    axis.set_ylabel(panel.ylabel)
    axis.grid(True, which="major")


def _draw_curve(axis: Any, curve: Curve) -> None:
    x, y, colour = np.asarray(curve.x, float), np.asarray(curve.y, float), curve.shade
    line = "" if curve.loose else (0, (4, 2)) if curve.dashed else "-"
    seen = np.isfinite(x) & np.isfinite(y)
    look = {"color": colour, "marker": curve.marker, "markersize": curve.size}
    axis.plot(x[seen], y[seen], linestyle=line, label=curve.name, zorder=3, **look)
    if len(curve.spread):
        low, high = np.array(curve.spread).T
        axis.hlines(y[seen], low[seen], high[seen], color=colour, linewidth=0.8)
    if any(curve.hollow):
        hollow = seen & np.asarray(curve.hollow, bool)
        axis.plot(x[hollow], y[hollow], linestyle="", markerfacecolor="white", zorder=4, **look)
    if (above := np.isinf(y)).any():
        place = {"transform": axis.get_xaxis_transform(), "clip_on": False, "linestyle": "", "zorder": 4}
        axis.plot(x[above], np.full(above.sum(), 1.06), marker="x", markersize=5.5, color=colour, **place)


def marker_of(i: int) -> str:
    """Return the marker of curve i, which has COLOURS[i]: curves of the same colour have different markers."""
    return MARKERS[(i + i // len(COLOURS)) % len(MARKERS)]


def pyplot() -> Any:
    """Return matplotlib.pyplot for drawing without a screen. Raises BadInput if it is missing."""
    require_matplotlib()
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot

    return matplotlib.pyplot


def svg(figure: Any, salt: str) -> str:
    """Return the SVG markup for HTML: no prologue, no metadata, unique identifiers."""
    import matplotlib.pyplot as plt

    stream = io.StringIO()
    with plt.rc_context({"svg.hashsalt": salt}):
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    plt.close(figure)
    text = stream.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    prefix = f"f{zlib.crc32(salt.encode()):x}"
    return re.sub(r'(id="|href="#|url\(#)', lambda match: match[0] + prefix, text)
