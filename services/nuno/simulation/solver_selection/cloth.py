"""`solver: auto` and `accuracy` for cloth: choice of solver and step, by trials of the scene's first frames.

Rejected: an estimate by formulas (it would need the moving modes, and contact has no order), and timing
the candidates (the choice would differ from run to run; evaluations of the forces are counted instead).
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from typing import Any

import numpy as np

from nuno.collision.bodies import Bodies
from nuno.plugin_contract import registry
from nuno.process import attended
from nuno.runtime.stepper import too_slow
from nuno.scene.scene_file import FIRST, Loaded
from nuno.scene.step import MOST_STEPS
from nuno.simulation import cloth
from nuno.simulation.solver_selection.trials import PROMISE, Budget, Method, Selection, Spent, Trials, written
from nuno_schemas.errors import BadInput
from nuno_schemas.parts import AUTO, Accuracy
from nuno_schemas.system import System

SAFE: dict[Accuracy, float] = {"preview": 0.9, "normal": 0.7, "reference": 0.7}
"""Share of the stable step: cloth that stretches or folds is stiffer than at its start, where that is measured."""
PILOT_WORK, FEWEST_FRAMES = 5e6, 12
"""Most vertices times steps of a trial (0.1 s of a core), and its fewest frames."""
HIGHER, IMPLICIT, KICKED = ("leapfrog", "rk4"), "tr_bdf2", "respa"
EVALUATIONS = {FIRST: 1.0, "rk4": 4.0}
"""Cost of a step in evaluations of the forces."""
TENSION = 0.25
"""Cost of tension in an evaluation with bending, wind and contact: a sixth to a quarter in the shipped scenes."""
STALLED = 0.8
"""Errors that a shorter step does not reduce to this factor are not errors of the step."""


def decide(loaded: Loaded, budget: Budget | None = None) -> Loaded:
    """Return the scene with solver and step as if they were written in it; unchanged if there is nothing to choose. A
    signal ends the trials at once.

    Raises BadInput for an accuracy that the named solver cannot have, and where the budget is used up without a
    result.
    """
    if not loaded.scene.undecided:
        return loaded
    budget = budget or Budget()
    return attended(lambda: _decide(loaded, budget), budget.stop)


def _decide(loaded: Loaded, budget: Budget) -> Loaded:
    if loaded.scene.dye is not None:
        from nuno.simulation.solver_selection.dye import decide_dye  # only scenes with dye import this

        loaded = decide_dye(loaded, budget)
    scene = loaded.scene
    if not scene.step_undecided:
        return loaded
    accuracy = scene.accuracy or "normal"
    first = FIRST if scene.solver.plugin == AUTO else scene.solver.plugin
    if loaded.integrator.plugin.adaptive:
        remedy = "leave accuracy out and give the solver's tolerance, or name another solver"
        raise loaded.at("accuracy", BadInput(f"{first} chooses its own steps", value=accuracy, remedy=remedy))
    system, bodies = cloth.build_scene(loaded, os.cpu_count() or 1)
    if system.fabric.number == 0 or bool(system.fabric.pinned.all()):
        return written(loaded, _solver_fields(loaded, first), "nothing can move, so any will do")
    start = _method(loaded, system, first, SAFE[accuracy])
    if start is None and scene.solver.plugin != AUTO:
        remedy = "give a dt and allow_unstable: true, or use another solver"
        raise loaded.at("solver.plugin", BadInput("no step is stable for this solver on this scene", remedy=remedy))
    trials, selections, over = _trials(loaded, system, bodies, start, budget), list[Selection](), ""
    try:
        _try_all(loaded, trials, start, accuracy, selections)
    except Spent:
        over = budget.over
    if trials.too_slow and not over and all(math.isinf(selection.error) for selection in selections):
        raise too_slow(loaded, "a frame takes longer with every solver that was tried")
    if selections:
        best = min(selections, key=lambda one: (max(one.error, PROMISE[accuracy]), one.cost))
        reason = "; ".join(filter(None, (_reason(trials, best, selections, accuracy), over)))
    elif start is not None:
        best = Selection(start.name, start.fewest, math.inf, start.fewest)
        reason = f"{accuracy}: {best.said[0]}, which are stable; how far they are off is not known, {over}"
    else:
        remedy = "--budget 10min, or name one: solver: {plugin: tr_bdf2, dt: auto}"
        problem, value = "no solver could be tried in the time that is given", f"{budget.seconds:g} s"
        raise loaded.at("solver.plugin", BadInput(problem, value=value, remedy=remedy))
    dt = 1.0 / float(scene.frame_rate) / best.steps
    return written(loaded, _solver_fields(loaded, best.name) | {"dt": dt}, reason)


def _solver_fields(loaded: Loaded, name: str) -> dict[str, Any]:
    """Return a solver with the scene's own fields."""
    return {**loaded.scene.solver.config, "plugin": name}


def _trials(loaded: Loaded, system: System, bodies: Bodies | None, start: Method | None, budget: Budget) -> Trials:
    rate, total, fabric = float(loaded.scene.frame_rate), loaded.scene.frames, system.fabric
    a_frame = fabric.number * (start.fewest if start else 1)
    frames = min(total, max(FEWEST_FRAMES, int(PILOT_WORK / a_frame)))
    poses = tuple(bodies.poses(i / rate) if bodies else None for i in range(frames + 1))
    size = float(np.linalg.norm(np.ptp(fabric.position, axis=0)))
    system = replace(system, leave=budget.leave)
    return Trials(system, poses, 1.0 / rate, total, size or 1.0, budget, loaded.scene.frame_limit)


