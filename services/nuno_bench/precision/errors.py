"""How far a run is from the reference, in positions and in what is observed, as shares of the scene's own scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nuno_bench.problem.observe import Series
from nuno_schemas.fabric import Float

RAN_AWAY = 2.0
"""A run that comes this many times its scale away from the reference has left it, whatever chaos does."""


@dataclass(frozen=True)
class Error:
    """Shares of the scale: at the last compared frame, root mean square and largest over the frames.

    Of the leading quantity final and l2 are root mean squares over the vertices or cells too, and linf is that of
    the farthest one.
    """

    final: float
    l2: float
    linf: float


def measure_errors(run: Series, reference: Series, scales: Mapping[str, float], frames: int) -> dict[str, Error]:
    """Errors by quantity, divided by the reference's `scales`; of the leading one over the first `frames` frames, and
    only where there are some beside the start.

    Nothing where a run did not reach the end: its errors would be those of another stretch of time.
    """
    if len(run.t) < len(reference.t):
        return {}
    over = errors_over_frames(run, reference, scales, frames)
    found = {name: Error(float(e[-1]), float(np.sqrt((e**2).mean())), float(e.max())) for name, e in over.items()}
    leading = reference.leading
    if leading in found:
        farthest = np.linalg.norm(run.x[1:frames] - reference.x[1:frames], axis=2).max() / scales[leading]
        found[leading] = replace(found[leading], linf=float(farthest))
    return found


def errors_over_frames(run: Series, reference: Series, scales: Mapping[str, float], frames: int) -> dict[str, Float]:
    """The error at every compared frame but the first, by quantity; of the leading one its root mean square."""
    found: dict[str, Float] = {}
    if frames > 1:
        found[reference.leading] = _apart(run, reference)[1:frames] / scales[reference.leading]
    for name, values in reference.values.items():
        found[name] = np.linalg.norm(run.values[name][1:] - values[1:], axis=1) / scales[name]
    return found


def ran_away(run: Series, reference: Series, size: float) -> float | None:
    """When a run was first RAN_AWAY times `size` from the reference [s], or None."""
    frames = np.flatnonzero(~(_apart(run, reference) <= RAN_AWAY * size))
    return float(run.t[frames[0]]) if frames.size else None


def _apart(run: Series, reference: Series) -> Float:
    """Root mean square distance at each of the run's frames (f,)."""
    apart: Float = np.sqrt(((run.x - reference.x[: len(run.t)]) ** 2).sum(axis=2).mean(axis=1))
    return apart
