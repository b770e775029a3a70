"""Implicit steps of any length: diffusion, limits, supplies and adsorption solved together, by sweeps over cells.

`sdirk2` (Alexander 1977) takes two backward Euler stages of gamma = 1 - 1/sqrt(2) of the step, the second from the
extrapolated result of the first. It is of second order and has the amplification of TR-BDF2, but needs no rate at the
start, which is unbounded under a new drop. `backward_euler` is of first order and never leaves the bounds.

Next to a jump the first step would overshoot, and fibre would keep the dye that it takes of that: the first step, and
one after cloth or supplies have changed, is taken in parts that double from an explicit step.

Every stage ends with the fluxes of the sweeps' solution, so that dye is conserved to rounding whatever the residual.
Amounts below 0 or above capacity after the second stage go to the neighbours (see nuno_dye.solvers.long_steps). If
these cannot take them, as when many cells fill up in one step, backward Euler takes the step, and `damped` counts it.
If its sweeps do not converge either, the step is taken again as two halves, up to eight times over; then the run ends
as unconverged.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numba import prange
from pydantic import BaseModel, Field

from nuno_dye.laws.adsorption import Uptake, law_in
from nuno_dye.laws.diffusivity import Curve, amount, potential, raise_levels
from nuno_dye.solvers import solving
from nuno_dye.solvers.diffusion import LEFT, Rows
from nuno_dye.solvers.fixing import limit_beside, root_of
from nuno_dye.solvers.long_steps import Dyed, Layout, LongSteps, Pair, apply_floor, face
from nuno_dye.solvers.solving import sum_compensated
from nuno_kernels import kernel, parallel_kernel
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config

# A cell's equation in an implicit stage, with fixed neighbours, and with its fibre and its limits.
#
#     phi + (A - A_b) = b + sum over faces f w (phi_j - phi)
#
# with weights w, f the factor of the face's receiver, and A the fixed dye at phi:
#
#     A(phi) = max(A_0, min(V_d, A_d(phi), max(A_b, (A_b + rho phi) / (1 + beta rho))))
#
# A_0 is fixed dye at the step's start (`least`), A_b at the stage's start (`fixed` of its Uptake), rho = D_ab dt / d^2:
# within its limit fibre takes rho (phi - beta A)^+, beta being 1 or 0 (`back`), and it releases none. A grows with phi,
# so that there is one root, and trying the pieces of A finds it.

BENDS = 60
"""The most Newton steps if D falls with dye; one to eight suffice."""


@kernel
def held_at(x: float, least: float, uptake: Uptake, at: int, c: int) -> float:
    """Return A at mobile dye x."""
    initial, capacity, rate = uptake.fixed[at, c], uptake.fibre[at, c], uptake.rate
    free = max(initial, (initial + rate * x) / (1.0 + uptake.back * rate))
    limit = min(limit_beside(law_in(uptake), max(x, 0.0), capacity), capacity)
    held: float = max(least, min(limit, free))
    return held


@kernel
def solve_cell(total: float, ways: float, least: float, uptake: Uptake | None, at: int, c: int) -> float:
    """Return the x with ways x + A(x) - A_b = total."""
    if uptake is None or uptake.fibre[at, c] <= least:
        return total / ways
    initial, room, rate = uptake.fixed[at, c], uptake.fibre[at, c], uptake.rate
    law, back, share = law_in(uptake), uptake.back, 1.0 + uptake.back * rate
    x: float = total / ways
    if x > back * initial:
        x = (total + back * initial * rate / share) / (ways + rate / share)
    elif x <= 0.0:
        return x
    free = max(initial, (initial + rate * x) / share)
    if min(limit_beside(law, x, room), room) >= free:
        return x
    total += initial
    x = (total - least) / ways
    if limit_beside(law, max(x, 0.0), room) <= least:
        return x
    x = (total - room) / ways
    if x > 0.0 and limit_beside(law, x, room) >= room:
        return x
    return float(root_of(law.isotherm, total, ways, room))


@kernel
def solve_level(
    total: float, ways: float, near: float, curve: Curve | None, least: float, uptake: Uptake | None, at: int, c: int
) -> float:
    """Return the level G(x) with x + (ways - 1) G(x) + A(x) - A_b = total, `near` being a level close to it. G is
    concave and below its tangent at any x, for which `solve_cell` gives the root: that root is no greater than the one
    sought, and from below it each Newton step comes nearer.
    """
    if curve is None:
        return solve_cell(total, ways, least, uptake, at, c)
    x, level, through = amount(near, curve), near, ways - 1.0
    for _ in range(BENDS):
        slope = curve.cap if not x > curve.knee else curve.phi0 / x
        remainder = total - through * (level - slope * x)
        previous, x = x, solve_cell(remainder, 1.0 + through * slope, least, uptake, at, c)
        level = potential(x, curve)
        # The remaining error is of the order of the step's square.
        if not abs(x - previous) > 1e-8 * abs(x) or max(previous, x) <= curve.knee:
            break
    return level


def remove_excess(isotherm: Any, floor: Float, least: Float, fixed: Float, room: Float) -> float:
    """Remove from the fibre of maintained cells the dye that extrapolation put beyond its limit at the floor, in place.
    Return its amount, which the supply saves. Otherwise it would return from the fibre into a cell that is already at
    its floor, and raise it and its limit.
    """
    limit = isotherm.limit(floor, room)
    excess = np.where(floor > 0.0, np.maximum(fixed - np.maximum(least, np.minimum(limit, room)), 0.0), 0.0)
    fixed -= excess
    return sum_compensated(excess.reshape(-1))


# An implicit stage by sweeps: projected successive over-relaxation of all limits, supplies and fibre at once.
#
# A cell and its neighbours have different colours, as layer + row + column is even or odd, so that each half of a sweep
# depends on the other colour alone: the bits do not depend on threads. Each cell's equation is solved;
# the cell is then
#
#     at its floor   where a supply keeps it up
#     full           at V_u, if its root lies beyond: f <= 1, the factor of its inflow, is what keeps it there,
#                    (V_u - b + outflow + taken) / inflow; the supply replaces what flows out of a full kept-up cell
#     free           relaxed by omega; f = 1
#
# As in an obstacle problem (Cryer 1971), over-relaxation beyond a bound stops at it. More dye anywhere means less room
# and no less dye elsewhere, so that the sweeps converge to the one solution. omega goes by Chebyshev's rule to Young's
# best value for the largest eigenvalue that Jacobi's iteration can have, W / (1 + W), W being the largest sum of
# weights of a cell. A multigrid method would need a coarse form of all three conditions.
#
# If D falls with dye, everything is in G (nuno_dye.laws.diffusivity): fluxes are linear in it, and only a cell's own
# amounts are not. W is then that of the largest D.

CROSSINGS = 8
"""The most Newton steps in a cell; each but the last passes one of five neighbours, and the first may be from above."""


class Stage(NamedTuple):
    """One dye in a stage, (2 r, w) each, weft rows before warp rows.

    level    G of mobile dye (nuno_dye.laws.diffusivity), from a first guess to the solution
    passed   f, 1 if nothing can be limited
    begun    b
    least    fixed dye at the step's start
    floor    G of maintained amounts, 0 without any
    along, down, across  weights of the faces
    """

    level: Float
    passed: Float
    begun: Float
    least: Float
    floor: Float
    along: Float
    down: Float
    across: Float


@kernel
def root_among(
    stage: Stage, curve: Curve | None, uptake: Uptake | None, most: Float | None, row: int, layer: int, c: int
) -> tuple[float, float]:
    """Return the root of a cell's equation with f = 1 for itself, and 1 plus its sum of weights there; `most` is None
    if nothing can be limited.

    The others' factors scale outflow, so that the sum of weights falls where the cell rises above a neighbour: the
    equation is concave, Newton steps from below its root stay below, and each passes another cell. A single step,
    over-relaxed, would alternate between both sides of a full neighbour.
    """
    level, passed, along, down, across = stage.level, stage.passed, stage.along, stage.down, stage.across
    r = across.shape[0]
    at, other = row + layer * r, row + r - layer * r
    east, west, south, north = along[at, c], along[at, c - 1], down[at, c], down[at - 1, c]
    through, x = across[row, c], level[at, c]
    p_0, p_1, p_2, p_3 = level[at, c + 1], level[at, c - 1], level[at + 1, c], level[at - 1, c]
    f_0, f_1, f_2, f_3 = passed[at, c + 1], passed[at, c - 1], passed[at + 1, c], passed[at - 1, c]
    p_4, f_4, initial, ways = level[other, c], passed[other, c], stage.begun[at, c], 1.0
    limited = False if most is None else f_0 + f_1 + f_2 + f_3 + f_4 < 5.0
    for _ in range(CROSSINGS):
        g_0 = east if p_0 > x or not limited else east * f_0
        g_1 = west if p_1 > x or not limited else west * f_1
        g_2 = south if p_2 > x or not limited else south * f_2
        g_3 = north if p_3 > x or not limited else north * f_3
        g_4 = through if p_4 > x or not limited else through * f_4
        ways = 1.0 + (((g_0 + g_1) + (g_2 + g_3)) + g_4)
        total = initial + (((g_0 * p_0 + g_1 * p_1) + (g_2 * p_2 + g_3 * p_3)) + g_4 * p_4)
        previous, x = x, solve_level(total, ways, x, curve, stage.least[at, c], uptake, at, c)
        low, high = min(previous, x), max(previous, x)
        if not limited or not (
            low < p_0 <= high or low < p_1 <= high or low < p_2 <= high or low < p_3 <= high or low < p_4 <= high
        ):
            break
    return x, ways


@kernel
def flows_at(level: float, weight: float, other: float, factor: float) -> tuple[float, float, float]:
    """Return the inflow, the outflow and the weight of outflow of one face of a cell that holds `level`."""
    flux = weight * (other - level)
    return (flux, 0.0, 0.0) if flux > 0.0 else (0.0, -flux * factor, weight * factor)


@kernel
def fill_cell(
    limit: float, stage: Stage, curve: Curve | None, uptake: Uptake | None, kept: bool, row: int, layer: int, c: int
) -> tuple[float, float, float]:
    """Return level, factor and inflow of a cell whose root without a factor is beyond its limit."""
    r = stage.across.shape[0]
    at = row + layer * r
    begun = stage.begun[at, c]
    inflow, outflow, ways = 0.0, 0.0, 0.0
    for side in range(5):
        weight, i, k = face(stage, r, at, c, side)
        into, out, open_weight = flows_at(limit, weight, stage.level[i, k], stage.passed[i, k])
        inflow, outflow, ways = inflow + into, outflow + out, ways + open_weight
    full = amount(limit, curve)
    taken = held_at(full, stage.least[at, c], uptake, at, c) - uptake.fixed[at, c] if uptake is not None else 0.0
    room = full - begun + taken + (0.0 if kept else outflow)
    if room < 0.0 and not kept:
        # The cell starts with more than can stay: without inflow, it keeps what does not flow out.
        total = begun + ways * limit - outflow
        return max(limit, solve_level(total, 1.0 + ways, limit, curve, stage.least[at, c], uptake, at, c)), 0.0, inflow
    factor = min(max(room / inflow, 0.0), 1.0) if inflow > 0.0 else 1.0
    return limit, factor, inflow


@kernel
def cell_residual(root: float, here: float, ways: float, curve: Curve | None) -> float:
    """Return the residual of a level in its cell's equation, in amounts."""
    if curve is None:
        return abs(root - here) * ways
    return abs(root - here) * (ways - 1.0) + abs(amount(root, curve) - amount(here, curve))


