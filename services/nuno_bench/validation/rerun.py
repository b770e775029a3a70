"""What `nuno validate` measured as a rerun file: the error of every law and solver, and convergence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nuno_bench.report.planes import Plane, colour, decades, logs, rgb, written
from nuno_bench.report.plots import BAD
from nuno_bench.validation.laws.base import Outcome
from nuno_bench.validation.page import fitted, short
from nuno_bench.validation.suite import Part

ERRORS = "error over what is allowed"
MARGIN = 6.0
"""Room on the left for the names of the laws, in decades."""
SHORTEST = -12
"""Smaller shares of what is allowed, such as 0, are drawn there (log10)."""


def write(path: Path, parts: Sequence[Part], outcomes: Sequence[Outcome]) -> Path:
    """Log everything into one file, which gets its name when it is whole, with the views that show it."""
    import rerun.blueprint as rrb

    laws = [_plane(part, part.own(outcomes)) for part in parts]
    orders = [(part, case.name) for part in parts for case in part.cases if fitted(case.name, outcomes)]
    planes = [_convergence(name, outcomes) for _, name in orders]
    tabs = [rrb.Vertical(plane.view(ERRORS), name=" of ".join(plane.place)) for plane in laws]
    tabs += [rrb.Vertical(plane.view(f"{plane.place[0]}: error over the step [s]"), name=plane.place[0])
             for plane in planes]  # fmt: skip
    with written(path, "nuno validate", tabs) as recording:
        for part, plane in zip(parts, laws, strict=True):
            _log_laws(recording, plane, part, part.own(outcomes))
        for (part, name), plane in zip(orders, planes, strict=True):
            _log_convergence(recording, plane, name, part.solvers, outcomes)
    return path


def _share(outcome: Outcome) -> float:
    """log10 of the error as a share of what is allowed."""
    found = outcome.found
    if found is None or not math.isfinite(found.error):
        return 3.0
    return min(3.0, max(float(SHORTEST), float(logs([found.error / found.allowed])[0])))


def _plane(part: Part, outcomes: Sequence[Outcome]) -> Plane:
    names = tuple(case.name for case in reversed(part.cases))
    low = min((math.floor(_share(o)) for o in outcomes if o.verdict != "unsupported"), default=-1)
    high = max((math.ceil(_share(o)) for o in outcomes if o.verdict != "unsupported"), default=1)
    return Plane(
        ("laws", part.of), (low, max(1, high)), (0, len(names) - 1), 3.0, rows=names, margin=MARGIN, room=MARGIN
    )


def _log_laws(recording: Any, plane: Plane, part: Part, outcomes: Sequence[Outcome]) -> None:
    """A row a law; a dot a solver, in its colour, or in that of failure; right of the line a law is broken."""
    plane.draw_grid(recording)
    plane.draw_rule(recording, ("allowed",), [plane.at([0.0, 0.0], plane.y)], "allowed")
    rows = {name: i for i, name in enumerate(plane.rows)}
    # Solvers stand a little apart in a law's row, so that equal errors do not hide each other.
    apart = {name: 0.5 * (i + 0.5) / len(part.solvers) - 0.25 for i, name in enumerate(part.solvers)}
    for i, solver in enumerate(part.solvers):
        own = [o for o in outcomes if o.solver == solver and o.verdict != "unsupported"]
        at = plane.at([plane.x[1] + 0.6], [plane.y[1] - i])
        plane.draw_line(recording, ("solvers", solver), at, colour(i), solver)
        for failed in (False, True):
            shown = [o for o in own if (o.verdict != "passed") == failed]
            if not shown:
                continue
            points = plane.at([_share(o) for o in shown], [rows[o.case] - apart[solver] for o in shown])
            shade = rgb(BAD) if failed else colour(i)
            what = (solver, "failed") if failed else (solver,)
            plane.draw_dots(recording, what, points, shade, [_said(o) for o in shown])


def _said(outcome: Outcome) -> str:
    figure = short(outcome.found.error) if outcome.found else outcome.reason
    return f"{outcome.case}, {outcome.solver}: {outcome.verdict}, {figure}"


def _convergence(case: str, outcomes: Sequence[Outcome]) -> Plane:
    series = [found.series for _, found in fitted(case, outcomes)]
    x, y = ([value for one in series for value in one[name]] for name in ("dt", "error"))
    return Plane((case,), decades(x), decades(y), 2.0, " s")


def _log_convergence(
    recording: Any, plane: Plane, case: str, solvers: Sequence[str], outcomes: Sequence[Outcome]
) -> None:
    plane.draw_grid(recording)
    for solver, found in fitted(case, outcomes):
        points = plane.at(logs(found.series["dt"]), logs(found.series["error"]))
        label = f"{solver}: {found.measured:.2f}"
        plane.draw_line(recording, (solver,), points, colour(list(solvers).index(solver)), label)
