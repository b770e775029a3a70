"""Points that the budget left out, computed beside each other: their errors are known then, their times are not.

Points timed beside each other would lie, so what is timed runs alone, first. Errors do not depend on
what else a machine does: several processes or a cluster may compute them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from nuno import registry
from nuno_bench.precision.point import Kept, Point
from nuno_bench.precision.settings import Setting, Solver
from nuno_bench.precision.sweep import Runner, Sweep
from nuno_bench.problem.observe import Run
from nuno_bench.problem.posing import pose
from nuno_bench.sweep.executor import Executor, Lost
from nuno_bench.sweep.packed import Packed, unpacked
from nuno_schemas.errors import BadInput

UNTIMED = "its error is known, its time is not"


@dataclass(frozen=True)
class Task:
    """One run of a scene by the solver of a name at a setting of a label, of at most so many seconds."""

    scene: Packed
    solver: str
    label: str
    fields: Mapping[str, Any]
    steps: int
    most: float


def run_task(task: Task) -> Run:
    """The run. Raises BadInput where the solver refuses the scene or its configuration."""
    with unpacked(task.scene) as loaded:
        problem = pose(loaded, threads=1)
        plugin = registry.load(problem.group, task.solver)
        config = plugin.Config.model_validate(dict(task.fields))
        return problem.run(plugin, config, task.steps, task.most)


def run_untimed(
    sweep: Sweep,
    runner: Runner,
    scene: Packed,
    kept: Kept,
    budget: float,
    executor: Executor,
    told: Callable[[str], None],
) -> None:
    """Run what `sweep` left out for its time, cheapest first, for as long again as `budget` [s].

    A point joins the others without a time, and its omission says so; one that is not done in time stays left out.
    """
    end = time.monotonic() + budget
    wanted = {(solver.name, setting.label): (solver, setting) for solver, setting in sweep.unaffordable}
    for key in wanted.keys() & kept.points.keys():
        _join(sweep, kept.points[key])
        del wanted[key]

    def tasks() -> Iterator[Task]:
        for solver, setting in wanted.values():
            left = end - time.monotonic()
            if setting.work * sweep.costs[solver.name] <= left:
                fields = {**solver.base, **setting.fields}
                yield Task(scene, solver.name, setting.label, fields, setting.steps, left)

    for task, found in executor.run(run_task, tasks()):
        point = _point(runner, *wanted[task.solver, task.label], found)
        told(f"{task.solver}, {task.label}: {point.outcome}, not timed")
        if point.outcome != "cut":
            kept.add(point)
            _join(sweep, point)


def _point(runner: Runner, solver: Solver, setting: Setting, found: Run | BadInput | Lost) -> Point:
    if isinstance(found, Lost):
        return runner.failed(solver, setting, "lost", found.reason)
    if isinstance(found, BadInput):
        return runner.failed(solver, setting, "refused", found.problem)
    return runner.point_of(solver, setting, found, ())


def _join(sweep: Sweep, point: Point) -> None:
    """Put a point where its omission was, which now is one of its time alone."""
    sweep.points.append(point)
    sweep.omitted = [
        replace(one, reason=f"{UNTIMED}: {one.reason}") if (one.solver, one.setting) == point.key else one
        for one in sweep.omitted
    ]
