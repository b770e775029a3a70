"""A scene's step: whole steps make a frame, and none is longer than what is stable."""

from __future__ import annotations

import math

import numpy as np

from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput

SECONDS_TOLERANCE = 1e-9
MOST_STEPS = 10_000_000
"""Steps a frame: more would keep the simulation from answering for minutes."""


def choose_step(loaded: Loaded, limit: float, resolved: float = math.inf) -> tuple[int, float]:
    """Steps a frame and the step [s]: the scene's, or the largest safe one for `dt: auto`.

    Auto stays at 0.7 of the limit: cloth that stretches or folds is somewhat stiffer than at its
    start, where the limit is measured. Nor does it exceed `resolved` (StepLimit). Raises BadInput for
    a step that does not divide a frame or exceeds the limit without allow_unstable.
    """
    frame = 1.0 / loaded.scene.frame_rate
    dt = loaded.scene.solver.dt
    if dt == "auto":
        if limit <= 0.0:
            raise loaded.at(
                "solver.plugin",
                BadInput(
                    "no step is stable for this integrator on an undamped scene",
                    remedy="use symplectic_euler, leapfrog or rk4, or give a dt and allow_unstable: true",
                ),
            )
        longest = min(0.7 * limit, resolved)
        require_few(loaded, "solver.dt", frame, longest, "softer or heavier cloth, or a higher frame_rate")
        steps = max(1, int(np.ceil(frame / longest)))
        return steps, frame / steps
    # Before what divides a frame: the nearest step that does may be above the limit as well.
    if dt > limit * (1.0 + SECONDS_TOLERANCE) and not loaded.scene.allow_unstable:
        raise loaded.at(
            "solver.dt",
            BadInput(
                "the step is above the stability limit",
                value=f"{dt:g} s",
                limit=f"{limit:.4g} s for {loaded.integrator.name}",
                remedy="use dt: auto, a smaller dt, softer cloth, or allow_unstable: true",
            ),
        )
    return whole_steps(loaded, "solver.dt", frame, dt)


def whole_steps(loaded: Loaded, field: str, frame: float, dt: float) -> tuple[int, float]:
    """Steps in a frame [s] for the scene's `field`, a step of dt [s], and the step that divides a frame exactly.

    Raises BadInput where no whole number of steps comes close.
    """
    require_few(loaded, field, frame, dt, "a larger dt, or a higher frame_rate")
    steps = max(1, round(frame / dt))
    if abs(frame / steps - dt) > SECONDS_TOLERANCE * dt + 1e-15:
        near = sorted({max(1, steps - 1), steps, steps + 1}, key=lambda n: abs(frame / n - dt))[:2]
        choices = " or ".join(f"{frame / n:.9g} s ({n} steps)" for n in near)
        raise loaded.at(
            field,
            BadInput(
                "a frame is not a whole number of steps",
                value=f"{dt:g} s in frames of {frame:g} s",
                remedy=f"nearest that divide it: {choices}; or dt: auto",
            ),
        )
    return steps, frame / steps


def require_few(loaded: Loaded, field: str, frame: float, dt: float, remedy: str) -> None:
    """Raises BadInput, at the scene's `field`, for more steps of dt [s] in a frame [s] than MOST_STEPS."""
    if frame > MOST_STEPS * dt:
        value, limit = f"steps of {dt:.3g} s in frames of {frame:.3g} s", f"{MOST_STEPS:,} steps a frame"
        error = BadInput("too many steps in a frame", value=value, limit=limit, remedy=remedy)
        raise loaded.at(field, error)
