"""A comparison of engines as values for a page, the screen, the documentation and JSON; and that of the sheet."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, ClassVar, Generic

import numpy as np

from nuno_bench.peers.problem import CENTRE, REFERENCE, SCENE, STRAIN, SheetScore
from nuno_bench.peers.process import Engine, EnginePoint, S
from nuno_bench.report.page import Figure, Part, Report, Sections, Table, number, spread_of
from nuno_bench.report.plots import INK, Curve, Panel, draw, marker_of

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
class Comparison(Generic[S]):
    """Points of several engines on one problem, and what is left out and why; how they are shown.

    A subclass has `title`, `judged`, a text on how points are judged, and the columns `measures` of a point's score.
    """

    kinds: Sequence[Engine]
    points: Sequence[EnginePoint[S]]
    left_out: Sequence[str]
    title: ClassVar[str]
    judged: ClassVar[str]
    measures: ClassVar[tuple[str, ...]]
    judgement: ClassVar[tuple[str, ...]] = ("times ours", "verdict")

    @property
    def seconds(self) -> float:
        """Simulated time, over which wall times are shown [s]."""
        return 1.0

    @abstractmethod
    def cells(self, score: S) -> list[str]:
        """Return the texts under `measures`."""

    def no_worse(self, one: S, other: S) -> bool:
        """Return whether a score is at least as good as another, unless a subclass knows better: yes."""
        return True

    @abstractmethod
    def verdicts(self) -> list[str]:
        """Return sentences on the fastest points."""

    @abstractmethod
    def report(self, about: Mapping[str, str]) -> Report:
        """Return the page, the data and the documentation's section."""

    def tables(self) -> list[Table]:
        """Return what is shown on the screen."""
        return [self.settings()]

    def of(self, kind: Engine) -> list[EnginePoint[S]]:
        """Return the points of a kind, from coarse to fine."""
        return [point for point in self.points if point.kind == kind.name]

    def settings(self) -> Table:
        """Return a table with a row per point."""
        heads = ("peer", "setting", *self.measures, "time [s]", "min - max", "start [s]", *self.judgement)
        rows = []
        for point in self.points:
            start, score = number(round(point.start, 2)) if point.start is not None else "", point.score
            cells, judged = [""] * (len(self.measures) + 2), [""] * (len(self.judgement) - 1) + ["failed"]
            if score is not None:
                rates = [seconds / self.seconds for seconds in point.seconds]
                cells = [*self.cells(score), number(float(np.median(rates))), spread_of(rates)]
                judged = self.judge(point)
            rows.append([point.kind, point.setting, *cells, start, *judged])
        return Table(heads, rows, self.judged)

    def times_ours(self, point: EnginePoint[S]) -> float | None:
        """Return how many times as long another engine takes as our fastest whose score is no worse than its.

        None for ours, for what has no score, and where none of ours is as good; that one is faster is not said then.
        """
        if (score := point.score) is None or is_ours(point):
            return None
        own = fastest(filter(is_ours, self.points), lambda one: self.no_worse(one, score))
        return point.median / own.median if own is not None else None

    def judge(self, point: EnginePoint[S]) -> list[str]:
        """Return the texts under `judgement` of a point with a score: the bar is to take longer than ours."""
        if is_ours(point) or all(point.kind != kind.name for kind in self.kinds):
            return ["", ""]
        times, verdict = self.times_ours(point), ""
        if any(is_ours(one) and one.score is not None for one in self.points):
            verdict = "bar met" if times is not None and times > 1.0 else "missed"
        return [number(times) if times is not None else "", verdict]

    def notes(self) -> Table:
        """Return why points failed, and what engines say of their runs."""
        noted = [[point.kind, point.setting, point.failure or point.remark] for point in self.points]
        rows = [row for row in noted if row[-1]]
        return Table(("peer", "setting", "note"), rows, "Failures, and what engines say.", prose=True)

    def compose(
        self, lead: str, sections: Sections, brief: Sequence[Part], about: Mapping[str, str], **data: Any
    ) -> Report:
        """Add what all comparisons have to a comparison's own sections, data and parts of the documentation's section.

        The first section begins with the verdicts.
        """
        posed = Table(("peer", "what it is given"), [[kind.name, kind.posed] for kind in self.kinds],
                      "Material and method.", prose=True)  # fmt: skip
        after = ("Notes", [self.notes()]), ("What each is given", [posed]), ("Left out", self.left_out)
        said = " ".join([*self.verdicts(), *(f"{text}." for text in self.left_out)])
        (_, first), *others = sections
        sections = [("", [" ".join(self.verdicts()), *first]), *others, *after]
        own = {"points": list(map(plain, self.points)), "left_out": self.left_out}
        own |= {"posed": {kind.name: kind.posed for kind in self.kinds}} | data
        return Report(self.title, lead, sections, about, own, [said, *brief, self.notes(), posed])


