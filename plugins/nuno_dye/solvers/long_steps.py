"""What solvers of long steps share: how a step begins after a jump, the kernels' layout, and what supplies gave."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nuno_dye.solvers.bands import Cut
from nuno_dye.solvers.diffusion import LEFT, Rows, Weights
from nuno_dye.solvers.repair import repair
from nuno_dye.solvers.solving import Banded, count_bands, know
from nuno_dye.solvers.upkeep import sum_compensated
from nuno_schemas.dye import DyeSystem
from nuno_schemas.fabric import Float

BEYOND = 1e3
"""What a kept-up cell may hold beyond its capacity while others' excess is moved."""
MOST_WEIGHTS = 4
"""Lengths of steps whose weights are kept."""


class LongSteps(Banded):
    """A solver that takes steps of any length."""

    def limit(self, config: Any, system: DyeSystem) -> float:
        """No limit: every step is stable."""
        return math.inf


class Layout:
    """What was made from a system for kernels of long steps.

    Arrays (2 r, w) hold the weft's rows before the warp's, with `margin` more rows beyond than every layout has.

    cuts     (b + 1,) first rows of the bands, and the one after the last
    mobile   V_u
    fibre    V_d
    fed      what depends on what supplies keep up
    weights  of the faces, by D0 dt / d^2
    """

    def __init__(self, config: Any, margin: int, system: DyeSystem) -> None:
        self.config, self.margin, self.known, cells = config, margin, know(system), system.cells
        self.cut = cut = Cut(cells.fibre.shape, 1, margin)
        self.cuts: Rows = cut.top + np.linspace(0, cut.ny, count_bands(system) + 1).astype(np.int64)
        self.mobile, self.fibre = self.planes(cells.mobile_room), self.planes(cells.fixed_room)
        self.fed: dict[Any, Any] = {}
        self.weights: dict[float, Weights] = {}

    def made_for(self, system: DyeSystem) -> Layout:
        """A layout for another system, of the same configuration."""
        return Layout(self.config, self.margin, system)

    def planes(self, amounts: Float) -> Float:
        """(2 r, w) amounts (2, ny, nx) in this layout."""
        return np.asarray(self.cut.fill(amounts)[0][0])

    def weights_of(self, scale: float) -> Weights:
        """Weights of the faces at D0 dt / d^2; those of the last few lengths of steps are kept."""
        if scale not in self.weights:
            if len(self.weights) >= MOST_WEIGHTS:
                self.weights.clear()
            self.weights[scale] = Weights(*(plane[0] for plane in self.cut.fill_faces(self.known.faces, scale)))
        return self.weights[scale]

    def write_back(self, amounts: tuple[Float, Float], phi: Float, fixed: Float) -> None:
        """Put mobile and fixed amounts (2 r, w) into (2, ny, nx)."""
        cut = self.cut
        for values, out in zip(amounts, (phi, fixed), strict=True):
            for layer in range(2):
                at = cut.top + layer * cut.height
                out[layer] = values[at : at + cut.ny, LEFT : LEFT + cut.nx]

    def mend(self, phi: Float, most: Float, floor: Float | None, scale: float) -> int:
        """Bring amounts (2 r, w) into 0 .. `most`, in place; how many cells still lie outside.

        Kept-up cells take any excess of their neighbours': it is given back to the supply that fed them.
        """
        bounds = most if floor is None else np.where(floor > 0.0, most + BEYOND, most)
        least, cut = np.zeros_like(phi) if floor is None else floor, self.cut
        return repair(phi, bounds, least, self.weights_of(scale), cut.top, cut.top + cut.ny - 1, cut.nx)


def keep_up(phi: Float, floor: Float | None, most: Float) -> float:
    """Bring kept-up cells between their floor and `most`, in place; what that took, less what it gave back."""
    if floor is None:
        return 0.0
    kept = np.where(floor > 0.0, np.clip(phi, floor, most), phi)
    given = sum_compensated((kept - phi).reshape(-1))
    np.copyto(phi, kept)
    return given


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
