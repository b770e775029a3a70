"""An implicit stage by sweeps: projected successive over-relaxation of all limits, supplies and fibre at once.

A cell and its neighbours have different colours, as layer + row + column is even or odd, so that each half of a sweep
depends on the other colour alone: the bits are those of any number of threads. In a cell its own equation is solved
(nuno_dye.solvers.implicit_cell); it is then

    at its floor   where a supply keeps it up
    full           at V_u, if its root lies beyond: f <= 1, the factor of its inflow, is what keeps it there,
                   (V_u - b + outflow + taken) / inflow; the supply replaces what flows out of a full kept-up cell
    free           relaxed by omega; f = 1

As for an obstacle problem (Cryer 1971), what is over-relaxed beyond a bound stays at it. More dye anywhere means
less room and no less dye elsewhere, so that the sweeps come to the one solution. omega goes by Chebyshev's rule to
Young's best value for the largest eigenvalue that Jacobi's iteration can have, W / (1 + W), W being the largest sum of
weights of a cell. A multigrid method would need a coarse form of all three conditions.

Where D falls with dye, everything is in G (nuno_dye.laws.potential): fluxes are linear in it, and only what a cell
holds is not, as with its fibre. W then counts the largest D.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import prange

from nuno_dye.laws.adsorption import Uptake
from nuno_dye.laws.potential import Curve, amount
from nuno_dye.solvers.diffusion import LEFT, Rows
from nuno_dye.solvers.implicit_cell import held_at, solve_level
from nuno_kernels import kernel, parallel_kernel
from nuno_schemas.fabric import Float

CROSSINGS = 8
"""Newton steps in a cell; each but the last passes one of five neighbours, and the first may come from above."""


class Stage(NamedTuple):
    """One dye in a stage, (2 r, w) each, weft rows before warp rows.

    level    G of mobile dye (nuno_dye.laws.potential), from a first guess to the solution
    passed   f, 1 where nothing can be limited
    begun    b
    least    fixed dye at the step's start
    floor    G of what is kept up, 0 where nothing is
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
    """Root of a cell's equation with f = 1 for itself, and the sum of its ways there; `most` is None where nothing can
    be limited.

    What flows out goes by the others' factors, so that the sum of ways falls where the cell rises above one: the
    equation is concave, Newton's steps from below its root stay below, and each passes another cell. One step alone
    goes to and fro between both sides of a full neighbour, if it is over-relaxed.
    """
    level, passed, along, down, across = stage.level, stage.passed, stage.along, stage.down, stage.across
    r = across.shape[0]
    at, other = row + layer * r, row + r - layer * r
    east, west, south, north = along[at, c], along[at, c - 1], down[at, c], down[at - 1, c]
    through, x = across[row, c], level[at, c]
    p_0, p_1, p_2, p_3 = level[at, c + 1], level[at, c - 1], level[at + 1, c], level[at - 1, c]
    f_0, f_1, f_2, f_3 = passed[at, c + 1], passed[at, c - 1], passed[at + 1, c], passed[at - 1, c]
    p_4, f_4, begun, ways = level[other, c], passed[other, c], stage.begun[at, c], 1.0
    limited = False if most is None else f_0 + f_1 + f_2 + f_3 + f_4 < 5.0
    for _ in range(CROSSINGS):
        g_0 = east if p_0 > x or not limited else east * f_0
        g_1 = west if p_1 > x or not limited else west * f_1
        g_2 = south if p_2 > x or not limited else south * f_2
        g_3 = north if p_3 > x or not limited else north * f_3
        g_4 = through if p_4 > x or not limited else through * f_4
        ways = 1.0 + (((g_0 + g_1) + (g_2 + g_3)) + g_4)
        total = begun + (((g_0 * p_0 + g_1 * p_1) + (g_2 * p_2 + g_3 * p_3)) + g_4 * p_4)
        before, x = x, solve_level(total, ways, x, curve, stage.least[at, c], uptake, at, c)
        low, high = min(before, x), max(before, x)
        if not limited or not (
            low < p_0 <= high or low < p_1 <= high or low < p_2 <= high or low < p_3 <= high or low < p_4 <= high
        ):
            break
    return x, ways


