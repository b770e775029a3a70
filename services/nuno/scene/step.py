"""Choice of the step of a scene's cloth and dye: a frame is a whole number of stable steps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import State
from nuno_schemas.system import StepLimit, System

ROUNDING = 1e-6
"""Relative tolerance of a step written in seven digits, against the limit or a part of a frame."""
MOST_STEPS = 10_000_000
"""Most steps a frame: with more, the simulation would not answer for minutes."""
SAFE, SAFE_DYE = 0.7, 0.9
"""Share of the limit that `dt: auto` takes. Cloth that stretches or folds is somewhat stiffer than at its start, where
the limit is measured. The limit of dye is exact, but at it the finest checkerboard of amounts alternates forever and
does not fade."""


def find_limit(loaded: Loaded, solver: Any, system: System, start: State) -> StepLimit:
    """Return the longest step of the cloth, by its solver. Raises BadInput where there is none."""
    try:
        with np.errstate(all="ignore"):
            limit: StepLimit = solver.limit(loaded.integrator.config, system, start)
    except (np.linalg.LinAlgError, ArithmeticError):
        limit = StepLimit(np.nan, np.nan, np.nan)
    if np.isnan(limit.dt):
        error = BadInput(
            "no stable step can be found: numbers of the scene are too large or too small for float64",
            remedy="look for a stiffness, mass or length that is off by many orders of magnitude",
        )
        raise loaded.at("objects", error)
    return limit


def nearest_steps(dt: float, frame: float) -> int:
    """Return the whole number of steps in a frame [s] whose length is nearest to dt [s]."""
    return max(1, round(frame / dt))


def choose_step(loaded: Loaded, limit: float, resolved: float = math.inf, dyed: bool = False) -> tuple[int, float]:
    """Return the steps a frame and the step [s] of cloth or dye: the scene's, or the largest safe one for `dt: auto`.

    A step that does not divide a frame is replaced by the nearest that does. `limit` [s] is the longest stable step;
    auto does not exceed `resolved` [s] either (StepLimit). Raises BadInput for a step that is longer than a frame, for
    one that does not divide it where the solver is strict, and for one above the limit unless the scene allows it:
    cloth then keeps it, and dye divides it.
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
    fits = dt <= frame * (1.0 + ROUNDING)
    steps = nearest_steps(dt, frame)
    step = frame / steps if fits else dt
    above = step > limit * (1.0 + ROUNDING)
    allowed = "allow_unstable: true" if dye is None else "substeps: allowed"
    accepted = scene.allow_unstable if dye is None else dye.solver.substeps == "allowed"
    if above and not accepted and (fits or not dyed):
        nearest = "" if abs(step - dt) <= ROUNDING * dt else f", the nearest to {dt:g} s that divides a frame"
        shorter = f"dt: {frame / (steps + 1):.7g} s" if nearest and dt <= limit else "a smaller dt"
        error = BadInput(
            "the step is above the stability limit",
            value=f"{step:g} s{nearest}",
            limit=f"{limit:.4g} s for {solver.plugin}",
            remedy=f"use dt: auto, {shorter}, {softer}, or {allowed}",
        )
        raise loaded.at(f"{field}.dt", error)
    if not fits:
        faster = f", a dye.speed of at least {dt * scene.frame_rate:.9g}" if dyed else ""
        remedy = f"a frame_rate of at most {speed / dt:.9g} Hz{faster}, or a smaller dt"
        error = BadInput("a frame is shorter than a step", value=_step_text(dt, frame), remedy=remedy)
        raise loaded.at(f"{field}.dt", error)
    if solver.strict and abs(step - dt) > ROUNDING * dt:
        candidates = sorted({max(1, steps - 1), steps, steps + 1}, key=lambda n: abs(frame / n - dt))[:2]
        choices = " or ".join(f"{frame / n:.7g} s ({n} steps)" for n in candidates)
        remedy = f"nearest that divide it: {choices}; or dt: auto, or strict: false"
        error = BadInput("a frame is not a whole number of steps", value=_step_text(dt, frame), remedy=remedy)
        raise loaded.at(f"{field}.dt", error)
    if not (dyed and above):
        return steps, frame / steps
    _require_few(loaded, f"{field}.dt", frame, limit, f"{softer}, or a higher frame_rate")
    parts = math.ceil(step / limit * (1.0 - ROUNDING))
    return steps * parts, frame / steps / parts


def _step_text(dt: float, frame: float) -> str:
    return f"steps of {dt:.3g} s in frames of {frame:.3g} s"


def _require_few(loaded: Loaded, field: str, frame: float, dt: float, remedy: str) -> None:
    """Raise BadInput, at the scene's `field`, for more steps of dt [s] in a frame [s] than MOST_STEPS."""
    if frame > MOST_STEPS * dt:
        limit = f"{MOST_STEPS:,} steps a frame"
        error = BadInput("too many steps in a frame", value=_step_text(dt, frame), limit=limit, remedy=remedy)
        raise loaded.at(field, error)
