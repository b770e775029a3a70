"""A scene run once for each combination of values of its fields: one table, and a picture of each end."""

from __future__ import annotations

import base64
import html
import io
import itertools
import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nuno.api.result import Result, missing
from nuno.api.run import run_loaded
from nuno.api.scene import Scene, as_texts, loaded
from nuno.api.words import in_python
from nuno.exports.camera import AZIMUTHS
from nuno.exports.tables import heading
from nuno.scene.explain import GIVEN
from nuno.scene.override import as_override
from nuno_bench import machine
from nuno_bench.report import page
from nuno_bench.report.result import number
from nuno_bench.sweep.executor import Executor, Lost, versions
from nuno_bench.sweep.kept import Kept
from nuno_bench.sweep.packed import Packed, pack_loaded, unpacked
from nuno_bench.sweep.places import chosen
from nuno_schemas.errors import BadInput, RunFailed, nearest

if TYPE_CHECKING:
    from pandas import DataFrame

KEPT = "sweep.jsonl"
FIGURES = ("simulated_seconds", "wall_seconds", "real_time_factor", "dt", "dt_limit")
"""Of a run's report; and of its series the last value of each, but for these:"""
OF_A_FRAME = ("frame", "t", "time", "step_seconds", "dye_step_seconds")
STATE, WHY, DIGEST, PICTURE = "state", "why", "digest", "picture"
"""Columns beside them: done, stopped, failed, refused or lost; the reason where it is neither of the first two."""
SIZE = 320, 240
Row = dict[str, Any]


@dataclass(frozen=True)
class Point:
    """One run of a sweep: overrides of a packed scene, which side of its end is drawn ("" for none), and how many
    threads it may take (0: all).
    """

    packed: Packed
    overrides: tuple[str, ...]
    side: str
    threads: int


@dataclass(frozen=True)
class Sweep:
    """What came of all combinations, in their order, the first field's values changing last.

    over  values of each field, by its key
    rows  of each combination: its values by key, FIGURES in SI units, the last frame's series, STATE, WHY, DIGEST, and
          the PICTURE as a PNG in base64
    """

    scene: str
    over: Mapping[str, Sequence[Any]]
    rows: Sequence[Row]

    def to_dataframe(self) -> DataFrame:
        """The rows without pictures. Raises BadInput without pandas."""
        try:
            from pandas import DataFrame
        except ImportError:
            raise missing("a table", "pandas") from None
        return DataFrame(self.lines())

    def lines(self) -> list[Row]:
        """The rows without pictures, each with all columns."""
        names = dict.fromkeys(name for row in self.rows for name in row if name != PICTURE)
        return [{name: row.get(name, "") for name in names} for row in self.rows]

    def table(self) -> page.Table:
        """The values and what came of them, without what is the same, or lacking, in all rows."""
        lines = self.lines()
        told = [name for name in (lines[0] if lines else ()) if name in self.over or name == STATE
                or (name not in (DIGEST, WHY) and len({repr(line[name]) for line in lines}) > 1)]  # fmt: skip
        return page.Table(list(map(heading, told)), [[_cell(line[name]) for name in told] for line in lines])

    def report(self, about: Mapping[str, str]) -> page.Report:
        """Its page, JSON and CSV."""
        images = [page.Image(f"data:image/png;base64,{row[PICTURE]}", self._label(row))
                  for row in self.rows if row.get(PICTURE)]  # fmt: skip
        lead = f"{self.scene}, run for each combination of {', '.join(self.over)}."
        lost = [[self._label(row), f"{row[STATE]}, {row[WHY]}"] for row in self.rows if WHY in row]
        sections: page.Sections = [
            ("", [self.table()]),
            ("Not done", [page.Table(("run", "why"), lost, prose=True)]),
            ("The ends", [page.Pictures(images)] if images else []),
        ]
        data = {"over": {key: list(values) for key, values in self.over.items()}, "rows": self.lines()}
        return page.Report(f"Sweep of {self.scene}", lead, sections, about, data, rows=self.lines())

    def _label(self, row: Row) -> str:
        return ", ".join(f"{key.rsplit('.', 1)[-1]} {row[key]}" for key in self.over)

    def _repr_html_(self) -> str:
        table = self.table()
        rows = ["".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in table.rows]
        head = "".join(f"<th>{html.escape(name)}</th>" for name in table.headings)
        figures = [
            f'<figure style="display: inline-block; margin: 4px"><img src="data:image/png;base64,{row[PICTURE]}">'
            f"<figcaption>{html.escape(self._label(row))}</figcaption></figure>"
            for row in self.rows if row.get(PICTURE)
        ]  # fmt: skip
        return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>{''.join(figures)}"


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return number(value) if math.isfinite(value) else "-"
    return "-" if value is None or value == "" else str(value)


