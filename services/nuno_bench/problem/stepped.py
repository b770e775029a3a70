"""A reference by fixed steps: where cloth lands and slips, forces jump, and an adaptive method creeps from one
jump to the next. Two methods of different order, at a small share of their stable step, are then known better
in the time there is.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from nuno import registry
from nuno.cloth import build
from nuno_bench.problem.observe import Problem, Run, first_call, simulate
from nuno_bench.problem.reference import GROUP, Reference
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

METHODS = ("leapfrog", "symplectic_euler")
"""The reference, and what it is checked by."""
FINER = (64, 32, 16, 8)
"""Steps for one that is stable, tried in turn: the first that ends within the time allowed."""
TRIED = 20
"""Steps by which the cost of a run is estimated."""


def stepped_reference(problem: Problem, most_seconds: float, told: Callable[[str], None]) -> Reference:
    """Both runs, each estimated at `most_seconds` at most. Raises BadInput where not even the coarsest is."""
    runs, finer = list[Run](), FINER[-1]
    for name in METHODS:
        steps, a_step = _fewest(problem, name)
        fitting = [n for n in FINER if n * steps * problem.frames * a_step <= most_seconds]
        if not fitting:
            raise BadInput(
                "the scene has no reference to measure errors against",
                problem.loaded.file,
                value=f"{FINER[-1]} times the steps of {name} take {FINER[-1] * steps * problem.frames * a_step:.3g} s",
                limit=f"{most_seconds:g} s",
                remedy="raise --budget, shorten the run with --duration, or soften the scene",
            )
        finer = fitting[0] if not runs else min(finer, fitting[0])
        told(f"reference: {name}, {finer} steps for one that is stable")
        runs.append(_run(problem, name, finer * steps))
    leading = METHODS[0]
    how = f"{leading} at 1/{finer} of its stable step, checked by {METHODS[1]}"
    steps = finer * _fewest(problem, leading)[0]

    def twin(disturbance: Float) -> Run:
        return _run(problem, leading, steps, disturbance)

    return Reference(runs[0], runs[1], how, runs[0].seconds + runs[1].seconds, twin)


def _fewest(problem: Problem, name: str) -> tuple[int, float]:
    """Steps a frame that are stable, and the seconds of one."""
    plugin = registry.load(GROUP, name)
    limit = plugin.limit(plugin.Config(), problem.system, build.start_state(problem.fabric)).dt
    steps = max(1, math.ceil(problem.frame / limit)) if limit > 0.0 else 1
    return steps, first_call(problem, plugin, plugin.Config(), FINER[-1] * steps, TRIED)[1] / TRIED


def _run(problem: Problem, name: str, steps: int, disturbance: Float | None = None) -> Run:
    plugin = registry.load(GROUP, name)
    run = simulate(problem, plugin, plugin.Config(), steps, disturbance)
    if run.status != "ok":
        raise BadInput(
            "the scene has no reference to measure errors against",
            problem.loaded.file,
            value=f"{name}: {run.status}: {run.message}",
            remedy="shorten the run with --duration",
        )
    return run
