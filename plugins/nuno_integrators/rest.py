"""How far every vertex of a cloth is from rest, as a share of what its springs pull with."""

from __future__ import annotations

import math

import numpy as np

from nuno_kernels.forces.yarn_tension import lengths, own_tensions
from nuno_schemas.fabric import Fabric, Float

NO_STRAIN = 1e-11
"""Springs that are strained by less than this share of the cloth's largest coordinate pull with that much: their own
length is known no better, so that cloth without load, which pulls with rounding alone, is at rest."""


def typical_tension(fabric: Fabric, x: Float) -> float:
    """Mean size of the springs' own forces [N] at x (n, 3) [m]; 0 without springs.

    Summed exactly: NumPy's order differs between machines, and this decides which frame is the last.
    """
    springs = fabric.springs
    if springs is None or springs.number == 0:
        return 0.0
    _, length = lengths(springs, x)
    stiffness = math.fsum(springs.per_spring(springs.k).tolist())
    try:
        pull = math.fsum(np.abs(own_tensions(springs, length)).tolist())
    except OverflowError:  # of cloth that flies apart
        pull = math.inf
    return max(pull, NO_STRAIN * float(np.abs(x).max()) * stiffness) / springs.number


def unbalance(fabric: Fabric, x: Float, v: Float, left: Float) -> Float:
    """(n,) distance from rest: the force `left` (n, 3) [N] on each vertex and what its velocity v (n, 3) [m/s] will
    turn into, over the typical tension; 0 for vertices that are held, inf everywhere else in cloth without springs.

    Force alone is no measure of rest: a mass that swings feels none in the middle of its way. With K the stiffness of
    all springs of a vertex, F^2 + m K v^2 is the same all along its swing, the square of the force at its ends.
    """
    far = np.zeros(fabric.number)
    scale = typical_tension(fabric, x)
    springs = fabric.springs
    if springs is None or scale == 0.0:
        return np.where(fabric.pinned, 0.0, np.inf)
    k = springs.per_spring(springs.k)
    stiffness = sum(np.bincount(end, k, fabric.number) for end in springs.pairs().T)
    for axis in range(3):
        far += left[:, axis] ** 2 + fabric.mass * stiffness * v[:, axis] ** 2
    return np.where(fabric.pinned, 0.0, np.sqrt(far) / scale)
