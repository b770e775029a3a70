"""What an implicit step costs as the cloth gets stiffer: a frame as the step, k from 1e2 to 1e8 N/m."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass

from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.machine import cores
from nuno_bench.report.result import Result
from nuno_bench.speed.steps.stiff import SCENE, sided
from nuno_schemas.errors import RunFailed

SOLVERS = ("implicit_euler", "tr_bdf2")
SIDES = (16, 32)
STIFFNESS = (1e2, 1e4, 1e6, 1e8)
"""Structural [N/m]; shear and bending follow in the scene's own proportions."""
SHARES = {"structural": 1.0, "shear": 0.3, "bending": 0.02}
FRAMES = 30
GROWTH = 3.0
"""How many times the cost at the lowest stiffness the one at the highest may be."""


@dataclass(frozen=True)
class Cost:
    """Of one run: wall time [s], and what the solver counted."""

    seconds: float
    totals: Counter[str]

    def describe(self) -> str:
        newton, linear = self.totals["newton_steps"], self.totals["linear_iterations"]
        return f"{newton / FRAMES:.3g} Newton steps a frame, {linear / max(newton, 1):.3g} linear iterations in each"


def run(solver: str, side: int, k: float) -> Cost:
    """FRAMES frames of the stiff sheet, everything compiled. Raises RunFailed."""
    overrides = [sided(side), f"solver={{plugin: {solver}, dt: auto}}", f"duration={FRAMES / 60!r}"]
    overrides += [f"objects.0.model.fabric.{name}={share * k!r}" for name, share in SHARES.items()]
    simulation = Simulation(scene_file.read(scene_file.find(SCENE), overrides), None, None, cores())
    simulation.measure(None)
    totals: Counter[str] = Counter()
    start = time.perf_counter()
    while not simulation.finished:
        report = simulation.advance(None, None).report
        if report.status != "ok":
            raise RunFailed(f"{solver}, {side}x{side}, k = {k:g} N/m: {report.status}: {report.message}")
        totals.update(report.totals)
    return Cost(time.perf_counter() - start, totals)


def stiffness(repeats: int) -> list[Result]:
    """Cost of a frame over stiffness for each implicit solver, and the growth from the lowest to the highest."""
    results = []
    for solver in SOLVERS:
        for side in SIDES:
            costs = {k: [run(solver, side, k) for _ in range(min(repeats, 3))] for k in STIFFNESS}
            each = [_cost(f"{solver}, {side}x{side}, k = {k:.0e} N/m", found) for k, found in costs.items()]
            growth = tuple(
                high.seconds / low.seconds for low, high in zip(costs[STIFFNESS[0]], costs[STIFFNESS[-1]], strict=True)
            )
            what = f"{solver}, {side}x{side}, {STIFFNESS[-1]:.0e} N/m over {STIFFNESS[0]:.0e} N/m"
            medians = [result.median for result in each]
            note = f"{max(medians) / min(medians):.3g} times from the cheapest to the dearest"
            results += [*each, Result("stiffness", what, "times", growth, bar=GROWTH, at_most=True, note=note)]
    return results


def _cost(what: str, found: list[Cost]) -> Result:
    samples = tuple(1e3 * cost.seconds / FRAMES for cost in found)
    return Result("stiffness", what, "ms a frame", samples, note=found[0].describe())
