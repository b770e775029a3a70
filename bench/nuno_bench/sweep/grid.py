"""A scene run once for each combination of values of its fields: one table, and a picture of each end."""

from __future__ import annotations

import argparse
import base64
import html
import io
import itertools
import math
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from nuno.cli.common import add_scene, find_own, load_scene
from nuno.exports.camera import SIDES
from nuno.exports.tables import heading
from nuno.plugin_contract import registry
from nuno.python_api.run import Result, run_loaded, table_of
from nuno.python_api.scene import Scene, as_texts, in_python, loaded
from nuno.scene import shipped, yaml_lines
from nuno.scene.scene_file import Loaded
from nuno.scene.validation_errors import GIVEN
from nuno_bench import machine, options
from nuno_bench.report import page
from nuno_bench.report.page import number
from nuno_bench.sweep.executor import (
    Executor,
    PackedScene,
    SweepFile,
    add_executor_arguments,
    choose_executor,
    open_executor,
    pack_loaded,
    require_kept,
    unpacked,
    versions,
)
from nuno_schemas.errors import BadInput, RunFailed, nearest

if TYPE_CHECKING:
    from pandas import DataFrame


# `nuno sweep`: a scene run for each combination of values of its fields.


def sweep_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument(
        "--over", action="append", default=[], metavar="KEY=A,B,...",
        help="a field and its values: objects.0.model.fabric=denim,jacket; again for another, with all combinations",
    )  # fmt: skip
    parser.add_argument("--side", choices=["scene", *SIDES, "none"], default="scene",
                        help="from where each end is drawn (default: by the scene's own camera)")  # fmt: skip
    add_executor_arguments(parser)
    options.add_shared(parser, "--resume")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where page, table and what is finished meanwhile go "
                        "(default: recordings/sweep/SCENE)")  # fmt: skip


def sweep_command(args: argparse.Namespace) -> int:
    """Run all combinations and print the table; return 1 if any of them was not finished."""
    over = dict[str, list[Any]]()
    for key, values in map(values_of, args.over):
        if key in over:
            raise BadInput("a field is swept over once", field="--over", value=key, remedy="give all its values in one")
        over[key] = values
    print("\n".join(f"{key}: {', '.join(map(str, values))}" for key, values in over.items()), file=sys.stderr)
    path = shipped.find(args.scene)
    for key, values in over.items():  # files of the working folder, as --set may name them
        for i, value in enumerate(values):
            if isinstance(value, str):
                (item,), folders = find_own(path, [f"{key}={value}"])
                over[key][i] = item.partition("=")[2]
                args.root += folders
    loaded = load_scene(args)
    folder = args.out or Path("recordings/sweep") / loaded.scene.name
    if args.resume:
        require_kept([folder / KEPT])
    with open_executor(args) as where:
        place = Place(where, folder, args.resume, lambda text: print(text, file=sys.stderr, flush=True))
        try:
            made = run_all(loaded, over, place, args.side.replace("none", ""))
        except KeyboardInterrupt:
            print("to go on with it, give the same command with --resume", file=sys.stderr)
            raise
    made.keep()
    print(made.table().text())
    return int(any(row[STATE] not in ("done", "stopped") for row in made.rows))


def values_of(item: str) -> tuple[str, list[Any]]:
    """Return a field's key and its values, parsed as YAML. Raises BadInput."""
    key, equals, text = item.partition("=")
    if not key or not equals:
        remedy = "for example --over solver.dt='1/6000 s, 1/3000 s'"
        raise BadInput("a sweep goes over KEY=A,B,...", field="--over", value=item, remedy=remedy)
    try:
        values = yaml_lines.parse_value(f"[{text}]")
    except BadInput as error:
        raise BadInput(error.problem, field="--over", value=item, remedy=error.remedy) from None
    return key, list(values)


KEPT = "sweep.jsonl"
FIGURES = ("simulated_seconds", "wall_seconds", "real_time_factor", "dt", "dt_limit")
"""Columns from a run's report. The last value of each of its series is a column, too, except for these:"""
OF_A_FRAME = ("frame", "t", "time", "step_seconds", "dye_step_seconds")
STATE, WHY, DIGEST, PICTURE = "state", "why", "digest", "picture"
"""Further columns. The state is done, stopped, failed, refused or lost; all but the first two have a reason."""
SIZE = 320, 240
Row = dict[str, Any]


@dataclass(frozen=True)
class Combination:
    """A run of a sweep, with its number.

    It is of a packed scene with these overrides, drawn at its end from a side ("" for none), on so many threads (0:
    all).
    """

    number: int
    packed: PackedScene
    overrides: tuple[str, ...]
    side: str
    threads: int


