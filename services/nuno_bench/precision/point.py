"""One measured setting of one solver, and those that a sweep has finished."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from nuno_bench.precision.errors import Error
from nuno_bench.sweep import kept

DONE = "done"


@dataclass(frozen=True)
class Point:
    """One setting of one solver, measured.

    outcome  "done", "diverged", "unconverged", "ran away", "refused", "cut" (out of time)
    seconds  of each repeat, in the solver's own calls [s]
    errors   by quantity, where the run reached its end
    history  by quantity, the error at every compared frame but the first, to four digits
    """

    solver: str
    setting: str
    kind: str
    order: int
    finer: float
    beyond: bool
    outcome: str
    message: str
    seconds: tuple[float, ...]
    totals: Mapping[str, int]
    errors: Mapping[str, Error]
    history: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str]:
        return self.solver, self.setting

    @property
    def median(self) -> float:
        return statistics.median(self.seconds) if self.seconds else float("nan")

    @property
    def done(self) -> bool:
        return self.outcome == DONE

    def error(self, quantity: str) -> float | None:
        """Its l2 error in a quantity, None where there is none."""
        return self.errors[quantity].l2 if quantity in self.errors else None

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Point:
        errors = {name: Error(**values) for name, values in data["errors"].items()}
        history = {name: tuple(values) for name, values in data.get("history", {}).items()}
        return Point(**{**data, "seconds": tuple(data["seconds"]), "errors": errors, "history": history})


class Kept:
    """The finished points of a sweep, on disk as they come."""

    def __init__(self, path: Path, identity: Mapping[str, Any], resume: bool) -> None:
        """See nuno_bench.sweep.kept.Kept; a point that was measured again counts as it was last."""
        self._lines = kept.Kept(path, identity, resume)
        self.points = {point.key: point for point in map(Point.from_json, self._lines.lines)}

    @property
    def path(self) -> Path:
        return self._lines.path

    def add(self, point: Point) -> None:
        self._lines.add(asdict(point))