@kernel
def relax_cell(
    stage: Stage, curve: Curve | None, uptake: Uptake | None, most: Float | None, omega: float, row: int, layer: int,
    c: int,
) -> Any:  # fmt: skip
    """Bring one cell nearer to its root. Return the previous residual of its equation, in amounts."""
    level, passed, at = stage.level, stage.passed, row + layer * stage.across.shape[0]
    here = level[at, c]
    root, ways = root_among(stage, curve, uptake, most, row, layer, c)
    least = stage.floor[at, c]
    kept = least > 0.0 and root <= least
    if most is not None and (root >= most[at, c] or (kept and least >= most[at, c])):
        limit = most[at, c]
        filled, factor, inflow = fill_cell(limit, stage, curve, uptake, least >= limit > 0.0, row, layer, c)
        residual = cell_residual(filled, here, ways, curve) + abs(factor - passed[at, c]) * inflow
        level[at, c], passed[at, c] = filled, factor
        return residual
    if kept:
        root = relaxed = least
    else:
        relaxed = here + omega * (root - here)
        if least > 0.0:
            relaxed = max(relaxed, least)
        if most is not None:
            relaxed = min(relaxed, most[at, c])
    residual = cell_residual(root, here, ways, curve)
    level[at, c] = relaxed
    if most is not None:
        residual += abs(1.0 - passed[at, c]) * ways * max(here, 0.0)
        passed[at, c] = 1.0
    return residual


