"""Plots in a rerun file: planes with logarithmic axes, and curves.

rerun has no logarithmic axes and no plots but over a timeline. So a plane's unit is a decade and it draws its own
grid, and curves over a timeline are decimal logarithms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nuno.viewer.layout import CURVES, TIMELINE, entity
from nuno.viewer.require import part_of
from nuno_schemas.fabric import Float

GRID, INK = [205, 209, 215], [40, 43, 48]
LEAST = 1e-17
"""Values below it, such as 0, are drawn there."""
DOT, RULE, LETTER = -4.0, -1.0, -0.1
"""Radii; below 0 they are in points of the screen instead of the plane's units."""


@contextmanager
def written(path: Path, application: str, tabs: Sequence[Any], timeline: str = TIMELINE) -> Iterator[Any]:
    """A recording to log into, which shows `tabs`; its file gets its name when it is whole."""
    import rerun as rr
    import rerun.blueprint as rrb

    recording = rr.RecordingStream(application, send_properties=False)
    panels = (rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed"))
    time = rrb.TimePanel(state="collapsed", timeline=timeline)
    blueprint = rrb.Blueprint(rrb.Tabs(*tabs), *panels, time, auto_views=False, auto_layout=False)
    recording.save(part_of(path), default_blueprint=blueprint)
    yield recording
    recording.flush(timeout_sec=60.0)
    recording.disconnect()
    part_of(path).replace(path)


def colour(i: int) -> list[int]:
    """Of the i-th solver."""
    return CURVES[i % len(CURVES)]


def rgb(name: str) -> list[int]:
    """Of a colour written as #rrggbb."""
    return [int(name[i : i + 2], 16) for i in (1, 3, 5)]


def decades(values: Iterable[float]) -> tuple[int, int]:
    """Whole decades around positive values: exponents of ten; values that are not finite do not count."""
    logs = [math.log10(max(value, LEAST)) for value in values if math.isfinite(value)] or [0.0]
    return math.floor(min(logs)), math.ceil(max(logs))


def logs(values: Sequence[float] | Float) -> Float:
    """log10 of values (m,), none below LEAST."""
    found: Float = np.log10(np.maximum(np.asarray(values, float), LEAST))
    return found


@dataclass(frozen=True)
class Plane:
    """A plane at an entity `place`: exponents of ten from x[0] to x[1] and from y[0] to y[1].

    wide        width of a decade, in heights of one
    unit        of x, written at its decades
    rows        names of rows instead of decades of y: row i is at y = i
    margin      left of the plane, for their names, and `room` right of it, in heights of a decade
    """

    place: tuple[str, ...]
    x: tuple[int, int]
    y: tuple[int, int]
    wide: float = 1.0
    unit: str = ""
    rows: tuple[str, ...] = ()
    margin: float = 1.2
    room: float = 1.2

    def at(self, x: Sequence[float] | Float, y: Sequence[float] | Float) -> Float:
        """(m, 2) places of exponents x and y, (m,) each: rerun's second axis points down."""
        return np.stack([self.wide * np.asarray(x, float), -np.asarray(y, float)], axis=1)

    def view(self, name: str) -> Any:
        import rerun.blueprint as rrb

        across = [self.wide * self.x[0] - self.margin, self.wide * self.x[1] + self.room]
        up = [-self.y[1] - 0.6, -self.y[0] + 0.9]
        bounds = rrb.VisualBounds2D(x_range=across, y_range=up)
        return rrb.Spatial2DView(name=name, origin=entity(*self.place), visual_bounds=bounds,
                                 background=[255, 255, 255])  # fmt: skip

    def draw_grid(self, recording: Any) -> None:
        """Lines at decades, and what they stand for."""
        import rerun as rr

        (left, right), (low, high) = self.x, self.y
        up = [self.at([x, x], [low, high]) for x in range(left, right + 1)]
        across = [self.at([left, right], [y, y]) for y in range(low, high + 1)]
        self._log(recording, ("grid",), rr.LineStrips2D(across + up, colors=GRID, radii=-0.5))
        names = self.rows or [f"1e{y}" for y in range(low, high + 1)]
        marks = [
            (self.at([left], [low + i])[0] - [0.5 * self.margin - 0.25, 0.0], name) for i, name in enumerate(names)
        ]
        marks += [(self.at([x], [low])[0] + [0.0, 0.35], f"1e{x}{self.unit}") for x in range(left, right + 1)]
        at, labels = zip(*marks, strict=True)
        self.draw_words(recording, ("decades",), at, labels)

    def draw_dots(self, recording: Any, what: Sequence[str], points: Float, shade: Sequence[int],
                  labels: Sequence[str] = ()) -> None:  # fmt: skip
        """Dots (m, 2), each with a label for when it is pointed at."""
        import rerun as rr

        dots = rr.Points2D(points, colors=shade, radii=DOT, labels=labels or None, show_labels=False)
        self._log(recording, what, dots)

    def draw_line(self, recording: Any, what: Sequence[str], points: Float, shade: Sequence[int], label: str = "",
                  labels: Sequence[str] = ()) -> None:  # fmt: skip
        """Dots (m, 2), the line through them and its name at its end."""
        import rerun as rr

        self.draw_dots(recording, what, points, shade, labels)
        self._log(recording, (*what, "line"), rr.LineStrips2D([points], colors=shade, radii=RULE))
        if label:
            self.draw_words(recording, (*what, "name"), [points[-1] + [0.15, 0.15]], [label])

    def draw_rule(self, recording: Any, what: Sequence[str], strips: Sequence[Float], label: str = "") -> None:
        """Black lines, each (m, 2), the first with a name."""
        import rerun as rr

        labels = [label, *[""] * (len(strips) - 1)] if label else None
        shown = rr.LineStrips2D(strips, colors=INK, radii=RULE, labels=labels, show_labels=bool(label))
        self._log(recording, what, shown)

    def draw_words(self, recording: Any, what: Sequence[str], at: Any, words: Sequence[str]) -> None:
        import rerun as rr

        shown = rr.Points2D(np.array(at), colors=INK, radii=LETTER, labels=list(words), show_labels=True)
        self._log(recording, what, shown)

    def _log(self, recording: Any, what: Sequence[str], shown: Any) -> None:
        recording.log(entity(*self.place, *what), shown, static=True)


def log_curve(recording: Any, place: str, label: str, shade: Sequence[int], at: Any, values: Float) -> None:
    """A curve over a timeline: `at` is its rerun.TimeColumn, values (m,) what is drawn."""
    import rerun as rr

    recording.log(place, rr.SeriesLines(names=label, colors=shade), static=True)
    recording.send_columns(place, [at], rr.Scalars.columns(scalars=values))
