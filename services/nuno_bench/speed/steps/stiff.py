"""The stiff sheet: how fast each solver is accurate enough for a viewer, and what stiffness costs implicit ones."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from nuno.scene import scene_file, shipped
from nuno_bench.peers import python
from nuno_bench.peers.problem import REFERENCE, SCENE, SECONDS, judge
from nuno_bench.problem.observe import run_own
from nuno_bench.report.result import Result
from nuno_bench.speed.timing import seconds

CANDIDATES = {
    "auto, accuracy: preview": ("plugin: auto", "preview"),
    "symplectic_euler, dt: auto": ("plugin: symplectic_euler, dt: auto", ""),
    "leapfrog, dt: auto": ("plugin: leapfrog, dt: auto", ""),
    "dopri5, tolerance 1e-6": ("plugin: dopri5, tolerance: 1e-6, dt: auto", ""),
    "tr_bdf2, a step a frame, residual 1e-2": ("plugin: tr_bdf2, residual: 1e-2, dt: auto", ""),
    "implicit_euler, a step a frame, residual 1e-2": ("plugin: implicit_euler, residual: 1e-2, dt: auto", ""),
    "xpbd, 120 steps a frame": ("plugin: xpbd, dt: 1.3888888888888889e-4", ""),
}
BARS = {64: 0.25, 128: 1.0}
"""Wall time of a second [s], by vertices a side."""
SOLVERS = ("implicit_euler", "tr_bdf2")
SIDES = (16, 32)
STIFFNESS = (1e2, 1e4, 1e6, 1e8)
"""Structural [N/m]; shear and bending follow in the scene's own proportions."""
SHARES = {"structural": 1.0, "shear": 0.3, "bending": 0.02}
FRAMES = 30
GROWTH = 3.0
"""How many times the cost at the lowest stiffness the one at the highest may be."""
MOST = 3
"""Repeats."""


def stiff_sheet(repeats: int) -> list[Result]:
    """A second of the sheet by each solver; the bar is held against the fastest that is accurate enough."""
    results, names = list[Result](), list(CANDIDATES)
    for side, bar in BARS.items():
        size = f"objects.0.model.resolution=[{side}, {side}]"
        sheet, converged = python.stiff_sheet(size), python.Nuno(None, REFERENCE, "", [size])
        taken, good, found = seconds(partial(converged.advance, SECONDS)), list[Result](), list[Result]()
        for name in names:
            engine = python.Nuno(None, *CANDIDATES[name], [size])
            engine.advance(1 / 60)
            times = []
            for _ in range(min(repeats, MOST)):
                engine.reset()
                times.append(seconds(partial(engine.advance, SECONDS)))
            score = judge(sheet, engine.simulation.state.x, converged.simulation.state.x)
            note = (
                f"centre of mass off by {1e3 * score.centre:.2g} mm, mean strain {score.strain:.2f} of the reference's"
            )
            note += "" if score.accurate else ": not accurate enough"
            found.append(Result("stiff", f"{side}x{side}, {name}", "s", tuple(times), note=note))
            good += [found[-1]] * score.accurate
        best = min(good, key=lambda one: one.median, default=None)
        results += [replace(one, bar=bar, at_most=True) if one is best else one for one in found]
        results.append(Result("stiff", f"{side}x{side}, the reference: {REFERENCE}", "s", (taken,)))
        # The larger sheet takes eight times as long: only by those that may be the fastest.
        names = sorted(names, key=lambda name: found[names.index(name)].median)[:2]
    return results


def stiffness(repeats: int) -> list[Result]:
    """Cost of a frame over stiffness, a frame as the step, and the growth from the softest sheet to the stiffest."""
    results = []
    for solver, side in ((solver, side) for solver in SOLVERS for side in SIDES):
        what, costs = f"{solver}, {side}x{side}", []
        for k in STIFFNESS:
            constants = [f"objects.0.model.fabric.{name}={share * k!r}" for name, share in SHARES.items()]
            constants.append(f"objects.0.model.resolution=[{side}, {side}]")
            chosen = (f"solver={{plugin: {solver}, dt: auto}}", f"duration={FRAMES / 60!r}", *constants)
            runs = [run_own(scene_file.read(shipped.find(SCENE), chosen)) for _ in range(min(repeats, MOST))]
            newton, linear = (runs[0].totals[name] for name in ("newton_steps", "linear_iterations"))
            note = f"{newton / FRAMES:.3g} Newton steps a frame, {linear / max(newton, 1):.3g} linear iterations each"
            each = tuple(1e3 * one.seconds / FRAMES for one in runs)
            costs.append(Result("stiffness", f"{what}, k = {k:.0e} N/m", "ms a frame", each, note=note))
        growth = tuple(high / low for low, high in zip(costs[0].samples, costs[-1].samples, strict=True))
        over = f"{what}, {STIFFNESS[-1]:.0e} N/m over {STIFFNESS[0]:.0e} N/m"
        results += [*costs, Result("stiffness", over, "times", growth, bar=GROWTH, at_most=True)]
    return results
