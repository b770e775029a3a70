"""What `nuno bench peers` found, as values for a page, the screen, the documentation and JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Generic

import numpy as np

from nuno_bench.peers.problem import CENTRE, REFERENCE, SCENE, STRAIN, Score
from nuno_bench.peers.process import Kind, Point, S, fastest, is_ours
from nuno_bench.report.page import Figure, Part, Report, Sections, Table, number, spread_of
from nuno_bench.report.plots import INK, Curve, Panel, draw, marker_of

HEADINGS = ("peer", "setting", "off [mm]", "strain", "peak", "time [s]", "min - max", "start [s]", "verdict")
PACKAGES = {"newton": ("newton", "warp-lang")}
LEAD = (
    f"A second of the scene {SCENE}: 64 x 64 vertices, springs of 1000, 300 and 20 N/m, let go at 45 degrees, held "
    "at two corners. Each engine in a process of its own, at steps from coarse to fine."
)
JUDGED = (
    f"Accurate is a centre of mass within {1e3 * CENTRE:g} mm and a mean strain within {STRAIN:.0%} of the converged "
    f"run ({REFERENCE}). Off: the centre of mass. Strain: the springs' mean, as a share of that run's. Peak: the "
    "largest strain of any spring. Time: the median over the repeats of the simulated second. Start, from a fresh "
    "process to the first step with all that is compiled, is in no time. A setting is not repeated once it has used a "
    "third of its limit."
)
CAPTION = (
    f"Line across: {1e3 * CENTRE:g} mm, which is accurate enough. Hollow: the mean strain is off by more than "
    f"{STRAIN:.0%}. Solid curves: ours. Bars across: all repeats. Crosses above: failed, at the time taken, or at the "
    "left where none was."
)


@dataclass(frozen=True)
class Measured(Generic[S]):
    """What every comparison finds: all points, and what is left out and why."""

    kinds: Sequence[Kind]
    points: Sequence[Point[S]]
    left_out: Sequence[str]

    def of(self, kind: Kind) -> list[Point[S]]:
        """The points of a kind, from coarse to fine."""
        return [point for point in self.points if point.kind == kind.name]


@dataclass(frozen=True)
class Found(Measured[Score]):
    """Of the sheet; and the wall time of the converged run [s]."""

    exact_seconds: float


def accurate(point: Point[Score]) -> bool:
    return point.score is not None and point.score.accurate


def best(points: Iterable[Point[Score]]) -> Point[Score] | None:
    """The fastest that is accurate."""
    return fastest(points, lambda score: score.accurate)


def settings(found: Found) -> Table:
    """One row of text per point."""
    chosen = [best(found.of(kind)) for kind in found.kinds]
    return Table(HEADINGS, [_row(point, any(point is each for each in chosen)) for point in found.points], JUDGED)


def _row(point: Point[Score], chosen: bool) -> list[str]:
    start, score = number(round(point.start, 2)) if point.start is not None else "", point.score
    if score is None:
        return [point.kind, point.setting, "", "", "", "", "", start, "failed"]
    verdict = ("best of its kind" if chosen else "accurate") if accurate(point) else "not accurate"
    figures = (1e3 * score.centre, round(score.strain, 3), round(score.peak, 4), point.median)
    return [point.kind, point.setting, *map(number, figures), spread_of(point.seconds), start, verdict]


def tables(found: Found) -> list[Table]:
    """What is shown on the screen."""
    return [settings(found)]


def notes(points: Sequence[Point[Any]]) -> Table:
    """Why a point failed, and what an engine says of its run."""
    noted = [[point.kind, point.setting, point.failure or point.remark] for point in points]
    rows = [row for row in noted if row[-1]]
    return Table(("peer", "setting", "note"), rows, "Failures, and what engines say.", prose=True)


def given(kinds: Sequence[Kind]) -> Table:
    """What each is given."""
    rows = [[kind.name, kind.posed] for kind in kinds]
    return Table(("peer", "what it is given"), rows, "Material and method.", prose=True)


def against(points: Sequence[Point[Any]], point: Point[Any], times: float | None) -> list[str]:
    """Cells of how many times as long as ours another engine takes, and whether that meets the bar, of more than 1."""
    verdict = ""
    if not is_ours(point) and any(is_ours(one) and one.score is not None for one in points):
        verdict = "bar met" if times is not None and times > 1.0 else "missed"
    return [number(times) if times is not None else "", verdict]


def verdicts(found: Found) -> list[str]:
    """The fastest of ours and of theirs, and who reaches the accuracy at no setting."""
    own = best(filter(is_ours, found.points))
    other = best(point for point in found.points if not is_ours(point))
    texts = [
        f"{whose}: {point.kind} ({point.setting}) is accurate in {number(point.median)} s."
        for whose, point in (("Ours", own), ("Of the others", other)) if point is not None
    ]  # fmt: skip
    if own is not None and other is not None:
        texts.append(f"That is {number(other.median / own.median)} times faster.")
    never = [kind.name for kind in found.kinds if found.of(kind) and best(found.of(kind)) is None]
    return texts + ([f"Accurate and done at no setting shown: {', '.join(never)}."] if never else [])


def error_over_time(found: Found) -> Panel:
    """A curve per kind from coarse to fine; a point without a score stands above the panel."""
    times = [point.median for point in found.points if point.seconds]
    first, last = (min(times), max(times)) if times else (0.1, 1.0)
    curves = [Curve("accurate enough", np.array([first, last]), np.full(2, 1e3 * CENTRE), INK, dashed=True)]
    for i, kind in enumerate(kind for kind in found.kinds if found.of(kind)):
        own = found.of(kind)
        x = np.array([point.median if point.seconds else first for point in own])
        y = np.array([1e3 * point.score.centre if point.score else np.inf for point in own])
        spread = [(min(point.seconds, default=first), max(point.seconds, default=first)) for point in own]
        hollow, dashed = (
            [bool(point.score and point.score.stretched) for point in own],
            not kind.name.startswith("nuno-"),
        )
        curves.append(Curve(kind.name, x, y, i, dashed, marker=marker_of(i), hollow=hollow, spread=spread))
    return Panel("", curves, "wall time of a simulated second [s]", "centre of mass off by [mm]", log="xy")


def versions(packages: Iterable[str]) -> str:
    names = [name for package in dict.fromkeys(packages) for name in PACKAGES.get(package, (package,))]
    return ", ".join(f"{name} {version(name)}" for name in names) or "none"


def compose(
    found: Measured[Any], title: str, lead: str, sections: Sections, brief: Sequence[Part], about: Mapping[str, str],
    **data: Any,
) -> Report:  # fmt: skip
    """A comparison's own sections, of which the first begins with its verdicts, own parts of the documentation's
    section and own data, with what all comparisons have.
    """
    said_of, posed = notes(found.points), given(found.kinds)
    after = ("Notes", [said_of]), ("What each is given", [posed]), ("Left out", found.left_out)
    said = " ".join([str(sections[0][1][0]), *(f"{text}." for text in found.left_out)])
    own = {"points": list(map(plain, found.points)), "left_out": found.left_out}
    own |= {"posed": {kind.name: kind.posed for kind in found.kinds}} | data
    return Report(title, lead, [*sections, *after], about, own, [said, *brief, said_of, posed])


def plain(point: Point[Any]) -> dict[str, Any]:
    """A point for JSON."""
    return vars(point) | {"median": point.median if point.seconds else None}


def report(found: Found, about: Mapping[str, str]) -> Report:
    """The page, the data and the documentation's section."""
    figure, table = Figure(draw([error_over_time(found)], height=5.0), CAPTION), settings(found)
    judged = {"centre_of_mass_m": CENTRE, "mean_strain": STRAIN, "reference": REFERENCE}
    points = [plain(point) | {"accurate": accurate(point)} for point in found.points]
    sections: Sections = [("", [" ".join(verdicts(found)), figure]), ("All settings", [table])]
    return compose(found, "The stiff sheet in other engines", LEAD, sections, [JUDGED, table], about, points=points,
                   accuracy=judged | {"reference_seconds": found.exact_seconds})  # fmt: skip
