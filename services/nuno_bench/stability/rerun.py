"""The maps and series of stability sweeps as a rerun file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nuno.viewer.layout import entity
from nuno_bench.report.planes import GRID, Plane, colour, decades, log_curve, logs, rgb, written
from nuno_bench.stability.drift import Modes
from nuno_bench.stability.page import AXES
from nuno_bench.stability.plots import COLOURS, place_of
from nuno_bench.stability.sweep import Mapped, Row

SHADES = {name: rgb(colour) for name, colour in COLOURS.items()} | {"left out": GRID}
"""White would not be seen."""
HALF_WIDTH = np.array([-0.1, 0.1])
"""Of a limit's line, in decades to either side."""
LEGEND = 3.0
"""Room for the names of the classes, in decades."""
STEPS = "step"
"""Timeline of the long runs: the number of the step."""


def write(path: Path, found: Sequence[Mapped]) -> Path:
    """Log all scenes into one file, which gets its name when it is whole, with the views that show them."""
    import rerun.blueprint as rrb

    tabs = [rrb.Tabs(*_views(one), name=one.scene) for one in found]
    with written(path, "nuno bench stability", tabs, STEPS) as recording:
        for one in found:
            for axis, solver in _maps(one):
                _log_map(recording, _map(one, axis, solver), _own(one, axis, solver))
            _log_modes(recording, one)
    return path


def _views(found: Mapped) -> list[Any]:
    """A tab for each kind of map, one for a mode's growth, one for the energy over many steps."""
    import rerun.blueprint as rrb

    tabs = []
    for axis, words in AXES.items():
        panels = [_map(found, axis, name).view(name) for other, name in _maps(found) if other == axis]
        if panels:
            tabs.append(rrb.Grid(*panels, name=f"step [s] over {words}"))
    if found.modes:
        drift = rrb.TimeSeriesView(
            name="log10 of the energy off its start, as a share", origin=entity(found.scene, "drift")
        )
        panels = [plane.view(words) for words, plane in _growth(found).items()]
        tabs += [rrb.Vertical(*panels, name="one mode"), rrb.Vertical(drift, name="energy over many steps")]
    return tabs


def _maps(found: Mapped) -> list[tuple[str, str]]:
    return sorted({(row.axis, row.solver) for row in found.sweep.rows})


def _own(found: Mapped, axis: str, solver: str) -> list[Row]:
    return sorted((row for row in found.sweep.rows if (row.axis, row.solver) == (axis, solver)), key=place_of)


def _map(found: Mapped, axis: str, solver: str) -> Plane:
    """Decades around all points of this kind of map, so that panels can be compared."""
    rows = [row for row in found.sweep.rows if row.axis == axis]
    x, y = decades(map(place_of, rows)), decades(point.dt for row in rows for point in row.points)
    return Plane((found.scene, axis, solver), x, y, room=LEGEND)


def _log_map(recording: Any, plane: Plane, rows: Sequence[Row]) -> None:
    """A dot a point in the colour of its class, which a click names; the limit that the solver states."""
    plane.draw_grid(recording)
    for outcome, shade in SHADES.items():
        own = [(row, point) for row in rows for point in row.points if point.outcome == outcome]
        if own:
            points = plane.at(logs([place_of(row) for row, _ in own]), logs([point.dt for _, point in own]))
            plane.draw_dots(recording, ("classes", outcome), points, shade, [_said(row, point) for row, point in own])
    for i, outcome in enumerate(SHADES):
        at = plane.at([plane.x[1] + 1.0], [plane.y[1] - 0.5 * i])
        plane.draw_dots(recording, ("legend", outcome), at, SHADES[outcome])
        plane.draw_words(recording, ("legend", outcome, "name"), at, [outcome])
    limits = [
        plane.at(logs([place_of(row)] * 2) + HALF_WIDTH, logs([row.limit] * 2))
        for row in rows
        if math.isfinite(row.limit) and row.limit > 0.0
    ]
    if limits:
        plane.draw_rule(recording, ("stated limit",), limits)


def _said(row: Row, point: Any) -> str:
    words = f"{point.outcome}: step {point.dt:.3g} s at {place_of(row):.3g}"
    return words + (f", error {point.error:.2g}" if math.isfinite(point.error) else "")


def _growth(found: Mapped) -> dict[str, Plane]:
    """The planes of what a step does to a mode, by their words; the exact values are all 1."""
    h = [value for modes in found.modes for value in modes.amplification.h]
    names = {"growth": "growth of a step over omega dt (exact: 1)", "frequency": "frequency over the exact one"}
    return {
        words: Plane((found.scene, "mode", name), decades(h), decades(_figures(found, name)), wide=2.0)
        for name, words in names.items()
    }


def _figures(found: Mapped, name: str) -> list[float]:
    return [value for modes in found.modes for value in _values(modes, name)[1]]


def _values(modes: Modes, name: str) -> tuple[Any, Any]:
    """omega dt and what was measured there, both (m,), where anything was; growth beyond 1e3 is drawn there."""
    one = modes.amplification
    values = np.clip(one.size if name == "growth" else one.frequency, 1e-3, 1e3)
    seen = np.isfinite(values)
    return one.h[seen], values[seen]


def _log_modes(recording: Any, found: Mapped) -> None:
    import rerun as rr

    if not found.modes:
        return
    for plane in _growth(found).values():
        plane.draw_grid(recording)
        for i, modes in enumerate(found.modes):
            h, values = _values(modes, plane.place[-1])
            if len(h):
                solver = modes.drift.solver
                plane.draw_line(recording, (solver,), plane.at(logs(h), logs(values)), colour(i), solver)
    for i, modes in enumerate(found.modes):
        drift = modes.drift
        at = rr.TimeColumn(STEPS, sequence=drift.steps[1:].astype(np.int64))
        values = logs(np.clip(np.abs(drift.change[1:]), 0.0, 1e3))
        log_curve(recording, entity(found.scene, "drift", drift.solver), drift.solver, colour(i), at, values)