@kernel
def relax_row(
    colour: int, omega: float, stage: Stage, curve: Curve | None, uptake: Uptake | None, most: Float | None, nx: int,
    row: int, largest: float,
) -> float:  # fmt: skip
    """Relax the cells of one colour in a row of both layers. Return the maximum of `largest` and their residuals."""
    for layer in range(2):
        for c in range(LEFT + (row + layer + colour) % 2, LEFT + nx, 2):
            residual = relax_cell(stage, curve, uptake, most, omega, row, layer, c)
            # Keep NaN.
            if not residual <= largest and largest == largest:
                largest = residual
    return largest


@parallel_kernel
def relax_bands(
    omega: float, second: float, cuts: Rows, stage: Stage, curve: Curve | None, uptake: Uptake | None,
    most: Float | None, nx: int, worst: Float,
) -> None:  # fmt: skip
    """Relax one colour everywhere, and the other a row behind it while that is in the cache, except in the bands' outer
    rows, whose old values the first colour of the next band still needs.
    """
    for b in prange(cuts.shape[0] - 1):
        largest = 0.0
        for row in range(cuts[b], cuts[b + 1]):
            largest = relax_row(1, omega, stage, curve, uptake, most, nx, row, largest)
            if row - 1 > cuts[b]:
                largest = relax_row(0, second, stage, curve, uptake, most, nx, row - 1, largest)
        worst[b, 0] = largest