def fastest(points: Iterable[EnginePoint[S]], fits: Callable[[S], bool]) -> EnginePoint[S] | None:
    """Return the fastest of those that have a score, and one that fits."""
    kept = (point for point in points if point.score is not None and fits(point.score))
    return min(kept, key=lambda point: point.median, default=None)


def is_ours(point: EnginePoint[Any]) -> bool:
    return point.kind.startswith("nuno-")


def plain(point: EnginePoint[Any]) -> dict[str, Any]:
    """A point for JSON."""
    return vars(point) | {"median": point.median if point.seconds else None}


def versions(packages: Iterable[str]) -> str:
    names = [name for package in dict.fromkeys(packages) for name in PACKAGES.get(package, (package,))]
    return ", ".join(f"{name} {version(name)}" for name in names) or "none"


@dataclass(frozen=True)
class SheetComparison(Comparison[SheetScore]):
    """The comparison on the stiff sheet; exact_seconds: wall time of the converged run [s]."""

    exact_seconds: float
    title: ClassVar[str] = "The stiff sheet in other engines"
    judged: ClassVar[str] = JUDGED
    measures: ClassVar[tuple[str, ...]] = ("off [mm]", "strain", "peak")
    judgement: ClassVar[tuple[str, ...]] = ("verdict",)

    def cells(self, score: SheetScore) -> list[str]:
        return list(map(number, (1e3 * score.centre, round(score.strain, 3), round(score.peak, 4))))

    def best(self, points: Iterable[EnginePoint[SheetScore]]) -> EnginePoint[SheetScore] | None:
        """Return the fastest that is accurate."""
        return fastest(points, lambda score: score.accurate)

    def judge(self, point: EnginePoint[SheetScore]) -> list[str]:
        if point.score is None or not point.score.accurate:
            return ["not accurate"]
        own = [one for one in self.points if one.kind == point.kind]
        return ["best of its kind" if self.best(own) is point else "accurate"]

    def verdicts(self) -> list[str]:
        """The fastest of ours and of theirs, and who reaches the accuracy at no setting."""
        own = self.best(filter(is_ours, self.points))
        other = self.best(point for point in self.points if not is_ours(point))
        texts = [
            f"{whose}: {point.kind} ({point.setting}) is accurate in {number(point.median)} s."
            for whose, point in (("Ours", own), ("Of the others", other)) if point is not None
        ]  # fmt: skip
        if own is not None and other is not None:
            texts.append(f"That is {number(other.median / own.median)} times faster.")
        never = [kind.name for kind in self.kinds if self.of(kind) and self.best(self.of(kind)) is None]
        return texts + ([f"Accurate and done at no setting shown: {', '.join(never)}."] if never else [])

    def error_over_time(self) -> Panel:
        """A curve per kind from coarse to fine; a point without a score stands above the panel."""
        times = [point.median for point in self.points if point.seconds]
        first, last = (min(times), max(times)) if times else (0.1, 1.0)
        curves = [Curve("accurate enough", np.array([first, last]), np.full(2, 1e3 * CENTRE), INK, dashed=True)]
        for i, kind in enumerate(kind for kind in self.kinds if self.of(kind)):
            own = self.of(kind)
            x = np.array([point.median if point.seconds else first for point in own])
            y = np.array([1e3 * point.score.centre if point.score else np.inf for point in own])
            spread = [(min(point.seconds, default=first), max(point.seconds, default=first)) for point in own]
            hollow, dashed = (
                [bool(point.score and point.score.stretched) for point in own],
                not kind.name.startswith("nuno-"),
            )
            curves.append(Curve(kind.name, x, y, i, dashed, marker=marker_of(i), hollow=hollow, spread=spread))
        return Panel("", curves, "wall time of a simulated second [s]", "centre of mass off by [mm]", log="xy")

    def report(self, about: Mapping[str, str]) -> Report:
        figure, table = Figure(draw([self.error_over_time()], height=5.0), CAPTION), self.settings()
        reached = {"centre_of_mass_m": CENTRE, "mean_strain": STRAIN, "reference": REFERENCE}
        points = [plain(point) | {"accurate": bool(point.score and point.score.accurate)} for point in self.points]
        return self.compose(LEAD, [("", [figure]), ("All settings", [table])], [JUDGED, table], about, points=points,
                            accuracy=reached | {"reference_seconds": self.exact_seconds})  # fmt: skip