@kernel
def flows_at(level: float, way: float, other: float, factor: float) -> tuple[float, float, float]:
    """What comes in and goes out through one face of a cell that holds `level`, and the way out."""
    apart = way * (other - level)
    return (apart, 0.0, 0.0) if apart > 0.0 else (0.0, -apart * factor, way * factor)


@kernel
def fill_cell(
    limit: float, stage: Stage, curve: Curve | None, uptake: Uptake | None, kept: bool, row: int, layer: int, c: int
) -> tuple[float, float, float]:
    """Level, factor and inflow of a cell whose root without a factor lies beyond its limit."""
    level, passed, along, down, across = stage.level, stage.passed, stage.along, stage.down, stage.across
    r = across.shape[0]
    at, other = row + layer * r, row + r - layer * r
    begun = stage.begun[at, c]
    came, went, ways = 0.0, 0.0, 0.0
    for way, i, k in (
        (along[at, c], at, c + 1), (along[at, c - 1], at, c - 1), (down[at, c], at + 1, c),
        (down[at - 1, c], at - 1, c), (across[row, c], other, c),
    ):  # fmt: skip
        into, out, open_way = flows_at(limit, way, level[i, k], passed[i, k])
        came, went, ways = came + into, went + out, ways + open_way
    full = amount(limit, curve)
    taken = held_at(full, stage.least[at, c], uptake, at, c) - uptake.fixed[at, c] if uptake is not None else 0.0
    room = full - begun + taken + (0.0 if kept else went)
    if room < 0.0 and not kept:
        # More begins here than can stay: nothing comes in, and it holds what does not flow out.
        total = begun + ways * limit - went
        return max(limit, solve_level(total, 1.0 + ways, limit, curve, stage.least[at, c], uptake, at, c)), 0.0, came
    factor = min(max(room / came, 0.0), 1.0) if came > 0.0 else 1.0
    return limit, factor, came


@kernel
def distance(root: float, here: float, ways: float, curve: Curve | None) -> float:
    """What a level leaves of its cell's equation, in amounts."""
    if curve is None:
        return abs(root - here) * ways
    return abs(root - here) * (ways - 1.0) + abs(amount(root, curve) - amount(here, curve))


@kernel
def relax_cell(
    stage: Stage, curve: Curve | None, uptake: Uptake | None, most: Float | None, omega: float, row: int, layer: int,
    c: int,
) -> Any:  # fmt: skip
    """Bring one cell nearer to its root; the residual of its equation before, in amounts."""
    level, passed, at = stage.level, stage.passed, row + layer * stage.across.shape[0]
    here = level[at, c]
    root, ways = root_among(stage, curve, uptake, most, row, layer, c)
    least = stage.floor[at, c]
    kept = least > 0.0 and root <= least
    if most is not None and (root >= most[at, c] or (kept and least >= most[at, c])):
        limit = most[at, c]
        found, factor, came = fill_cell(limit, stage, curve, uptake, least >= limit > 0.0, row, layer, c)
        off = distance(found, here, ways, curve) + abs(factor - passed[at, c]) * came
        level[at, c], passed[at, c] = found, factor
        return off
    if kept:
        root = relaxed = least
    else:
        relaxed = here + omega * (root - here)
        if least > 0.0:
            relaxed = max(relaxed, least)
        if most is not None:
            relaxed = min(relaxed, most[at, c])
    off = distance(root, here, ways, curve)
    level[at, c] = relaxed
    if most is not None:
        off += abs(1.0 - passed[at, c]) * ways * max(here, 0.0)
        passed[at, c] = 1.0
    return off


