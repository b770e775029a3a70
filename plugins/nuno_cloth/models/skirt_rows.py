"""The start of a skirt: rows of cloth, each on its own closed curve, one below the other."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nuno_geometry.centreline import lengths as lengths_along
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

SAMPLES = 2048
"""Points at which a row's curve is sampled."""

ROUNDS = 4
UNFOLDED = 1e-9
"""Cloth that exceeds its circle by a smaller share than this has no folds."""

Curve = Callable[[int, float], Float]
"""Returns for a row's number and a length [m] a closed curve (p, 2) [m] about as long, its last point the first."""


def drape(columns: int, step: float, circle: Float, curve: Curve) -> Float:
    """Return starting positions (rows, columns, 3) [m] about the middle of the waist, of rows that are `circle` (rows,)
    long and `step` apart [m]. Columns start at +x and run towards -z.

    Waves, heights and steps around depend on each other: chords are shorter than the curve they
    span, and rise and fall along a row add to its length. A few rounds make the steps of
    each row equal and as long together as its cloth.
    """
    rows = len(circle)
    steps = np.tile(np.arange(columns + 1) / columns, (rows, 1))
    even = steps[0].copy()
    aim = circle.copy()
    position = np.empty((rows, columns, 3))
    for _ in range(ROUNDS):
        for row in range(rows):
            ring = curve(row, float(aim[row]))
            arc_lengths = lengths_along(ring)
            arc = steps[row, :-1] * arc_lengths[-1]
            position[row, :, 0] = np.interp(arc, arc_lengths, ring[:, 0])
            position[row, :, 2] = -np.interp(arc, arc_lengths, ring[:, 1])
        position[0, :, 1] = 0.0
        position[1:, :, 1] = -np.cumsum(_fall(position[..., [0, 2]], step), axis=0)
        for row in range(rows):
            arc_lengths = lengths_along(np.concatenate([position[row], position[row, :1]]))
            steps[row] = np.interp(even, arc_lengths / arc_lengths[-1], steps[row])
            aim[row] *= circle[row] / arc_lengths[-1]
    return position


def ellipses(radius: Float, ratio: float, circle: Float, pleats: int) -> Curve:
    """Return ellipses, as long as circles of `radius` (rows,) [m], with waves where the cloth, `circle` (rows,), is
    longer. `ratio` is an ellipse's depth over its width. Raises BadInput for waves that would reach the axis.
    """
    around = np.linspace(0, 2 * np.pi, SAMPLES + 1)
    outline = np.stack([np.cos(around), ratio * np.sin(around)], -1)
    outline *= 2 * np.pi / lengths_along(outline)[-1]
    phase = lengths_along(outline) * pleats
    depths, lengths = _wave_depths(outline, phase)
    fullness = circle[-1] / radius[-1]
    if fullness > lengths[-1]:
        raise BadInput("the folds would reach the axis", field="fullness", remedy="more pleats, or less fullness")
    folded = fullness > 2 * np.pi * (1 + UNFOLDED)

    def curve(row: int, length: float) -> Float:
        depth = np.interp(length / radius[row], lengths, depths) if folded else 0.0
        return np.asarray(radius[row] * outline * (1 + depth * np.cos(phase))[:, None])

    return curve


def _wave_depths(outline: Float, phase: Float) -> tuple[Float, Float]:
    """Return depths of waves on a ring over its radius, and the lengths that they give it, over its radius. The length
    grows with the square of small depths, and so do the table's steps.
    """
    depths = 0.95 * np.linspace(0, 1, 256) ** 2
    return depths, np.array([lengths_along(outline * (1 + depth * np.cos(phase))[:, None])[-1] for depth in depths])


def _fall(flat: Float, step: float) -> Float:
    """Return the drop (rows - 1, columns) of each warp edge [m] that keeps the edge's length."""
    outwards = np.square(np.diff(flat, axis=0)).sum(axis=-1)
    down: Float = np.sqrt(np.maximum(step**2 - outwards, (0.1 * step) ** 2))
    return down
