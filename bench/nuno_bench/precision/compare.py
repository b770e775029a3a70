"""`nuno bench compare A.json B.json`: what changed between two sweeps, beyond what repeats and the floor allow."""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nuno.runtime.consistency import NOTHING, Premises
from nuno_bench import machine, options
from nuno_bench.precision.sweep import ABOVE, POINT, SolverPoint
from nuno_bench.report.page import Report, Table, apart, factor, number
from nuno_schemas.errors import BadInput

SAME_ERROR = 1.01
"""The same solver repeats its errors to the bit; another machine's rounding may move them less than this."""
CHOSEN = ("solver.", "accuracy", "dye.solver.")
"""Fields of the scene's own solver, beside which a sweep has all others."""
HARMLESS = ("version ", "decided", "description", "view.", "record.")
"""Premises that may differ: versions are what is compared, and the others move nothing."""
SIZE = "size and duration"
NAMED = 5
"""Most premises that a sentence names."""
HEADINGS = (
    "solver", "setting", "changed", "quantity", "error A", "error B", "B / A", "time A [s]", "time B [s]", "B / A",
)  # fmt: skip


@dataclass(frozen=True)
class SweepResult:
    """A sweep as it was written: its points by solver and setting, its floors by quantity.

    premises  the scene's values by field, which older results lack, and its size and duration in words, `SIZE`
    """

    scene: str
    premises: Premises
    points: Mapping[tuple[str, str], SolverPoint]
    floors: Mapping[str, float]
    about: Mapping[str, str]


@dataclass(frozen=True)
class PointChange:
    """A point in both results: its errors and times in A and in B, where it has any.

    quantity  that whose error changed most
    changed   "outcome", "error", "time": those that changed beyond floor and spread
    """

    key: tuple[str, str]
    quantity: str
    errors: tuple[float, float] | None
    times: tuple[float, float] | None
    changed: tuple[str, ...]

    def row(self) -> list[str]:
        """Return the texts under HEADINGS."""
        errors = [f"{error:.2e}" for error in self.errors or ()] or ["", ""]
        times = [number(seconds) for seconds in self.times or ()] or ["", ""]
        ratios = [number(pair[1] / pair[0]) if pair and pair[0] else "" for pair in (self.errors, self.times)]
        return [*self.key, ", ".join(self.changed), self.quantity, *errors, ratios[0], *times, ratios[1]]


def compare_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("first", type=Path, metavar="A.json", help="written by nuno bench precision")
    parser.add_argument("second", type=Path, metavar="B.json", help="another of the same scene")
    options.add_shared(parser, "--html")


def compare_command(args: argparse.Namespace) -> int:
    """Print what changed; a change is a finding, not a failure."""
    first, second = read(args.first), read(args.second)
    if first.scene != second.scene:
        raise BadInput("the results are of two scenes", value=f"{first.scene}, {second.scene}")
    unlike = check_premises(first, second, args.second)
    changes = compare(first, second)
    if not changes:
        raise BadInput("the results have no point in common", value=f"{args.first}, {args.second}")
    if differing := [change.row() for change in changes if change.changed]:
        print(Table(HEADINGS, differing).text())
    said = [*summary(first, second, changes), *unlike]
    print("\n".join(said))
    table = Table(HEADINGS, [change.row() for change in changes], "All points that both have.")
    both = {f"{name}, {k}": v for name, one in (("A", first), ("B", second)) for k, v in one.about.items()}
    about = {"command": machine.command()} | both
    report = Report(f"Two sweeps of {first.scene}", " ".join(said), [("Points", [table])], about, {})
    report.write(args.html, None, None, "")
    return 0


def read(path: Path) -> SweepResult:
    """A result that `nuno bench precision` wrote. Raises BadInput for any other file."""
    try:
        data: Any = json.loads(path.read_text(encoding="utf-8"))
        points = [POINT.validate_python(point) for point in data["points"]]
        floors = {name: float(floor["l2"]) for name, floor in data["reference"]["floors"].items()}
        premises = {**data.get("premises", {}), SIZE: data["about"].get("scene")}
        by_key = {point.key: point for point in points}
        return SweepResult(str(data["scene"]), premises, by_key, floors, dict(data["about"]))
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", str(path)) from None
    except (ValueError, KeyError, TypeError, AttributeError):
        remedy = "give the JSON file that nuno bench precision wrote beside its page"
        raise BadInput("no result of a precision sweep", str(path), remedy=remedy) from None


def check_premises(first: SweepResult, second: SweepResult, file: Path) -> list[str]:
    """Return sentences on what only one scene states, and on different solvers of their own.

    Raises BadInput, with the second result's `file`, for the first field that both state otherwise.
    """
    unlike = []
    for field in {**first.premises, **second.premises}:
        a, b = first.premises.get(field, NOTHING), second.premises.get(field, NOTHING)
        if a == b or field.startswith(HARMLESS):
            continue
        if NOTHING not in (a, b) and not field.startswith(CHOSEN):
            problem, limit = "the results are of two scenes", f"{a!r:.60}, as A has it"
            remedy = "sweep both with the same scene, files, --set and --duration"
            raise BadInput(problem, str(file), field=field, value=b, limit=limit, remedy=remedy)
        unlike.append(f"{field} ({a!r:.60} in A, {b!r:.60} in B)")
    if min(len(first.premises), len(second.premises)) == 1 < len(unlike):
        return ["One of the results, of an older nuno, lacks the scene's fields: only size and duration were compared."]
    more = f" and {len(unlike) - NAMED} more" if len(unlike) > NAMED else ""
    return [f"The scenes differ in {', '.join(unlike[:NAMED])}{more}."] if unlike else []


def compare(first: SweepResult, second: SweepResult) -> list[PointChange]:
    """All points that both have, in the first one's order."""
    floors = {name: max(floor, second.floors.get(name, 0.0)) for name, floor in first.floors.items()}
    return [_change(a, second.points[key], floors) for key, a in first.points.items() if key in second.points]


def _change(a: SolverPoint, b: SolverPoint, floors: Mapping[str, float]) -> PointChange:
    found = {name: (a.errors[name].l2, b.errors[name].l2) for name in a.errors if name in b.errors}
    # An error that both have below the floor is known in neither.
    known = {name: pair for name, pair in found.items() if max(pair) > ABOVE * floors.get(name, 0.0)}
    quantity = max(known, key=lambda name: factor(*known[name]), default="")
    changed = ["outcome"] if a.outcome != b.outcome else []
    if quantity and factor(*known[quantity]) > SAME_ERROR:
        changed.append("error")
    if apart(a.seconds, b.seconds):
        changed.append("time")
    times = (a.median, b.median) if a.seconds and b.seconds else None
    return PointChange(a.key, quantity, known.get(quantity), times, tuple(changed))


def summary(first: SweepResult, second: SweepResult, changes: Sequence[PointChange]) -> list[str]:
    """Sentences: how many points changed in what, the typical time ratio, and what only one has."""
    counts = ", ".join(f"{sum(what in c.changed for c in changes)} in {what}" for what in ("outcome", "error", "time"))
    said = [f"{len(changes)} points in both; changed beyond floor and spread: {counts}."]
    if ratios := [change.times[1] / change.times[0] for change in changes if change.times and change.times[0]]:
        said.append(f"Times of B are {statistics.median(ratios):.2f} times those of A (median over the points).")
    for name, one, other in (("A", first, second), ("B", second, first)):
        if alone := [" ".join(key) for key in one.points if key not in other.points]:
            said.append(f"Only in {name}: {'; '.join(alone)}.")
    return said