@parallel_kernel
def relax_edges(
    omega: float, cuts: Rows, stage: Stage, curve: Curve | None, uptake: Uptake | None, most: Float | None, nx: int,
    worst: Float,
) -> None:  # fmt: skip
    """Relax the other colour in the bands' outer rows."""
    for b in prange(cuts.shape[0] - 1):
        first, last = cuts[b], cuts[b + 1] - 1
        largest = relax_row(0, omega, stage, curve, uptake, most, nx, first, 0.0)
        if last > first:
            largest = relax_row(0, omega, stage, curve, uptake, most, nx, last, largest)
        worst[b, 1] = largest


class Sweeps(NamedTuple):
    """Limits of relaxation: the most sweeps, the residual that ends them [amounts], and the radius of convergence."""

    most: int
    bound: float
    radius: float


@kernel
def relax(
    sweeps: Sweeps, cuts: Rows, stage: Stage, curve: Curve | None, uptake: Uptake | None, most: Float | None, nx: int,
    leave: Rows,
) -> tuple[int, float]:  # fmt: skip
    """Sweep within the limits, or until `leave` (1,) is not 0. Return the number of sweeps and the last residual."""
    worst = np.zeros((cuts.shape[0] - 1, 2))
    square, omega, residual = sweeps.radius * sweeps.radius, 1.0, np.inf
    for n in range(sweeps.most):
        second = 1.0 / (1.0 - 0.5 * square) if n == 0 else 1.0 / (1.0 - 0.25 * square * omega)
        relax_bands(omega, second, cuts, stage, curve, uptake, most, nx, worst)
        relax_edges(second, cuts, stage, curve, uptake, most, nx, worst)
        omega = 1.0 / (1.0 - 0.25 * square * second)
        residual = worst.max()
        if residual <= sweeps.bound or not np.isfinite(residual) or leave[0] != 0:
            return n + 1, residual
    return sweeps.most, residual


@kernel
def flow(weight: float, here: float, other: float, factor: float, other_factor: float) -> float:
    """Return the flux from the other cell, times the receiver's factor; the same bits from both sides."""
    return weight * (factor if other > here else other_factor) * (other - here)


@kernel
def settle_row(
    out: Float, held: Float, stage: Stage, curve: Curve | None, uptake: Uptake | None, row: int,
    layer: int, nx: int,
) -> None:  # fmt: skip
    """Compute mobile and fixed dye of one row of one layer from the fluxes of the solution."""
    level, passed, r = stage.level, stage.passed, stage.across.shape[0]
    at = row + layer * r
    for c in range(LEFT, LEFT + nx):
        here, f = level[at, c], passed[at, c]
        inflow = 0.0
        for side in range(5):
            weight, i, k = face(stage, r, at, c, side)
            inflow += flow(weight, here, level[i, k], f, passed[i, k])
        taken = 0.0
        if uptake is not None:
            fixed = held_at(amount(here, curve), stage.least[at, c], uptake, at, c)
            taken = fixed - uptake.fixed[at, c]
            held[at, c] = fixed
        out[at, c] = stage.begun[at, c] + inflow - taken


@parallel_kernel
def settle(
    out: Float, held: Float, cuts: Rows, stage: Stage, curve: Curve | None, uptake: Uptake | None, nx: int
) -> None:
    """Compute mobile and fixed dye after the stage from the fluxes, so that a residual moves dye and creates none."""
    for b in prange(cuts.shape[0] - 1):
        for row in range(cuts[b], cuts[b + 1]):
            for layer in range(2):
                settle_row(out, held, stage, curve, uptake, row, layer, nx)


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
            isotherm = solving.law_of(dyed.one, scale).isotherm
            dyed.supplied[-1] -= remove_excess(isotherm, dyed.floor, start[1], begun[1], layout.fibre)
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
        limit = Sweeps(sweeps, bound, radius)
        count, residual = relax(limit, layout.cuts, stage, curve, uptake, limits, nx, layout.derived.system.leave)
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