@kernel
def relax_row(
    colour: int, omega: float, stage: Stage, curve: Curve | None, uptake: Uptake | None, most: Float | None, nx: int,
    row: int, largest: float,
) -> float:  # fmt: skip
    """Relax the cells of one colour in a row of both layers; the larger of `largest` and their residuals."""
    for layer in range(2):
        for c in range(LEFT + (row + layer + colour) % 2, LEFT + nx, 2):
            off = relax_cell(stage, curve, uptake, most, omega, row, layer, c)
            # What is not a number must stay so.
            if not off <= largest and largest == largest:
                largest = off
    return largest


@parallel_kernel
def relax_bands(
    omega: float, second: float, cuts: Rows, stage: Stage, curve: Curve | None, uptake: Uptake | None,
    most: Float | None, nx: int, worst: Float,
) -> None:  # fmt: skip
    """Relax one colour everywhere, and the other a row behind it while that is in the cache, but for the bands' outer
    rows, which the first colour of the next band still sees as they were.
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


@kernel
def relax(
    sweeps: int, radius: float, bound: float, cuts: Rows, stage: Stage, curve: Curve | None, uptake: Uptake | None,
    most: Float | None, nx: int, leave: Rows,
) -> tuple[int, float]:  # fmt: skip
    """Sweep until the residual is at most `bound` [amounts], at most `sweeps` times, or until `leave` (1,) is not 0;
    sweeps and last residual.
    """
    worst = np.zeros((cuts.shape[0] - 1, 2))
    square, omega, residual = radius * radius, 1.0, np.inf
    for n in range(sweeps):
        second = 1.0 / (1.0 - 0.5 * square) if n == 0 else 1.0 / (1.0 - 0.25 * square * omega)
        relax_bands(omega, second, cuts, stage, curve, uptake, most, nx, worst)
        relax_edges(second, cuts, stage, curve, uptake, most, nx, worst)
        omega = 1.0 / (1.0 - 0.25 * square * second)
        residual = worst.max()
        if residual <= bound or not np.isfinite(residual) or leave[0] != 0:
            return n + 1, residual
    return sweeps, residual


@kernel
def flow(way: float, here: float, other: float, factor: float, other_factor: float) -> float:
    """Flux from the other cell, by the factor of the one that receives; the same bits from both sides."""
    return way * (factor if other > here else other_factor) * (other - here)


@kernel
def settle_row(
    out: Float, held: Float, stage: Stage, curve: Curve | None, uptake: Uptake | None, row: int,
    layer: int, nx: int,
) -> None:  # fmt: skip
    """What the fluxes of the solution make of one row of one layer, and what its fibre then holds."""
    level, passed, along, down, across = stage.level, stage.passed, stage.along, stage.down, stage.across
    r = across.shape[0]
    at, other = row + layer * r, row + r - layer * r
    for c in range(LEFT, LEFT + nx):
        here, f = level[at, c], passed[at, c]
        came = 0.0
        for way, i, k in (
            (along[at, c], at, c + 1), (along[at, c - 1], at, c - 1), (down[at, c], at + 1, c),
            (down[at - 1, c], at - 1, c), (across[row, c], other, c),
        ):  # fmt: skip
            came += flow(way, here, level[i, k], f, passed[i, k])
        taken = 0.0
        if uptake is not None:
            found = held_at(amount(here, curve), stage.least[at, c], uptake, at, c)
            taken = found - uptake.fixed[at, c]
            held[at, c] = found
        out[at, c] = stage.begun[at, c] + came - taken


@parallel_kernel
def settle(
    out: Float, held: Float, cuts: Rows, stage: Stage, curve: Curve | None, uptake: Uptake | None, nx: int
) -> None:
    """Mobile and fixed dye after the stage, from the fluxes: a residual moves dye then, and makes none."""
    for b in prange(cuts.shape[0] - 1):
        for row in range(cuts[b], cuts[b + 1]):
            for layer in range(2):
                settle_row(out, held, stage, curve, uptake, row, layer, nx)
