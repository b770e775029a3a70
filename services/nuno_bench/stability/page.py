"""Page, CSV and JSON of the stability maps."""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nuno_bench.report import page
from nuno_bench.report.result import number
from nuno_bench.stability import plots
from nuno_bench.stability.case import ACCURATE, CLASSES, EXACT, LOST, ROUGHNESS, RUNAWAY
from nuno_bench.stability.drift import STEPS, Amplification, Drift
from nuno_bench.stability.sweep import Row, Sweep

LEAD = "What each solver makes of the scene at every step and stiffness, above its limit too."
HOW = (
    f"A point is a few frames from a start whose vertices stand up to {ROUGHNESS:g} of the shortest spring off their "
    "places, so that every mode takes part. It is held against an adaptive run at a tight tolerance. It is exact up to "
    f"a distance of {EXACT:g} of how far that run moves, and accurate up to {ACCURATE:g}, unless its energy is off by "
    f"more than that of the motion. Beyond, it is damped away where {LOST:.0%} of that energy is missing, diverged "
    f"where it is not finite or has gained {RUNAWAY:g} times as much, and drifting otherwise. Refused: the solver "
    "itself declined, or did not converge. A scene's own run refuses steps above the line."
)
HOW_DYE = (
    "A point is the beginning of the scene, held against the explicit scheme at fine steps, extrapolated. It is exact "
    f"up to a distance of {EXACT:g} of how far amounts change at most in any cell, and accurate up to {ACCURATE:g}, "
    f"unless more than that of all dye has come or gone. Beyond, it is damped away where {LOST:.0%} of the dye is "
    "missing, diverged where it is not finite, and drifting otherwise: limits on what a cell may hold keep even "
    "unstable steps bounded. Refused: the solver itself declined, or did not converge. A scene's own run refuses steps "
    "above the line."
)
FIELDS = ("axis", "value", "edge", "solver", "limit", "dt", "outcome", "error", "gained", "seconds", "why")
AXES = {
    "stiffness": "stiffness, as a multiple of the scene's",
    "mesh": "shortest spring [mm]",
    "diffusion": "coefficient of diffusion, as a multiple of the scene's",
}


def counts(rows: Sequence[Row]) -> list[list[str]]:
    """Rows of axis, solver, and how many points fell into each class."""
    found: dict[tuple[str, str], Counter[str]] = {}
    for row in rows:
        found.setdefault((row.axis, row.solver), Counter()).update(point.outcome for point in row.points)
    return [
        [axis, solver, *(str(classes[name]) for name in CLASSES)] for (axis, solver), classes in sorted(found.items())
    ]


def beyond(rows: Sequence[Row]) -> list[list[str]]:
    """How the stated limits compare with the maps: points that were lost below, and above, out of all."""
    found: dict[str, list[int]] = {}
    for row in rows:
        if not math.isfinite(row.limit) or row.limit <= 0.0:
            continue
        tally = found.setdefault(row.solver, [0, 0, 0, 0])
        for point in row.points:
            if point.outcome in ("left out", "refused"):
                continue
            above, lost = point.dt > row.limit, point.outcome in LOST_BY.get(row.axis, ("diverged",))
            tally[2 * above] += 1
            tally[2 * above + 1] += lost
    return [[solver, f"{b} of {a}", f"{d} of {c}"] for solver, (a, b, c, d) in sorted(found.items())]


def modes(sizes: Sequence[Amplification], drifts: Sequence[Drift]) -> list[list[str]]:
    """Rows of solver, measured against stated matrix, steps, energy at the end."""
    runs = {drift.solver: drift for drift in drifts}
    rows = []
    for found in sizes:
        drift = runs[found.solver]
        last = f"{drift.steps[-1]:,.0f}" + (f" ({drift.ended})" if drift.ended else "")
        largest = max(abs(float(value)) for value in drift.change)
        rows.append([found.solver, f"{found.stated:.1g}", last, f"{drift.change[-1]:+.2g}", f"{largest:.2g}"])
    return rows


