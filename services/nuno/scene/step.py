"""A scene's steps, of its cloth and of its dye: whole steps make a frame, and none is longer than what is stable."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import State
from nuno_schemas.system import StepLimit, System

ROUNDING = 1e-6
"""Relative: a step that is a limit, or a part of a frame, and written in seven digits may differ from it by this."""
MOST_STEPS = 10_000_000
"""Steps a frame: more would keep the simulation from answering for minutes."""
SAFE, SAFE_DYE = 0.7, 0.9
"""Share of the limit that `dt: auto` takes. Cloth that stretches or folds is somewhat stiffer than at its start, where
the limit is measured. Of dye it is exact, but at it the finest checkerboard of amounts swaps for ever and does not
fade."""


def find_limit(loaded: Loaded, solver: Any, system: System, start: State) -> StepLimit:
    """How long a step of the cloth can be, by its solver. Raises BadInput where that is not to be found."""
    try:
        with np.errstate(all="ignore"):
            found: StepLimit = solver.limit(loaded.integrator.config, system, start)
    except (np.linalg.LinAlgError, ArithmeticError):
        found = StepLimit(np.nan, np.nan, np.nan)
    if np.isnan(found.dt):
        error = BadInput(
            "no stable step can be found: numbers of the scene are too large or too small for float64",
            remedy="look for a stiffness, mass or length that is off by many orders of magnitude",
        )
        raise loaded.at("objects", error)
    return found


def nearest_steps(dt: float, frame: float) -> int:
    """Whole steps that make a frame [s], each as near as can be to dt [s]."""
    return max(1, round(frame / dt))


def choose_step(loaded: Loaded, limit: float, resolved: float = math.inf, dyed: bool = False) -> tuple[int, float]:
    """Steps a frame and the step [s], of the cloth or of dyeing: the scene's, or the largest safe one for `dt: auto`.

    Of a step that does not divide a frame the nearest is taken that does. `limit` [s] is the longest stable step; auto
    does not exceed `resolved` [s] either (StepLimit). Raises BadInput for a step that is longer than a frame, for one
    that does not divide it where the solver is strict, and for one above the limit unless the scene allows it: of its
    cloth it is then taken as it is, of dye in several shorter ones.
    """
    scene, dye = loaded.scene, loaded.scene.dye if dyed else None
    solver, field = (scene.solver, "solver") if dye is None else (dye.solver, "dye.solver")
    speed, softer = (1.0, "softer or heavier cloth") if dye is None else (dye.speed, "larger cells")
    dt, frame = solver.dt, speed / scene.frame_rate
    if dt == "auto":
        if limit <= 0.0:
            problem = "no step is stable for this integrator on an undamped scene"
            remedy = "use symplectic_euler, leapfrog or rk4, or give a dt and allow_unstable: true"
            raise loaded.at(f"{field}.plugin", BadInput(problem, remedy=remedy))
        longest = min((SAFE_DYE if dyed else SAFE) * limit, resolved)
        _require_few(loaded, f"{field}.dt", frame, longest, f"{softer}, or a higher frame_rate")
        steps = max(1, math.ceil(frame / longest))
        return steps, frame / steps
    _require_few(loaded, f"{field}.dt", frame, dt, "a larger dt, or a higher frame_rate")
    whole = dt <= frame * (1.0 + ROUNDING)
    steps = nearest_steps(dt, frame)
    taken = frame / steps if whole else dt
    above = taken > limit * (1.0 + ROUNDING)
    allowed = "allow_unstable: true" if dye is None else "substeps: allowed"
    accepted = scene.allow_unstable if dye is None else dye.solver.substeps == "allowed"
    if above and not accepted and (whole or not dyed):
        nearest = "" if abs(taken - dt) <= ROUNDING * dt else f", the nearest to {dt:g} s that divides a frame"
        shorter = f"dt: {frame / (steps + 1):.7g} s" if nearest and dt <= limit else "a smaller dt"
        error = BadInput(
            "the step is above the stability limit",
            value=f"{taken:g} s{nearest}",
            limit=f"{limit:.4g} s for {solver.plugin}",
            remedy=f"use dt: auto, {shorter}, {softer}, or {allowed}",
        )
        raise loaded.at(f"{field}.dt", error)
    if not whole:
        faster = f", a dye.speed of at least {dt * scene.frame_rate:.9g}" if dyed else ""
        remedy = f"a frame_rate of at most {speed / dt:.9g} Hz{faster}, or a smaller dt"
        error = BadInput("a frame is shorter than a step", value=_said(dt, frame), remedy=remedy)
        raise loaded.at(f"{field}.dt", error)
    if solver.strict and abs(taken - dt) > ROUNDING * dt:
        near = sorted({max(1, steps - 1), steps, steps + 1}, key=lambda n: abs(frame / n - dt))[:2]
        choices = " or ".join(f"{frame / n:.7g} s ({n} steps)" for n in near)
        remedy = f"nearest that divide it: {choices}; or dt: auto, or strict: false"
        error = BadInput("a frame is not a whole number of steps", value=_said(dt, frame), remedy=remedy)
        raise loaded.at(f"{field}.dt", error)
    if not (dyed and above):
        return steps, frame / steps
    _require_few(loaded, f"{field}.dt", frame, limit, f"{softer}, or a higher frame_rate")
    parts = math.ceil(taken / limit * (1.0 - ROUNDING))
    return steps * parts, frame / steps / parts


def _said(dt: float, frame: float) -> str:
    return f"steps of {dt:.3g} s in frames of {frame:.3g} s"


def _require_few(loaded: Loaded, field: str, frame: float, dt: float, remedy: str) -> None:
    """Raises BadInput, at the scene's `field`, for more steps of dt [s] in a frame [s] than MOST_STEPS."""
    if frame > MOST_STEPS * dt:
        limit = f"{MOST_STEPS:,} steps a frame"
        error = BadInput("too many steps in a frame", value=_said(dt, frame), limit=limit, remedy=remedy)
        raise loaded.at(field, error)
