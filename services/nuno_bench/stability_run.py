"""The sweep behind the maps: rows over processes, kept as they come, so that an interrupted sweep goes on."""

from __future__ import annotations

import contextlib
import json
import math
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from nuno import registry, scene_file
from nuno_bench.stability_case import Point, Setting, make_reference, measure_row, pose, reference_plugin
from nuno_schemas.errors import BadInput

FACTORS = (1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3)
"""Of the scene's stiffness."""
MESHES = (0.25, 0.5, 1.5)
"""Of the scene's numbers of vertices along each side; 1 is the stiffness map's middle."""
MOST_HALVINGS = 11
"""Of a frame, to the shortest step."""


@dataclass
class Row:
    """Points of one solver at one setting; limit [s] by the solver itself; edge [m] of the shortest spring."""

    axis: str
    value: float
    solver: str
    edge: float
    limit: float
    points: list[Point]

    def json(self) -> dict[str, Any]:
        return vars(self) | {"points": [vars(point) for point in self.points]}


@dataclass
class Sweep:
    """Rows in the order in which they came, and what was left out, by name."""

    rows: list[Row] = field(default_factory=list)
    omissions: list[str] = field(default_factory=list)


def mesh_overrides(path: Path, overrides: Sequence[str], factor: float) -> list[str]:
    """Overrides that give every object so many times the vertices along its sides.

    Raises BadInput for a model without a resolution: its mesh is what its file says.
    """
    loaded = scene_file.read(path, overrides)
    made = list(overrides)
    for i, model in enumerate(loaded.models):
        at, config = f"objects.{i}.model", model.config
        if hasattr(config, "resolution"):
            sides = [max(3, 1 + round(factor * (side - 1))) for side in config.resolution]
            made.append(f"{at}.resolution={sides}")
        elif hasattr(config, "columns") and hasattr(config, "rows"):
            made += [f"{at}.{name}={max(6, round(factor * getattr(config, name)))}" for name in ("columns", "rows")]
        else:
            raise BadInput(f"the model {model.name} has no resolution", str(path), field=at)
    return made


def settings_of(path: Path, overrides: Sequence[str]) -> tuple[list[Setting], list[str]]:
    """All settings of a scene, the middle ones first, and the names of what cannot be varied."""
    name = str(path.resolve())
    found = [Setting(name, tuple(overrides), "stiffness", value) for value in FACTORS]
    omissions = []
    try:
        for value in MESHES:
            found.append(Setting(name, tuple(mesh_overrides(path, overrides, value)), "mesh", value))
    except BadInput as error:
        omissions.append(f"the map over mesh sizes: {error.problem}")
    return sorted(found, key=lambda s: (abs(math.log(s.value)), s.axis)), omissions


def step_counts(frame: float, omega: float) -> list[int]:
    """Steps a frame in powers of two, to the explicit limit 2 / omega of a hundred times the stiffness, halved."""
    wanted = math.ceil(math.log2(max(2.0, frame * omega * 10.0)))
    return [2**i for i in range(min(MOST_HALVINGS, wanted) + 1)]


class Kept:
    """Rows on disk, one JSON object a line, under a first line that says what they belong to."""

    def __init__(self, path: Path, identity: dict[str, Any], resume: bool) -> None:
        self.path, self.rows = path, list[Row]()
        if resume and path.is_file():
            head, *lines = path.read_text(encoding="utf-8").splitlines() or ["{}"]
            if json.loads(head) != identity:
                remedy = "leave --resume out, or give another --out"
                raise BadInput("these rows belong to another sweep", str(path), remedy=remedy)
            self.rows = [row for line in lines if (row := _row(line)) is not None]
        text = [json.dumps(identity), *(json.dumps(row.json()) for row in self.rows)]
        path.write_text("\n".join(text) + "\n", encoding="utf-8")

    def add(self, row: Row) -> None:
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row.json()) + "\n")
        self.rows.append(row)

    def holds(self, setting: Setting, solver: str) -> bool:
        return any((r.axis, r.value, r.solver) == (setting.axis, setting.value, solver) for r in self.rows)


