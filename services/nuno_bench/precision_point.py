"""One measured setting of one solver, and the file that keeps them line by line while a sweep goes on."""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from nuno_bench.precision_errors import Error
from nuno_schemas.errors import BadInput

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
    """The file of finished points, a JSON object a line, the first of which says what they belong to."""

    def __init__(self, path: Path, identity: Mapping[str, Any], resume: bool) -> None:
        """Raises BadInput where there is nothing to go on from, or it is another sweep's."""
        self.path = path
        self.points: dict[tuple[str, str], Point] = {}
        if resume:
            self._read(identity)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(dict(identity)) + "\n", encoding="utf-8")

    def _read(self, identity: Mapping[str, Any]) -> None:
        if not self.path.is_file():
            raise BadInput("there is no sweep to go on with", str(self.path), remedy="leave --resume out")
        head, *lines = self.path.read_text(encoding="utf-8").split("\n")
        before = _object(head) or {}
        other = [name for name, value in identity.items() if before.get(name) != value]
        if other:
            remedy = "leave --resume out, or give another --out"
            raise BadInput(
                "these points belong to another sweep", str(self.path), value=", ".join(other), remedy=remedy
            )
        # The last line may be half written; its point is measured again.
        whole = [data for line in lines if (data := _object(line)) is not None]
        found = [Point.from_json(data) for data in whole]
        self.points = {point.key: point for point in found}
        self.path.write_text("\n".join([head, *map(json.dumps, whole)]) + "\n", encoding="utf-8")

    def add(self, point: Point) -> None:
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(asdict(point)) + "\n")


def _object(line: str) -> dict[str, Any] | None:
    try:
        data = json.loads(line)
    except ValueError:
        return None
    return data if isinstance(data, dict) else None
