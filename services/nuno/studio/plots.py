"""A recording's series as plots: what belongs together, in units that a person reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Float

Series = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Plot:
    """Lines by their names, each a value a row of `t` [s], NaN where there is none."""

    name: str
    title: str
    unit: str
    lines: dict[str, Float]

    def to_json(self) -> dict[str, Any]:
        """As the page takes it: what is not finite is None."""
        lines = {name: [v if np.isfinite(v) else None for v in values.tolist()] for name, values in self.lines.items()}
        return {"name": self.name, "title": self.title, "unit": self.unit, "lines": lines}


@dataclass(frozen=True)
class Kind:
    """Which columns a plot has: those that are named, or all that begin so; by how much each is multiplied."""

    title: str
    unit: str
    columns: dict[str, str] = field(default_factory=dict)
    start: str = ""
    scale: float = 1.0


KINDS = {
    "stretch": Kind("Largest stretch", "%", {"stretch": ""}, scale=100.0),
    "penetration": Kind("Depth inside bodies", "mm", {"depth": "largest", "mean": "mean of those inside"}, scale=1e3),
    "crossings": Kind("Edges through cloth", "edges", {"crossings": ""}),
    "distance": Kind("Least distance of cloth from cloth", "mm", {"distance": ""}, scale=1e3),
    "wrinkles": Kind("Wrinkles", "mm", start="wrinkles_", scale=1e3),
    "force": Kind("Force on bodies", "N", start="force_"),
    "pressure": Kind("Largest pressure on bodies", "Pa", start="pressure_"),
    "mobile": Kind("Mobile dye", "full cells", start="mobile_"),
    "fixed": Kind("Fixed dye", "full cells", start="fixed_"),
}


def plots_of(series: Series) -> list[Plot]:
    """Energy, stretch, and so on, of `Recording.series`: what the recording has, and is not 0 throughout."""
    found = [_energy(series)]
    for name, kind in KINDS.items():
        columns = kind.columns or {
            one: one.removeprefix(kind.start).replace("_", " ") for one in series if one.startswith(kind.start)
        }
        lines = {said: kind.scale * series[one].astype(np.float64) for one, said in columns.items() if one in series}
        found.append(Plot(name, kind.title, kind.unit, lines))
    found.append(_speed(series))
    return [plot for plot in found if any(np.nan_to_num(values).any() for values in plot.lines.values())]


def _energy(series: Series) -> Plot:
    """Kinds of energy that are not 0 throughout, and their sum."""
    columns = {
        name.removeprefix("energy_").replace("_", " "): v.astype(np.float64)
        for name, v in series.items()
        if name[:7] == "energy_"
    }
    lines = {name: values for name, values in columns.items() if values.any()}
    if len(lines) > 1:
        lines["total"] = np.sum(list(columns.values()), axis=0)
    return Plot("energy", "Energy", "J", lines)


def _speed(series: Series) -> Plot:
    """Simulated time of each frame after the first by the wall time of its steps."""
    lines = {}
    if "step_seconds" in series and "t" in series:
        seconds = series["step_seconds"].astype(np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            lines[""] = np.where(seconds > 0.0, np.diff(series["t"], prepend=np.nan) / seconds, np.nan)
    return Plot("speed", "Speed of the solver alone", "× real time", lines)