def _row(line: str) -> Row | None:
    """A row, or None for a line that was only half written."""
    try:
        data = json.loads(line)
    except ValueError:
        return None
    return Row(**(data | {"points": [Point(**point) for point in data["points"]]}))


def measure_all(
    settings: Sequence[Setting],
    solvers: Sequence[str],
    kept: Kept,
    budget: float,
    workers: int,
    told: Callable[[str], None],
) -> Sweep:
    """All rows, by `workers` processes, or here where there is one."""
    sweep = Sweep()
    if any(not kept.holds(setting, name) for setting in settings for name in solvers):
        told("compiling, where that has not been done")
        compile_all(settings[0], solvers)
    deadline = time.time() + budget
    wanted = {s: [name for name in solvers if not kept.holds(s, name)] for s in settings}
    most = 0.5 * workers * budget / max(1, sum(map(len, wanted.values())))
    tasks = [(setting, names, most, deadline) for setting, names in wanted.items() if names]
    for (setting, names, *_), outcome in _spread(tasks, workers):
        told(f"{setting.axis} x {setting.value:g}")
        if isinstance(outcome, BadInput):
            sweep.omissions.append(f"{setting.axis} x {setting.value:g}, {', '.join(names)}: {outcome.problem}")
            continue
        for row in outcome:
            kept.add(row)
    middle = [row for row in kept.rows if row.axis == "stiffness" and row.value == 1.0]
    sweep.rows = list(kept.rows)
    if any(setting.axis == "mesh" for setting in settings):
        sweep.rows += [replace(row, axis="mesh") for row in middle]
    missing = sum(point.outcome == "left out" for row in sweep.rows for point in row.points)
    if missing:
        sweep.omissions.append(f"{missing} points that would have taken too long (left out on the maps)")
    return sweep


Task = tuple[Setting, list[str], float, float]


def compile_all(setting: Setting, solvers: Sequence[str]) -> None:
    """One frame without steps by every solver: processes of the sweep then load what this one compiled."""
    posed = pose(setting)
    for plugin in (reference_plugin(), *(registry.load("nuno.integrators", name) for name in solvers)):
        with contextlib.suppress(BadInput), np.errstate(all="ignore"):
            state = posed.start.copy()
            memory = plugin.prepare(plugin.Config(), posed.system, state)
            plugin.advance(posed.system, state, memory, posed.pair(0), 0, posed.frame)


def measure_setting(setting: Setting, solvers: Sequence[str], most: float, deadline: float) -> list[Row]:
    """The rows of all solvers at one setting. Raises BadInput where it cannot be posed, or no time is left."""
    if time.time() > deadline:
        raise BadInput("the budget of time")
    posed, plugin = pose(setting), reference_plugin()
    unscaled = pose(replace(setting, axis="mesh"))
    omega = float(plugin.limit(plugin.Config(), unscaled.system, unscaled.start).omega)
    counts, reference = step_counts(posed.frame, omega), make_reference(posed)
    rows = []
    for name in solvers:
        limit, points = measure_row(posed, setting, name, counts, reference, most, deadline)
        rows.append(Row(setting.axis, setting.value, name, posed.edge, limit, points))
    return rows


def _spread(tasks: Sequence[Task], workers: int) -> Iterator[tuple[Task, list[Row] | BadInput]]:
    """Each task with its rows or why it has none; what a lost process leaves undone is done here."""
    undone = list(tasks)
    if workers > 1:
        # Fresh interpreters: compiled kernels' threads do not survive a fork.
        with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
            futures = {pool.submit(_attempt, task): task for task in tasks}
            for future in as_completed(futures):
                if isinstance(future.exception(), BrokenProcessPool):
                    continue
                undone.remove(futures[future])
                yield futures[future], future.result()
    for task in undone:
        yield task, _attempt(task)


def _attempt(task: Task) -> list[Row] | BadInput:
    try:
        return measure_setting(*task)
    except BadInput as error:
        return error
