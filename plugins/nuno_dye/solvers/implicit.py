"""Implicit steps of any length: diffusion, limits, supplies and adsorption solved together
(nuno_dye.solvers.implicit_sweep).

`sdirk2` (Alexander 1977) takes two backward Euler stages of gamma = 1 - 1/sqrt(2) of the step, the second from what
the first, prolonged, came to: of second order, and damping as TR-BDF2 does, whose amplification it has; but its first
stage asks for no rate at the start, which is without bounds where a drop was just put. `backward_euler` is of first
order and never leaves the bounds.

Beside a jump the first step would overshoot, and fibre keeps what it takes of that: the first one, and one after
cloth or supplies have changed, is taken in parts that double from an explicit step on.

Every stage ends with the fluxes of what the sweeps found, so that dye is kept to rounding whatever residual they
leave. What the second stage takes below nothing or above capacity goes to the neighbours (nuno_dye.solvers.repair).
Where they cannot take it, as where many cells fill up in one step, backward Euler takes the step, and `damped` counts
it. Where its sweeps do not converge either, the step is taken again as two halves, eight times over; then the run ends
as unconverged.
"""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from nuno_dye.laws.adsorption import Uptake
from nuno_dye.laws.potential import Curve, raise_levels
from nuno_dye.solvers import solving
from nuno_dye.solvers.implicit_cell import hold_back
from nuno_dye.solvers.implicit_sweep import Stage, relax, settle
from nuno_dye.solvers.long_steps import Dyed, Layout, LongSteps, Pair, keep_up
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config

GAMMA = 1.0 - math.sqrt(0.5)
HALVINGS = 8
SWEEPS, SWEEPS_MORE = 200, 60.0
"""Sweeps of a stage at most: some, and more by the root of the largest sum of weights. Over-relaxation takes about
sqrt(W / 8) for a factor e, and a residual falls by about 20 of those."""
ROUNDING = 8.0 * 2.0**-52
"""No residual becomes smaller than this share of the largest amount times the weights of a cell."""


class ImplicitConfig(Config):
    """How steps are taken and solved."""

    start: ClassVar[int] = 1
    """A first step is taken in parts that double from an explicit step on."""
    scheme: Literal["sdirk2", "backward_euler"] = Field("sdirk2", description="second or first order in the step")
    residual: float = Field(1e-5, gt=0, le=1e-2, description="of every cell's equation, of the largest amount")


class Implicit(LongSteps):
    """Backward Euler stages, solved by over-relaxation."""

    name: ClassVar[str] = "implicit"
    order: ClassVar[int] = 2
    Config: ClassVar[type[BaseModel]] = ImplicitConfig
    counts = ("sweeps", "damped", "halvings")

    def reach(self, layout: Layout, dyed: Dyed, scale: float) -> float:
        """See LongSteps; it is the largest sum of a cell's weights, too."""
        return scale * layout.known.most * dyed.one.steepest

    def step(self, layout: Layout, dyed: Dyed, start: Pair, scale: float) -> Pair | None:
        """See LongSteps."""
        return self._step(layout, dyed, start, scale, HALVINGS)

    def _step(self, layout: Layout, dyed: Dyed, start: Pair, scale: float, halvings: int) -> Pair | None:
        """One step, or where it fails its halves, `halvings` times over."""
        given, two = len(dyed.given), layout.config.scheme == "sdirk2"
        after = self._two_stages(layout, dyed, start, scale) if two else None
        if after is None:
            del dyed.given[given:]
            dyed.totals["damped"] += two
            after = self._stage(layout, dyed, start, start, scale)
        if after is None and halvings > 0 and not layout.known.system.leave[0]:
            dyed.totals["halvings"] += 1
            middle = self._step(layout, dyed, start, 0.5 * scale, halvings - 1)
            after = None if middle is None else self._step(layout, dyed, middle, 0.5 * scale, halvings - 1)
            if after is None:
                del dyed.given[given:]
        return after

    def _two_stages(self, layout: Layout, dyed: Dyed, start: Pair, scale: float) -> Pair | None:
        """One step of sdirk2, None where it leaves the bounds too far, as where cells fill up in its first stage."""
        share = (1.0 - GAMMA) / GAMMA
        middle = self._stage(layout, dyed, start, start, GAMMA * scale)
        if middle is None:
            return None
        begun = start[0] + share * (middle[0] - start[0]), start[1] + share * (middle[1] - start[1])
        dyed.given[-1] *= share
        if dyed.floor is not None and dyed.fixes:
            law = solving.law_of(dyed.one, GAMMA * scale)
            dyed.given[-1] -= hold_back(law, dyed.floor, start[1], begun[1], layout.fibre)
        return self._stage(layout, dyed, start, begun, GAMMA * scale)

    def _stage(self, layout: Layout, dyed: Dyed, start: Pair, begun: Pair, scale: float) -> Pair | None:
        """Mobile and fixed dye after a stage, None where it fails; `start` is what the step starts from."""
        curve, most, ways = dyed.curve, np.maximum(layout.mobile, start[0]), self.reach(layout, dyed, scale)
        uptake = Uptake(begun[1], layout.fibre, *solving.law_of(dyed.one, scale)) if dyed.fixes else None
        guess = np.clip(begun[0], 0.0 if dyed.floor is None else dyed.floor, most)
        largest = float(guess.max())
        floor = _levels(np.zeros_like(guess) if dyed.floor is None else dyed.floor, curve)
        limits = _levels(most, curve) if dyed.limited else None
        weights = layout.weights_of(scale)
        stage = Stage(_levels(guess, curve), np.ones_like(guess), begun[0], start[1], floor, *weights)
        bound = max(layout.config.residual, ROUNDING * (1.0 + ways)) * largest
        sweeps, steepest = int(SWEEPS + SWEEPS_MORE * math.sqrt(ways)), ways * _steepest(guess, layout, curve)
        nx, radius = layout.cut.nx, steepest / (1.0 + steepest)
        count, residual = relax(
            sweeps, radius, bound, layout.cuts, stage, curve, uptake, limits, nx, layout.known.system.leave
        )
        dyed.totals["sweeps"] += count
        out, held = np.zeros_like(guess), np.zeros_like(guess) if dyed.fixes else begun[1]
        settle(out, held, layout.cuts, stage, curve, uptake, nx)
        if not residual <= bound or layout.mend(out, most, dyed.floor, scale) != 0:
            share = residual / (largest or 1.0)
            dyed.why = f"in {2**HALVINGS} parts still leaves a residual of {share:.2g} of the largest amount"
            return None
        dyed.given.append(keep_up(out, dyed.floor, most))
        return out, held


def _steepest(guess: Float, layout: Layout, curve: Curve | None) -> float:
    """The largest D of the cells that can hold dye, as a share of the largest that there can be."""
    if curve is None:
        return 1.0
    return min(1.0, curve.knee / max(float(guess[layout.mobile > 0.0].min(initial=np.inf)), curve.knee))


def _levels(values: Float, curve: Curve | None) -> Float:
    """G of amounts in the kernel's layout; the amounts themselves where D is constant."""
    if curve is None:
        return values
    levels = np.empty_like(values)
    raise_levels(values, curve, levels)
    return levels