def _method(loaded: Loaded, system: System, name: str, safe: float) -> Method | None:
    """Return the solver with the scene's fields for it; None where no step of it is stable."""
    plugin, solver = registry.load("nuno.integrators", name), loaded.scene.solver
    config = loaded.integrator.config if solver.plugin == name else plugin.Config()
    frame = 1.0 / float(loaded.scene.frame_rate)
    with np.errstate(all="ignore"):
        limit = float(plugin.limit(config, system, cloth.start_state(system.fabric)).dt)
    # A run would refuse more steps.
    if not limit > 0.0 or (solver.plugin == AUTO and frame > MOST_STEPS * safe * limit):
        return None
    evaluations = EVALUATIONS.get(name, 2 if _reads_velocity(system) else 1)
    if not plugin.explicit:
        evaluations = implicit_evaluations(system.fabric.number)
    fewest = max(1, math.ceil(frame / (safe * limit)))
    if name == KICKED:
        evaluations = TENSION + 1.0 / plugin.steps_a_kick(config, system, frame / fewest, frame)
    return Method(name, plugin, config, evaluations, fewest)


def _reads_velocity(system: System) -> bool:
    """Return whether forces may depend on velocities: leapfrog then takes two evaluations a step."""
    springs, membrane = system.fabric.springs, system.fabric.membrane
    damped = springs is not None and bool((springs.c != 0.0).any())
    damped |= membrane is not None and bool(membrane.damping.any())
    return damped or system.damping != 0.0 or bool(system.terms)


def _try_all(loaded: Loaded, trials: Trials, start: Method | None, accuracy: Accuracy, out: list[Selection]) -> None:
    """Append selections to `out`, from the cheapest step on, until none can be cheaper. Raises Spent."""
    promise = PROMISE[accuracy]
    if start is not None:
        out.append(_settle(trials, start, promise, math.inf))
        if loaded.scene.solver.plugin != AUTO:
            return
    for name in _others(trials.system, start):
        cheapest = min((selection.cost for selection in out if selection.error <= promise), default=math.inf)
        method = _method(loaded, trials.system, name, SAFE[accuracy])
        if method is not None and method.fewest * method.evaluations < cheapest:
            out.append(_settle(trials, method, promise, cheapest))


def implicit_evaluations(vertices: int) -> int:
    """Return the cost of an implicit step in evaluations: for the stiff sheet at 1e7 N/m and one step a frame, it was
    730 for 8 x 8 vertices, 1,400 for 16 x 16, 4,900 for 32 x 32 and 13,600 for 64 x 64.
    """
    return math.ceil(50.0 * math.cbrt(vertices) ** 2)


def _others(system: System, start: Method | None) -> list[str]:
    """Return the methods that may be cheaper than the first. Respa gains nothing with tension alone; forces jump where
    cloth lands or slips, and a higher order does not help there.
    """
    contact = any(term.name == "contact" for term in system.terms)
    stiff = start is None or start.fewest > implicit_evaluations(system.fabric.number)
    fabric = system.fabric
    soft = bool(system.terms) or any(part is not None for part in (fabric.hinges, fabric.bending, fabric.friction))
    return [*((KICKED,) if soft else ()), *(() if contact else HIGHER), *((IMPLICIT,) if stiff else ())]


def _settle(trials: Trials, method: Method, promise: float, cheapest: float) -> Selection:
    """Return the fewest steps a frame that keep the promise, or the error of the method at a cost below `cheapest`."""

    def select(steps: int, error: float, tried: bool = True) -> Selection:
        return Selection(method.name, steps, error, math.ceil(steps * method.evaluations), tried)

    steps, order = method.fewest, method.plugin.order
    error = trials.error(method, steps)
    while error > promise:
        ratio = (error / promise) ** (1.0 / order) if math.isfinite(error) else 2.0
        wanted = math.ceil(steps * max(1.2, 1.05 * ratio))
        if wanted * method.evaluations >= cheapest or not trials.affords(method, wanted):
            return select(wanted, promise if math.isfinite(error) else error, tried=False)
        shorter = trials.error(method, wanted)
        if shorter > STALLED * error and math.isfinite(error):
            return select(steps, error)
        steps, error = wanted, shorter
    return select(steps, error)


def _reason(trials: Trials, best: Selection, selections: list[Selection], accuracy: Accuracy) -> str:
    promise, (steps, error) = PROMISE[accuracy], best.said
    text = f"{accuracy}: with {steps} positions are off by {error} of the cloth's size, {promise:g} was asked for"
    text += ", and no method keeps that" if best.error > promise else ""
    if trials.predictable is not None and trials.predictable < trials.frames:
        text += f" (tried on {trials.predictable} of {trials.total} frames: by then a disturbance grows a thousandfold)"
    elif trials.frames < trials.total:
        text += f" (tried on {trials.frames} of {trials.total} frames)"
    others = [f"{selection.name} {selection.cost}" for selection in selections if selection is not best]
    cost = f"; {best.cost} evaluations of the forces a frame, against " + ", ".join(others)
    return text + (cost if others else "")
