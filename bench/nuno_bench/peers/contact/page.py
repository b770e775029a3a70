"""What `nuno bench peers contact` found, as values for a page, the screen, the documentation and JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from nuno_bench.peers.contact.problem import ASKED, ASKING, LEAD, Answer, Seen
from nuno_bench.peers.page import Measured, against, compose
from nuno_bench.peers.process import Point, fastest, times_ours
from nuno_bench.report.page import Part, Report, Sections, Table, number, spread_of

HEADINGS = (
    "peer", "setting", "crossed", "stretch [%]", "height [mm]", "time [s]", "min - max", "start [s]", "times ours",
    "verdict",
)  # fmt: skip
QUERIES = ("question", "of ours", "time [ms]", "min - max", "of ipctk", "time [ms]", "min - max", "times ours")
JUDGED = (
    "Crossed: published frames, of 60, in which ipctk finds an edge that goes through a triangle. Stretch: the most of "
    "any edge in any frame. Height: of the centre of mass at the end. Time: the median over the repeats of the "
    "simulated second. Start, from a fresh process to the end of the first frame with all that is compiled, is in no "
    "time. Times ours: over that of our fastest with no more frames crossed; the bar is met where it is above 1. A "
    "setting is not repeated once it has used a third of its limit."
)


@dataclass(frozen=True)
class Found(Measured[Seen]):
    """Of the pile; and what ipctk and ours take to answer questions."""

    answers: Sequence[Answer]


def best(points: Iterable[Point[Seen]], most: int) -> Point[Seen] | None:
    """The fastest of those that have a score, with no more frames crossed."""
    return fastest(points, lambda seen: len(seen.crossed) <= most)


def ratio(found: Found, point: Point[Seen]) -> float | None:
    """How many times as long another engine takes as our fastest with no more frames crossed: see times_ours."""
    most = len(point.score.crossed) if point.score is not None else 0
    return times_ours(found.points, point, lambda seen: len(seen.crossed) <= most)


def settings(found: Found) -> Table:
    """One row of text per point."""
    return Table(HEADINGS, [_row(found, point) for point in found.points], JUDGED)


def _row(found: Found, point: Point[Seen]) -> list[str]:
    start, seen = number(round(point.start, 2)) if point.start is not None else "", point.score
    if seen is None:
        return [point.kind, point.setting, "", "", "", "", "", start, "", "failed"]
    figures = (len(seen.crossed), 100 * seen.stretch, 1e3 * seen.height, point.median)
    return [point.kind, point.setting, *map(number, figures), spread_of(point.seconds), start,
            *against(found.points, point, ratio(found, point))]  # fmt: skip


def tables(found: Found) -> list[Table]:
    """What is shown on the screen."""
    return [settings(found), queries(found)]


def verdicts(found: Found) -> list[str]:
    """Our fastest with the fewest frames crossed, and of each other kind the same beside it."""
    texts = []
    for kind in found.kinds:
        points = [point for point in found.of(kind) if point.score is not None]
        if not points:
            continue
        fewest = min(len(point.score.crossed) for point in points if point.score is not None)
        if (one := best(points, fewest)) is None:
            continue
        times = ratio(found, one)
        beside = f", {number(times)} times as long as ours" if times is not None else ""
        passed = f"cloth through cloth in {fewest} of {one.score.frames} frames" if one.score else ""
        texts.append(f"{one.kind} ({one.setting}): {number(one.median)} s{beside}, {passed}.")
    return texts


def queries(found: Found) -> Table:
    """One row of text per question."""
    rows = [
        [one.question, ASKED[one.question][0], number(median(one.ours)), spread_of(one.ours),
         ASKED[one.question][1], number(median(one.theirs)), spread_of(one.theirs),
         number(median(one.theirs) / median(one.ours))]
        for one in found.answers
    ]  # fmt: skip
    return Table(QUERIES, rows, ASKING)


def report(found: Found, about: Mapping[str, str]) -> Report:
    """The page, the data and the documentation's section."""
    table, asked = settings(found), queries(found)
    sections: Sections = [
        ("", [" ".join(verdicts(found))]),
        ("All settings", [table]),
        ("Questions that ipc-toolkit answers, too", [asked]),
    ]
    brief: list[Part] = [LEAD, table, JUDGED, asked, ASKING if asked.rows else ""]
    title = "Cloth that meets cloth in other engines"
    return compose(found, title, LEAD, sections, brief, about, answers=found.answers)
