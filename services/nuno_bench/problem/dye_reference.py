"""What errors of dye are measured against: the explicit scheme, extrapolated, checked by another solver.

The scheme's error is of first order in the step, so that 2 u(h / 2) - u(h) takes it away (Richardson 1911); what is
left is of second order where amounts are smooth in time. Its disagreement with the closest of the other solvers, or
with the same at twice the step where none is installed, is the floor.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from nuno import registry
from nuno_bench.problem.dye import SCHEME, DyeProblem
from nuno_bench.problem.observe import Run, Series
from nuno_bench.problem.reference import TRIED, Compared, no_reference
from nuno_schemas.errors import BadInput

FINER = (32, 16, 8, 4, 2)
"""Steps for one that is stable, tried in turn: the first that ends within the time allowed, halved steps and all."""
CHECKED = (64, 32, 16, 8, 4, 2, 1)
"""Steps a frame of a solver that any step is stable for, tried in turn."""


def make_dye_reference(problem: DyeProblem, most_seconds: float, told: Callable[[str], None]) -> Compared:
    """The scene's reference; its runs may take `most_seconds`, and those that check it as long again.

    Raises BadInput where not even the coarsest ends in that time.
    """
    plugin = registry.load(problem.group, SCHEME)
    config = plugin.Config()
    limit = problem.limit(plugin, config).dt
    stable = max(1, math.ceil(problem.frame / limit))
    each = problem.first_call(plugin, config, 2 * stable, TRIED)[1] / TRIED
    fitting = [finer for finer in FINER if 3 * finer * stable * problem.frames * each <= most_seconds]
    if not fitting:
        taken = 3 * FINER[-1] * stable * problem.frames * each
        why = f"{3 * FINER[-1]} times the stable steps take {taken:.3g} s"
        raise no_reference(problem, why, f"{most_seconds:g} s")
    finer = fitting[0]
    told(f"reference: {SCHEME}, {finer} and {2 * finer} steps for one that is stable")
    half, coarse, fine = (_run(problem, plugin, n * stable) for n in (finer // 2, finer, 2 * finer))
    run = extrapolate(coarse, fine)
    how = f"{SCHEME} at 1/{finer} and 1/{2 * finer} of its stable step, extrapolated"
    others = [name for name in sorted(registry.installed(problem.group)) if name != SCHEME]
    found = [_check(problem, name, stable * finer, most_seconds, told) for name in others]
    checks = [one for one in found if one] or [(extrapolate(half, coarse), "the same at twice the step")]
    check, said = min(checks, key=lambda pair: float(np.abs(pair[0].series.x - run.series.x).max()))
    return Compared(run, check, f"{how}, checked by {said}", coarse.seconds + fine.seconds + check.seconds)


def _check(
    problem: DyeProblem, name: str, steps: int, most_seconds: float, told: Callable[[str], None]
) -> tuple[Run, str] | None:
    """Another solver's run at as fine a step as time allows, and its words; None where it has none."""
    plugin = registry.load(problem.group, name)
    try:
        config = plugin.Config()
        counts = [steps] if math.isfinite(problem.limit(plugin, config).dt) else CHECKED
        for count in counts:
            each = problem.first_call(plugin, config, count, 2)[1] / 2
            if count * problem.frames * each <= most_seconds:
                told(f"reference: {name}, {count} steps a frame")
                run = problem.run(plugin, config, count, 2.0 * most_seconds)
                return (run, f"{name} at {count} steps a frame") if run.status == "ok" else None
    except (BadInput, ValueError):
        pass
    return None


def _run(problem: DyeProblem, plugin: Any, steps: int) -> Run:
    run = problem.run(plugin, plugin.Config(), max(1, steps))
    if run.status != "ok":
        raise no_reference(problem, f"{SCHEME}: {run.status}: {run.message}")
    return run


def extrapolate(coarse: Run, fine: Run) -> Run:
    """Without the error of first order; `fine` took twice the steps of `coarse`."""
    a, b = coarse.series, fine.series
    values = {name: 2.0 * b.values[name] - a.values[name] for name in b.values}
    series: Series = replace(b, x=2.0 * b.x - a.x, values=values)
    return replace(fine, series=series, seconds=coarse.seconds + fine.seconds)