@dataclass(frozen=True)
class Sweep:
    """Results of all combinations, in their order, with the first field's values changing last.

    over  values of each field, by its key
    rows  row of each combination: its values by key, FIGURES in SI units, the last frame's series, STATE, WHY, DIGEST,
          and the PICTURE as a PNG in base64
    folder, where, others  folder or None, executor in words, and the machine's other load
    """

    scene: str
    over: Mapping[str, Sequence[Any]]
    rows: Sequence[Row]
    folder: Path | None
    where: str
    others: machine.OtherLoad

    def keep(self) -> None:
        """Write page, JSON and CSV into the folder, if any; after the end of the processes, whose time counts."""
        if self.folder is not None:
            self.report(machine.about(self.others, where=self.where)).write_beside(self.folder / "sweep")

    def to_dataframe(self) -> DataFrame:
        """Return the rows without pictures. Raises BadInput without pandas."""
        return table_of(self.lines())

    def lines(self) -> list[Row]:
        """Return the rows without pictures, each with all columns."""
        names = dict.fromkeys([*self.over, STATE, WHY, *(n for row in self.rows for n in row if n != PICTURE)])
        return [{name: row.get(name, "") for name in names} for row in self.rows]

    def table(self) -> page.Table:
        """Return a table of the values and results, without columns that are equal or empty in all rows."""
        lines = self.lines()
        keys = [name for name in (lines[0] if lines else ()) if name in self.over or name == STATE]
        others = [name for name in (lines[0] if lines else ()) if name not in (*keys, DIGEST, WHY)]
        shown = keys + [name for name in others if len(lines) == 1 or len({repr(line[name]) for line in lines}) > 1]
        return page.Table(list(map(heading, shown)), [[_cell(line[name]) for name in shown] for line in lines])

    def report(self, about: Mapping[str, str]) -> page.Report:
        """Return the report with page, JSON and CSV."""
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
    jobs: int = 1,
    dask: str | None = None,
    progress: Callable[[str], None] | None = None,
    **fields: Any,
) -> Sweep:
    """Run a scene for each combination of values: nuno.sweep("hanging-sheet", {"objects.0.model.fabric": ["denim",
    "jacket"], "solver.dt": ["1/6000 s", "1/3000 s"]}, duration="1 s").

    The scene, its overrides, roots and fields are as in `nuno.run`. Finished runs are kept in the folder `out`, if
    given, from which `resume` continues, and to which page, JSON and CSV are written at the end. side: the picture of
    each end: "scene" by the scene's own camera, a side of `Result.picture`, or "" for none. jobs: processes of this
    machine; more than one need a notebook, or a script with its work below `if __name__ == "__main__":`. dask: address
    of a scheduler, whose workers compute instead. `progress` is called with a line of text after each run.

    A run that is refused, fails or is lost has a row with the reason. Raises BadInput, before anything runs, for a
    value that is refused in every combination.
    """
    with in_python(), loaded(scene, as_texts([*overrides, fields]), roots) as found:
        if jobs != 1 or dask is not None:
            registry.require_installed(found.chosen, "a sweep's other processes", "jobs=1")
        with closing(choose_executor(jobs if dask is None else None, dask)) as where:
            place = Place(where, None if out is None else Path(out), resume, progress or (lambda text: None))
            made = run_all(found, over, place, side)
        made.keep()
        return made


@dataclass(frozen=True)
class Place:
    """Executor of a sweep, folder of its finished runs, whether it resumes, and the function that reports progress."""

    where: Executor
    folder: Path | None
    resume: bool
    say: Callable[[str], None]


