"""What `nuno bench peers` found, as a page, a table for the screen and documentation, and JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from nuno_bench.peers.plot import error_over_time
from nuno_bench.peers.process import Point
from nuno_bench.peers.table import Kind
from nuno_bench.report import markdown, page
from nuno_bench.report.result import number
from nuno_bench.speed.steps.stiff import CENTRE, REFERENCE, SCENE, STRAIN

HEADINGS = ("peer", "setting", "off [mm]", "strain", "peak", "time [s]", "min - max", "start [s]", "verdict")
NOTES = ("peer", "setting", "note")
PACKAGES = {"mujoco": ("mujoco",), "newton": ("newton", "warp-lang"), "scipy": ("scipy",)}
LEAD = (
    f"A second of the scene {SCENE}: 64 x 64 vertices, springs of 1000, 300 and 20 N/m, let go at 45 degrees, held "
    "at two corners. Each engine in a process of its own, at steps from coarse to fine."
)
JUDGED = (
    f"Accurate is a centre of mass within {1e3 * CENTRE:g} mm and a mean strain within {STRAIN:.0%} of the converged "
    f"run ({REFERENCE[0].removeprefix('solver={').removesuffix('}')}). Off: the centre of mass. Strain: the springs' "
    "mean, as a share of that run's. Peak: the largest strain of any spring. Time: the median over the repeats of the "
    "simulated second. Start, from an empty process to the first step with all that is compiled, is in no time. A "
    "setting is not repeated once it has used a third of its limit."
)


@dataclass(frozen=True)
class Found:
    """All points, what is left out and why, and the wall time of the converged run [s]."""

    kinds: Sequence[Kind]
    points: Sequence[Point]
    left_out: Sequence[str]
    exact_seconds: float


def accurate(point: Point) -> bool:
    score = point.score
    return score is not None and score.centre <= CENTRE and abs(score.strain - 1.0) <= STRAIN


def best(points: Iterable[Point]) -> Point | None:
    """The fastest that is accurate."""
    return min((point for point in points if accurate(point)), key=lambda point: point.median, default=None)


def rows(found: Found) -> list[list[str]]:
    """One row of text per point, under HEADINGS."""
    chosen = [best(point for point in found.points if point.kind == kind.name) for kind in found.kinds]
    return [_row(point, any(point is each for each in chosen)) for point in found.points]


def _row(point: Point, chosen: bool) -> list[str]:
    start = number(round(point.start, 2)) if point.start is not None else ""
    if point.score is None:
        return [point.kind, point.setting, "", "", "", "", "", start, "failed"]
    low, high = min(point.seconds), max(point.seconds)
    spread = f"{number(low)} - {number(high)}" if len(point.seconds) > 1 else "once"
    verdict = ("best of its kind" if chosen else "accurate") if accurate(point) else "not accurate"
    score = (number(1e3 * point.score.centre), number(round(point.score.strain, 3)), number(round(point.score.peak, 4)))
    return [point.kind, point.setting, *score, number(point.median), spread, start, verdict]


def notes(found: Found) -> list[list[str]]:
    """Why a point failed, and what an engine says of its run."""
    told = [(point, point.failure or point.remark) for point in found.points]
    return [[point.kind, point.setting, text] for point, text in told if text]


def verdicts(found: Found) -> list[str]:
    """The fastest of ours and of theirs, and who reaches the accuracy at no setting."""
    own = best(point for point in found.points if point.kind.startswith("nuno-"))
    other = best(point for point in found.points if not point.kind.startswith("nuno-"))
    texts = []
    for whose, point in (("Ours", own), ("Of the others", other)):
        if point is not None:
            texts.append(f"{whose}: {point.kind} ({point.setting}) is accurate in {number(point.median)} s.")
    if own is not None and other is not None:
        texts.append(f"That is {number(other.median / own.median)} times faster.")
    measured = {point.kind for point in found.points}
    never = [
        k.name for k in found.kinds if k.name in measured and best(p for p in found.points if p.kind == k.name) is None
    ]
    return texts + ([f"Accurate and done at no setting shown: {', '.join(never)}."] if never else [])


def tables(found: Found) -> dict[str, page.Table]:
    """All that is found, under the headings of the page."""
    posed = page.Table(("peer", "what it is given"), [[kind.name, kind.posed] for kind in found.kinds],
                       "Material and method.", prose=True)  # fmt: skip
    parts = {"All settings": page.Table(HEADINGS, rows(found), JUDGED)}
    if told := notes(found):
        parts["Notes"] = page.Table(NOTES, told, "Failures, and what engines say.", prose=True)
    return parts | {"What each is given": posed}


def sections(found: Found) -> list[str]:
    """Parts for the documentation."""
    parts = [" ".join([*verdicts(found), *(f"{text}." for text in found.left_out)])]
    for table in tables(found).values():
        parts += [table.caption, markdown.table(table.headings, table.rows)]
    return parts


def versions(packages: Iterable[str]) -> str:
    names = [name for package in dict.fromkeys(packages) for name in PACKAGES.get(package, (package,))]
    return ", ".join(f"{name} {version(name)}" for name in names) or "none"


def data(found: Found, about: Mapping[str, str]) -> dict[str, Any]:
    """All that was found, for JSON."""
    points = [asdict(p) | {"accurate": accurate(p), "median": p.median if p.seconds else None} for p in found.points]
    judged = {"centre_of_mass_m": CENTRE, "mean_strain": STRAIN, "reference": REFERENCE[0]}
    return {
        "about": dict(about), "accuracy": judged | {"reference_seconds": found.exact_seconds}, "points": points,
        "left_out": list(found.left_out), "posed": {kind.name: kind.posed for kind in found.kinds},
    }  # fmt: skip


def write(base: Path, found: Found, about: Mapping[str, str]) -> tuple[Path, Path]:
    """Page and JSON."""
    html, raw = base.with_name(f"{base.name}.html"), base.with_name(f"{base.name}.json")
    raw.write_text(json.dumps(data(found, about), indent=1) + "\n", encoding="utf-8")
    caption = (
        f"Line across: {1e3 * CENTRE:g} mm, which is accurate enough. Hollow: the mean strain is off by more than "
        f"{STRAIN:.0%}. Solid curves: ours. Bars across: all repeats. Crosses above: failed, at the time taken, or "
        "at the left edge where none was."
    )
    parts: list[tuple[str, Sequence[page.Part]]] = [
        ("", [" ".join(verdicts(found)), page.Figure(error_over_time(found.points), caption)]),
        *((heading, [table]) for heading, table in tables(found).items()),
        *([("Left out", list(found.left_out))] if found.left_out else []),
        ("Made by", [page.Facts(about)]),
    ]
    html.write_text(page.render("The stiff sheet in other engines", LEAD, parts), encoding="utf-8")
    return html, raw
