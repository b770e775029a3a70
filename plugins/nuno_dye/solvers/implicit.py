"""Implicit steps of any length: diffusion, limits, supplies and adsorption solved together
(nuno_dye.solvers.implicit_sweep).

`sdirk2` (Alexander 1977) takes two backward Euler stages of gamma = 1 - 1/sqrt(2) of the step, the second from the
extrapolated result of the first. It is of second order and has the amplification of TR-BDF2, but needs no rate at the
start, which is unbounded under a new drop. `backward_euler` is of first order and never leaves the bounds.

Next to a jump the first step would overshoot, and fibre would keep the dye that it takes of that: the first step, and
one after cloth or supplies have changed, is taken in parts that double from an explicit step.

Every stage ends with the fluxes of the sweeps' solution, so that dye is conserved to rounding whatever the residual.
Amounts below 0 or above capacity after the second stage go to the neighbours (nuno_dye.solvers.repair). If these cannot
take them, as when many cells fill up in one step, backward Euler takes the step, and `damped` counts it. If its sweeps
do not converge either, the step is taken again as two halves, up to eight times over; then the run ends as unconverged.
"""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from nuno_dye.laws.adsorption import Uptake
from nuno_dye.laws.potential import Curve, raise_levels
from nuno_dye.solvers import solving
from nuno_dye.solvers.implicit_cell import remove_excess
from nuno_dye.solvers.implicit_sweep import Stage, relax, settle
from nuno_dye.solvers.long_steps import Dyed, Layout, LongSteps, Pair, apply_floor
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config

GAMMA = 1.0 - math.sqrt(0.5)
HALVINGS = 8
SWEEPS, SWEEPS_MORE = 200, 60.0
"""The most sweeps of a stage: a constant, and more by the root of the largest sum of weights. Over-relaxation takes
about sqrt(W / 8) for a factor e, and a residual falls by about 20 of those."""
ROUNDING = 8.0 * 2.0**-52
"""Least residual, as a share of the largest amount times the weights of a cell."""


class ImplicitConfig(Config):
    """The scheme of steps, and the accuracy of their solution."""

    start: ClassVar[int] = 1
    """A first step is taken in parts that double from an explicit step."""
    scheme: Literal["sdirk2", "backward_euler"] = Field("sdirk2", description="second or first order in the step")
    residual: float = Field(1e-5, gt=0, le=1e-2, description="of every cell's equation, of the largest amount")


class Implicit(LongSteps):
    """Backward Euler stages, solved by over-relaxation."""

    name: ClassVar[str] = "implicit"
    order: ClassVar[int] = 2
    Config: ClassVar[type[BaseModel]] = ImplicitConfig
    counts = ("sweeps", "damped", "halvings")

    def reach(self, layout: Layout, dyed: Dyed, scale: float) -> float:
        """Return the explicit limits in a step, which are also the largest sum of a cell's weights."""
        return scale * layout.derived.most * dyed.one.steepest

    def step(self, layout: Layout, dyed: Dyed, start: Pair, scale: float) -> Pair | None:
        """Take a step, by halves if it fails. None if these fail, too."""
        return self._step(layout, dyed, start, scale, HALVINGS)

    def _step(self, layout: Layout, dyed: Dyed, start: Pair, scale: float, halvings: int) -> Pair | None:
        """Take one step, or if it fails its halves, `halvings` times over."""
        supplied, two_stages = len(dyed.supplied), layout.config.scheme == "sdirk2"
        after = self._two_stages(layout, dyed, start, scale) if two_stages else None
        if after is None:
            del dyed.supplied[supplied:]
            dyed.totals["damped"] += two_stages
            after = self._stage(layout, dyed, start, start, scale)
        if after is None and halvings > 0 and not layout.derived.system.leave[0]:
            dyed.totals["halvings"] += 1
            middle = self._step(layout, dyed, start, 0.5 * scale, halvings - 1)
            after = None if middle is None else self._step(layout, dyed, middle, 0.5 * scale, halvings - 1)
            if after is None:
                del dyed.supplied[supplied:]
        return after

    def _two_stages(self, layout: Layout, dyed: Dyed, start: Pair, scale: float) -> Pair | None:
        """Take one step of sdirk2. None if it leaves the bounds too far, as when cells fill up in its first stage."""
        share = (1.0 - GAMMA) / GAMMA
        middle = self._stage(layout, dyed, start, start, GAMMA * scale)
        if middle is None:
            return None
        begun = start[0] + share * (middle[0] - start[0]), start[1] + share * (middle[1] - start[1])
        dyed.supplied[-1] *= share
        if dyed.floor is not None and dyed.fixes:
            law = solving.law_of(dyed.one, GAMMA * scale)
            dyed.supplied[-1] -= remove_excess(law, dyed.floor, start[1], begun[1], layout.fibre)
        return self._stage(layout, dyed, start, begun, GAMMA * scale)

    def _stage(self, layout: Layout, dyed: Dyed, start: Pair, begun: Pair, scale: float) -> Pair | None:
        """Return mobile and fixed dye after a stage, None if it fails; `start` is the start of the step."""
        curve, most, weight_sum = dyed.curve, np.maximum(layout.mobile, start[0]), self.reach(layout, dyed, scale)
        uptake = Uptake(begun[1], layout.fibre, *solving.law_of(dyed.one, scale)) if dyed.fixes else None
        guess = np.clip(begun[0], 0.0 if dyed.floor is None else dyed.floor, most)
        largest = float(guess.max())
        floor = _levels(np.zeros_like(guess) if dyed.floor is None else dyed.floor, curve)
        limits = _levels(most, curve) if dyed.limited else None
        weights = layout.weights_of(scale)
        stage = Stage(_levels(guess, curve), np.ones_like(guess), begun[0], start[1], floor, *weights)
        bound = max(layout.config.residual, ROUNDING * (1.0 + weight_sum)) * largest
        sweeps, steepest = (
            int(SWEEPS + SWEEPS_MORE * math.sqrt(weight_sum)),
            weight_sum * _steepest(guess, layout, curve),
        )
        nx, radius = layout.cut.nx, steepest / (1.0 + steepest)
        count, residual = relax(
            sweeps, radius, bound, layout.cuts, stage, curve, uptake, limits, nx, layout.derived.system.leave
        )
        dyed.totals["sweeps"] += count
        out, fixed = np.zeros_like(guess), np.zeros_like(guess) if dyed.fixes else begun[1]
        settle(out, fixed, layout.cuts, stage, curve, uptake, nx)
        if not residual <= bound or layout.repair_bounds(out, most, dyed.floor, scale) != 0:
            share = residual / (largest or 1.0)
            dyed.reason = f"in {2**HALVINGS} parts still leaves a residual of {share:.2g} of the largest amount"
            return None
        dyed.supplied.append(apply_floor(out, dyed.floor, most))
        return out, fixed


def _steepest(guess: Float, layout: Layout, curve: Curve | None) -> float:
    """Return the largest D of the cells that can hold dye, as a share of its upper bound."""
    if curve is None:
        return 1.0
    return min(1.0, curve.knee / max(float(guess[layout.mobile > 0.0].min(initial=np.inf)), curve.knee))


def _levels(values: Float, curve: Curve | None) -> Float:
    """Return G of amounts in the kernel's layout; the amounts themselves if D is constant."""
    if curve is None:
        return values
    levels = np.empty_like(values)
    raise_levels(values, curve, levels)
    return levels