def run_all(scene: Loaded, over: Mapping[str, Sequence[Any]], place: Place, side: str) -> Sweep:
    """Run all combinations of values, as `sweep` does, for a loaded scene."""
    over = _values(over)
    if side not in ("", "scene", *SIDES):
        raise BadInput("no such side", field="--side", value=side, remedy=nearest(side, ("scene", *SIDES)))
    if side in SIDES and not scene.scene.moves:
        problem, remedy = "a cloth that is dyed alone lies flat", "leave it out"
        raise BadInput(problem, field="--side", value=side, remedy=remedy)
    if place.resume and place.folder is None:
        raise BadInput("what is gone on with is not said", field="--resume", remedy="name the folder: out=...")
    for key in over:
        if lost := [item for item in scene.overrides if f"{item.partition('=')[0]}.".startswith(f"{key}.")]:
            problem, remedy = "the sweep gives this field its values", "leave one of the two out"
            raise BadInput(problem, field="--over", value=key, limit=f"--set {lost[0]}", remedy=remedy)
    for text in (text for _, text in yaml_lines.walk(list(over.values())) if isinstance(text, str)):
        with suppress(BadInput, OSError, ValueError):  # a text that is no file's name
            scene.files.resolve(text)
    packed = pack_loaded(scene)
    combinations = [dict(zip(over, values, strict=True)) for values in itertools.product(*over.values())]
    texts = [tuple(as_texts([one])) for one in combinations]
    _check(packed, combinations, texts)
    # As a list: of two sweeps over the same fields in another order, other combinations have the same number.
    fields = [[key, list(map(repr, values))] for key, values in over.items()]
    about = {"scene": packed.digest, "over": fields, "side": side, "versions": versions()}
    kept = None if place.folder is None else SweepFile(place.folder / KEPT, about, place.resume, place.say)
    done: dict[int, Row] = {} if kept is None else {line["number"]: line["row"] for line in kept.lines}
    others, threads = machine.OtherLoad(), 1 if place.where.width > 1 else 0
    left = [Combination(i, packed, text, side, threads) for i, text in enumerate(texts) if i not in done]
    with kept or nullcontext():
        for point, result in place.where.run(measure, left):
            row = _refused(result) if isinstance(result, BadInput | RunFailed) else result
            done[point.number] = {**combinations[point.number], **row}
            if kept is not None:
                kept.add({"number": point.number, "row": done[point.number]})
            why = f", {row[WHY]}" if WHY in row else ""
            place.say(f"{len(done)} of {len(texts)}: {', '.join(point.overrides)}: {row[STATE]}{why}")
    rows = [done[i] for i in range(len(texts))]
    return Sweep(scene.scene.name, over, rows, place.folder, place.where.where, others)


def _values(over: Mapping[str, Sequence[Any]]) -> dict[str, list[Any]]:
    """Return lists of plain values. Raises BadInput for no values, and for a string, which is probably a mistake."""
    lists = dict[str, list[Any]]()
    if not isinstance(over, Mapping):
        raise BadInput("a sweep goes over a mapping of fields to values", field="--over", value=over)
    for key, values in over.items():
        if isinstance(values, str | bytes | Mapping) or not isinstance(values, Iterable):
            problem, remedy = "a field is swept over a list of values", f"{{{key!r}: [{values!r}]}}"
            raise BadInput(problem, field="--over", value=values, remedy=remedy)
        lists[key] = [value.item() if isinstance(value, np.generic) else value for value in values]
    if not lists or not all(lists.values()):
        raise BadInput("nothing to sweep over", field="--over", remedy="name fields and their values")
    return lists


def _check(packed: PackedScene, combinations: Sequence[Mapping[str, Any]], texts: Sequence[tuple[str, ...]]) -> None:
    """Raise BadInput for a value with which every combination is refused when it is read."""
    refusals: dict[int, BadInput | None] = {}

    def refusal(i: int) -> BadInput | None:
        if i not in refusals:
            try:
                with unpacked(packed, texts[i]):
                    refusals[i] = None
            except BadInput as error:
                refusals[i] = replace(error, file="--over" if error.file == GIVEN else error.file)
        return refusals[i]

    for text in dict.fromkeys(text for each in texts for text in each):
        uses = [i for i, each in enumerate(texts) if text in each]
        if all(refusal(i) is not None for i in uses):
            raise cast(BadInput, refusal(uses[0]))


def _refused(error: BadInput | RunFailed) -> Row:
    why = "; ".join(" ".join(line.split()) for line in str(error).removeprefix(f"{GIVEN}: ").splitlines())
    return {STATE: "lost" if isinstance(error, RunFailed) else "refused", WHY: why}


def measure(point: Combination) -> Row:
    """Run one combination. Raises BadInput if it is refused."""
    with (
        warnings.catch_warnings(),
        tempfile.TemporaryDirectory(prefix="nuno-") as folder,
        unpacked(point.packed, point.overrides) as scene,
    ):
        warnings.simplefilter("ignore")  # of each run again; what they say is in its report
        try:
            result = run_loaded(scene, Path(folder) / "run.mcap", point.threads)
        except RunFailed as error:
            return {STATE: "failed", WHY: str(error).partition("; recording kept in")[0]}
        with result.recording as recording:
            series = recording.series()
        figures = {name: result.report[name] for name in FIGURES}
        figures |= {name: values[-1].item() for name, values in series.items() if name not in OF_A_FRAME}
        return {STATE: result.state} | figures | {DIGEST: result.digest} | _picture(result, point.side)


def _picture(result: Result, side: str) -> Row:
    if not side:
        return {}
    stream = io.BytesIO()
    with result.recording as recording:
        size = None if recording.dyed_alone else SIZE
    try:
        image = result.picture(None if side == "scene" else side, None, size=size)
    except BadInput as error:
        return {WHY: f"no picture: {error.problem}"}
    image.thumbnail(SIZE)
    image.save(stream, "PNG")
    return {PICTURE: base64.b64encode(stream.getvalue()).decode()}
