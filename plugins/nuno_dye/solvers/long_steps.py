"""What solvers of long steps share: how a step begins after a jump, weights by length, and the way back to cells."""

from __future__ import annotations

import math

import numpy as np

from nuno_dye.laws.faces import Faces
from nuno_dye.solvers.bands import Cut
from nuno_dye.solvers.diffusion import LEFT
from nuno_dye.solvers.rkl2_stage import Weights
from nuno_schemas.fabric import Float

BEYOND = 1e3
"""What a kept-up cell may hold beyond its capacity while others' excess is moved."""
MOST_WEIGHTS = 4
"""Lengths of steps whose weights are kept."""


def split_steps(since: int, steps: int, reach: float, start: int) -> Float:
    """Shares of a step, in order, that `steps` steps are taken in, `since` steps after amounts have jumped.

    What a jump spreads depends on r^2 / t, so that steps of equal error grow with the time since: every doubling of
    it takes `start` of them at least. The first step begins with a `start`-th of an explicit step, `reach` of which
    it is long. Fibre keeps what it takes meanwhile, so that no later step would mend it.
    """
    shares: list[float] = []
    for n in range(since, since + steps):
        if n == 0:
            doublings = max(0, math.ceil(math.log2(max(reach, 1.0))))
            for length in (0.5**doublings, *(0.5**i for i in range(doublings, 0, -1))):
                shares += [length / start] * start
        else:
            parts = -(-start // n)
            shares += [1.0 / parts] * parts
    return np.array(shares)


def weights_of(kept: dict[float, Weights], cut: Cut, faces: Faces, scale: float) -> Weights:
    """Weights of the faces in the kernels' layout at D0 dt / d^2, from those that are kept if they are there."""
    if scale not in kept:
        if len(kept) >= MOST_WEIGHTS:
            kept.clear()
        kept[scale] = Weights(*(plane[0] for plane in cut.fill_faces(faces, scale)))
    return kept[scale]


def write_back(cut: Cut, amounts: tuple[Float, Float], phi: Float, fixed: Float) -> None:
    """Mobile and fixed amounts from the kernels' layout into (2, ny, nx)."""
    for values, out in zip(amounts, (phi, fixed), strict=True):
        for layer in range(2):
            at = cut.top + layer * cut.height
            out[layer] = values[at : at + cut.ny, LEFT : LEFT + cut.nx]
