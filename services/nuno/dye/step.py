"""A dye solver's step: whole steps make a frame, and none is longer than what is stable."""

from __future__ import annotations

import math

from nuno.scene.scene_file import Loaded
from nuno.scene.step import require_few, whole_steps
from nuno_schemas.dyeing import Dyeing
from nuno_schemas.errors import BadInput

FIELD = "dye.solver.dt"
SAFE = 0.9
"""Share of the limit that `dt: auto` takes. The limit is exact, but at it the finest checkerboard of
amounts swaps for ever and does not fade."""
ROUNDING = 1e-12
"""Relative: a step computed as the limit itself may come out longer by this."""


def choose_dye_step(loaded: Loaded, dye: Dyeing, limit: float, resolved: float = math.inf) -> tuple[int, float]:
    """Steps a frame and the step [s] of dyeing, for a solver that is stable up to `limit` [s].

    `dt: auto` takes no more than `resolved` [s] either.

    Raises BadInput for a step longer than a frame, one that does not divide it, and one above the limit
    where the scene does not allow substeps.
    """
    rate, dt = loaded.scene.frame_rate, dye.solver.dt
    frame = dye.speed / rate
    if dt == "auto":
        longest = min(SAFE * limit, resolved)
        require_few(loaded, FIELD, frame, longest, "larger cells, or a higher frame_rate")
        steps = max(1, math.ceil(frame / longest))
        return steps, frame / steps
    if dt > frame * (1.0 + ROUNDING):
        value = f"steps of {dt:g} s in frames of {frame:g} s"
        remedy = f"a frame_rate of at most {dye.speed / dt:.9g} Hz, a dye.speed of at least {dt * rate:.9g}"
        remedy += ", or a smaller dt"
        raise loaded.at(FIELD, BadInput("a frame is shorter than a step", value=value, remedy=remedy))
    steps, dt = whole_steps(loaded, FIELD, frame, dt)
    if dt <= limit * (1.0 + ROUNDING):
        return steps, dt
    if dye.solver.substeps == "refused":
        error = BadInput(
            "the step is above the stability limit",
            value=f"{dt:g} s",
            limit=f"{limit:.6g} s for {dye.solver.plugin}",
            remedy="use dt: auto, a smaller dt, larger cells, or substeps: allowed",
        )
        raise loaded.at(FIELD, error)
    require_few(loaded, FIELD, frame, limit, "larger cells, or a higher frame_rate")
    parts = math.ceil(dt / limit * (1.0 - ROUNDING))
    return steps * parts, dt / parts
