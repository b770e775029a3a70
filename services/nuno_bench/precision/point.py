"""One measured setting of one solver."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field

from pydantic import TypeAdapter

from nuno_bench.precision.errors import Error

DONE = "done"


@dataclass(frozen=True)
class Point:
    """One setting of one solver, measured.

    outcome  "done", "diverged", "unconverged", "ran away", "refused" (by the solver), "failed" (the solver itself),
             "cut" (out of time)
    seconds  of each repeat, in the solver's own calls [s]
    finer    the step [s], of an adaptive solver the tolerance
    share    of the stability limit that the step is, None where there is no step or nothing limits it
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
    share: float | None = None

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


POINT = TypeAdapter(Point)
"""Reads what dataclasses.asdict made, in which a number that is not finite may be text."""