COUNTS = ("map", "solver", *CLASSES)
LOST_BY = {"diffusion": ("damped away", "drifting", "diverged")}
"""Classes in which a point counts as lost, by kind of map: dye is bounded, and never diverges."""
BEYOND = ("solver", "lost below its limit", "lost above it")
MODES = ("solver", "matrix off", "steps", "energy at the end, change", "largest")


def render(
    scene: str, sweep: Sweep, sizes: Sequence[Amplification], drifts: Sequence[Drift], about: Mapping[str, str]
) -> str:
    """The page."""
    sections: list[tuple[str, list[page.Part]]] = []
    for axis, name in AXES.items():
        rows = [row for row in sweep.rows if row.axis == axis]
        if rows:
            caption = f"Classes over {name} and the step. The black line is the limit that each solver states."
            parts: list[page.Part] = [page.Figure(plots.maps(rows, axis, name), caption)]
            sections.append((f"{axis.capitalize()} and step", parts))
    if sections:
        sections[0][1].insert(0, HOW_DYE if sweep.rows[0].axis == "diffusion" else HOW)
        sections.append(
            (
                "Limits",
                [
                    page.Table(
                        BEYOND,
                        beyond(sweep.rows),
                        "Points of all maps. Lost: diverged; of dye, which is bounded, drifting or damped away, too.",
                    )
                ],
            )
        )
        sections.append(("Points", [page.Table(COUNTS, counts(sweep.rows), "Points of each class.")]))
    if sizes:
        text = "Measured by single steps of an undamped oscillator; 1 is exact. Adaptive solvers take the step given."
        figure = page.Figure(plots.amplifications(sizes), text)
        sections.append(("One mode", [figure]))
        text = f"A free net of twelve vertices, undamped, at omega dt = 0.5, over up to {STEPS:,} steps."
        shown = page.Table(MODES, modes(sizes, drifts), "Matrix off: largest difference from the one that is stated.")
        sections.append(("Energy over many steps", [page.Figure(plots.drifts(drifts), text), shown]))
    left: list[page.Part] = [*(sweep.omissions or ["Nothing."])]
    return page.render(f"Stability of {scene}", LEAD, [*sections, ("Left out", left), ("Made by", [page.Facts(about)])])


def write(
    base: Path,
    scene: str,
    sweep: Sweep,
    modes_found: tuple[Sequence[Amplification], Sequence[Drift]],
    about: Mapping[str, str],
) -> list[Path]:
    """Write page, CSV and JSON beside each other."""
    html, table, data = (base.with_name(base.name + ending) for ending in (".html", ".csv", ".json"))
    sizes, drifts = modes_found
    html.write_text(render(scene, sweep, sizes, drifts, about), encoding="utf-8")
    with table.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(FIELDS)
        for row in sweep.rows:
            for point in row.points:
                own = vars(point) | {"edge": row.edge, "limit": row.limit}
                writer.writerow([_written(own[name]) for name in FIELDS])
    content: dict[str, Any] = {
        "about": dict(about),
        "omissions": sweep.omissions,
        "rows": [row.json() for row in sweep.rows],
        "amplification": [_lists(vars(found)) for found in sizes],
        "drift": [_lists(vars(found)) for found in drifts],
    }
    data.write_text(json.dumps(_finite(content), indent=1) + "\n", encoding="utf-8")
    return [html, table, data]


def _written(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _lists(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value.tolist() if hasattr(value, "tolist") else value for name, value in values.items()}


def _finite(value: Any) -> Any:
    """JSON has no infinity and no NaN: they are written as text."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def summary(sweep: Sweep) -> str:
    """Points in all, and of each class that occurs."""
    found = Counter(point.outcome for row in sweep.rows for point in row.points)
    kinds = ", ".join(f"{found[name]} {name}" for name in CLASSES if found[name])
    return f"{number(sum(found.values()))} points: {kinds}" if found else "no points"