def sweep(
    scene: str | os.PathLike[str] | Mapping[str, Any] | Scene,
    over: Mapping[str, Sequence[Any]],
    *overrides: str | Mapping[str, Any],
    roots: Sequence[str | os.PathLike[str]] = (),
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    side: str = "scene",
    jobs: int | None = None,
    dask: str | None = None,
    told: Callable[[str], None] | None = None,
    **fields: Any,
) -> Sweep:
    """Run a scene for each combination of values: nuno.sweep("hanging-sheet", {"objects.0.model.fabric": ["denim",
    "jersey"], "solver.dt": ["0.2 ms", "0.4 ms"]}, duration="1 s").

    The scene, its overrides, roots and fields as in `nuno.run`. What is done is kept in the folder `out`, if one is
    given, where `resume` goes on with it, and where page, JSON and CSV are written at the end. side: what is drawn of
    each end: "scene" by the scene's own camera, a side of `Result.picture`, or "" for nothing. jobs: processes of this
    machine, all cores by default; dask: a scheduler's address, whose workers compute instead. `told` hears what is
    done.

    A run that is refused, fails or is lost has a row that says so. Raises BadInput where a value is refused whatever
    the others are, before anything runs.
    """
    with (
        in_python(),
        loaded(scene, as_texts([*overrides, fields]), roots) as found,
        closing(chosen(jobs, dask)) as where,
    ):
        return run_all(found, over, Place(where, None if out is None else Path(out), resume, told or _unheard), side)


def _unheard(text: str) -> None:
    pass


@dataclass(frozen=True)
class Place:
    """Where a sweep is computed, where it is kept and gone on with, and who hears of it."""

    where: Executor
    folder: Path | None
    resume: bool
    told: Callable[[str], None]


def run_all(scene: Any, over: Mapping[str, Sequence[Any]], place: Place, side: str) -> Sweep:
    """See `sweep`; scene is a Loaded."""
    if side not in ("", "scene", *AZIMUTHS):
        raise BadInput("no such side", field="--side", value=side, remedy=nearest(side, ("scene", *AZIMUTHS)))
    if not over or not all(over.values()):
        raise BadInput("nothing to sweep over", field="--over", remedy="name fields and their values")
    packed = pack_loaded(scene)
    for key, value in ((key, value) for key, values in over.items() for value in values):
        with _as_swept(), unpacked(packed, [as_override(key, value)]):
            pass
    about = {"scene": packed.digest, "over": {key: list(map(repr, values)) for key, values in over.items()},
             "side": side, "versions": versions()}  # fmt: skip
    kept = None if place.folder is None else Kept(place.folder / KEPT, about, place.resume)
    combinations = [dict(zip(over, values, strict=True)) for values in itertools.product(*over.values())]
    found: dict[int, Row] = {} if kept is None else {line["number"]: line["row"] for line in kept.lines}
    others, threads = machine.Others(), 1 if place.where.width > 1 else 0
    texts = [tuple(as_override(key, value) for key, value in one.items()) for one in combinations]
    numbers = {text: i for i, text in enumerate(texts)}
    left = [Point(packed, text, side, threads) for i, text in enumerate(texts) if i not in found]
    for point, came in place.where.run(measure, left):
        i = numbers[point.overrides]
        row = _refused(came) if isinstance(came, BadInput | Lost) else came
        found[i] = {**combinations[i], **row}
        if kept is not None:
            kept.add({"number": i, "row": found[i]})
        why = f", {row[WHY]}" if WHY in row else ""
        place.told(f"{len(found)} of {len(texts)}: {', '.join(point.overrides)}: {row[STATE]}{why}")
    made = Sweep(scene.scene.name, over, [found[i] for i in range(len(texts))])
    if place.folder is not None:
        about_it = machine.about(others, where=place.where.where)
        made.report(about_it).write_beside(place.folder / "sweep")
    return made


@contextmanager
def _as_swept() -> Iterator[None]:
    """Name the flag that a refused value is from."""
    try:
        yield
    except BadInput as error:
        raise replace(error, file="--over" if error.file == GIVEN else error.file) from None


def _refused(came: BadInput | Lost) -> Row:
    why = " ".join(str(came).removeprefix(f"{GIVEN}: ").split())
    return {STATE: "lost" if isinstance(came, Lost) else "refused", WHY: why}


def measure(point: Point) -> Row:
    """Run one combination. Raises BadInput where it is refused."""
    with warnings.catch_warnings(), unpacked(point.packed, point.overrides) as scene:
        warnings.simplefilter("ignore")  # of each run again; what they say is in its report
        try:
            result = run_loaded(scene, point.threads)
        except RunFailed as error:
            return {STATE: "failed", WHY: str(error).partition("; recording kept in")[0]}
        return {STATE: result.state} | _figures(result) | {DIGEST: result.digest} | _picture(result, point.side)


def _figures(result: Result) -> Row:
    with result.recording as recording:
        series = recording.series()
    ends = {name: values[-1].item() for name, values in series.items() if name not in OF_A_FRAME}
    return {name: result.report[name] for name in FIGURES} | ends


def _picture(result: Result, side: str) -> Row:
    if not side:
        return {}
    stream = io.BytesIO()
    with result.recording as recording:
        size = None if recording.dyed_alone else SIZE
    image = result.picture(None if side == "scene" else side, None, size=size)
    image.thumbnail(SIZE)
    image.save(stream, "PNG")
    return {PICTURE: base64.b64encode(stream.getvalue()).decode()}
