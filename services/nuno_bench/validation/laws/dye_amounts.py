"""Laws of how much dye there is: kept exactly, in its bounds, outside of resist, and at rest as the isotherm says."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from nuno_bench.validation.laws.base import Case, Found
from nuno_bench.validation.laws.dye import D0, GROUP, POROSITY, RATE, SIZE, DyeRun, make_cells
from nuno_schemas.dye import Cells, Dye, Isotherm
from nuno_schemas.fabric import Float

TAKEN = 0.02
"""D_ab / D0 of what adsorbs."""
ADSORB = TAKEN * D0 / SIZE**2
"""D_ab / size^2 [1/s]: how fast fibre takes what is beside it."""
LONG = 1000.0
"""Explicit steps in one of a solver for which every step is stable."""


def _uneven() -> tuple[Cells, Float]:
    """Cells of any porosity, a third of them with any resist, half of them full."""
    rng, shape = np.random.default_rng(4), (2, 24, 26)
    resist = rng.random(shape) * (rng.random(shape) < 0.3)
    cells = make_cells(*shape[1:], layers=0.3, beside=0.4, porosity=rng.random(shape), resist=resist)
    return cells, cells.mobile_room * (rng.random(shape) < 0.5)


def _adsorbed() -> Dye:
    return Dye("dye", D0, TAKEN, Isotherm("langmuir", 2.0))


def measure_balance(plugin: Any) -> Found:
    """Mobile and fixed dye less what supplies gave changes by rounding alone: 1e-13 of it, times sqrt(steps)."""
    cells, phi = _uneven()
    supply = np.zeros_like(phi)
    supply[:, 5:9, 5:9] = 0.5 * cells.mobile_room[:, 5:9, 5:9]
    run = DyeRun(plugin, cells, phi, _adsorbed(), supply)
    run.go(400.0, 2.0)
    measured = run.measure() - run.supplied
    return Found(measured, run.start, abs(measured / run.start - 1.0), 1e-13 * math.sqrt(run.steps))


def measure_bounds(plugin: Any, length: float) -> Found:
    """0 <= phi <= V_u and 0 <= A <= V_d, at steps of at most `length` SIZE^2 / D0, or as long as the solver allows."""
    cells, phi = _uneven()
    run, worst = DyeRun(plugin, cells, phi, _adsorbed()), 0.0
    for _ in range(20):
        run.go(4.0 * length * SIZE**2 / D0, length * SIZE**2 / D0)
        over = max(float((run.phi - cells.mobile_room).max()), float((run.fixed - cells.fixed_room).max()))
        worst = max(worst, over, -float(run.phi.min()), -float(run.fixed.min()))
    return Found(worst, 0.0, worst, 1e-14)


def measure_resist(plugin: Any) -> Found:
    """A line of B = 1 across the cloth: not a molecule in it or behind it."""
    resist, phi = np.zeros((2, 12, 20)), np.zeros((2, 12, 20))
    resist[:, :, 10:12] = 1.0
    phi[:, :, :10] = POROSITY
    run = DyeRun(plugin, make_cells(12, 20, layers=0.5, resist=resist), phi, _adsorbed(), phi)
    run.go(2000.0, 5.0)
    behind = float(np.abs(run.phi[:, :, 10:]).max() + np.abs(run.fixed[:, :, 10:]).max())
    return Found(behind, 0.0, behind, 0.0)


def measure_uptake(plugin: Any) -> Found:
    """Even dye M, of which fibre may take all it meets: dA/dt = r (phi - A) gives A = M / 2 (1 - exp(-2 r t))."""
    amount, phi = 0.4, np.full((2, 4, 4), 0.4)
    dye, duration = Dye("dye", D0, TAKEN, Isotherm("partition", 1.0)), 0.5 / ADSORB
    run = DyeRun(plugin, make_cells(4, 4), phi, dye)
    run.go(duration, duration / 2000.0)
    expected = 0.5 * amount * (1.0 - math.exp(-1.0))
    measured = float(run.fixed.mean())
    return Found(measured, expected, abs(measured / expected - 1.0), 1e-3)


def measure_rest(plugin: Any, isotherm: Isotherm, limit: Callable[[float], float]) -> Found:
    """Even dye M that adsorbs until nothing changes: A = A_d(M - A)."""
    amount, phi = 0.4, np.full((2, 4, 4), 0.4)
    run = DyeRun(plugin, make_cells(4, 4), phi, Dye("dye", D0, TAKEN, isotherm))
    # Fibre takes at least r (phi - A) until it holds what it may: that is done before 5 / r.
    run.go(5.0 / ADSORB, 1e-3 / ADSORB)
    low, high = 0.0, amount
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if limit(amount - middle) > middle else (low, middle)
    measured = float(run.fixed.mean())
    return Found(measured, low, abs(measured / low - 1.0), 3e-3)


LAWS: dict[str, tuple[Isotherm, Callable[[float], float]]] = {
    "partition": (Isotherm("partition", 0.5), lambda phi: 0.5 * phi),
    "freundlich": (Isotherm("freundlich", 0.2, 0.5), lambda phi: 0.2 * math.sqrt(phi)),
    "langmuir": (Isotherm("langmuir", 1.0), lambda phi: (1.0 - POROSITY) * phi / (1.0 + phi)),
}


def measure_limit(plugin: Any) -> Found:
    """Growth of a checkerboard in 60 steps: none at 0.999 of the stated limit, and some at 1.05 of it.

    Who states none must let it fade at LONG explicit steps, too.
    """
    n = 40
    cells = make_cells(n, n)
    place = np.indices((n, n)).sum(axis=0) % 2
    phi = np.broadcast_to(0.25 + 1e-6 * (place - 0.5), (2, n, n)).copy()
    growth = []
    for share in (0.999, 1.05):
        run = DyeRun(plugin, cells, phi)
        endless = not math.isfinite(run.limit)
        run.step(6 if endless else 60, LONG / (4.0 * RATE) if endless else share * run.limit)
        growth.append(float(np.ptp(run.phi)) / float(np.ptp(phi)))
        if endless:
            return Found(growth[0], 0.0, max(0.0, growth[0] - 1.0), 1e-9)
    off = max(0.0, growth[0] - 1.0) + max(0.0, 1.0 - growth[1])
    return Found(growth[1], growth[0], off, 1e-9)


ROOMS = "dye paper, equations 6 and 9"
CASES = (
    Case("balance", "mobile + fixed - supplied stays as it is", "fluxes cancel in pairs", measure_balance, GROUP),
    Case("bounds", "0 <= phi <= V_u and 0 <= A <= V_d", ROOMS, partial(measure_bounds, length=0.2), GROUP),
    Case("bounds, longest steps", "the same at the longest steps it allows, up to a hundred times as long", ROOMS,
         partial(measure_bounds, length=20.0), GROUP),
    Case("resist line", "nothing comes through a line of B = 1", "V_u = 0 there", measure_resist, GROUP),
    Case("uptake", "even dye is taken as M / 2 (1 - exp(-2 r t)), r = D_ab / d^2", "closed form", measure_uptake,
         GROUP),
    *(
        Case(f"rest, {name}", f"at rest fibre holds what the isotherm {name} says", "A = A_d(M - A)",
             partial(measure_rest, isotherm=isotherm, limit=limit), GROUP)
        for name, (isotherm, limit) in LAWS.items()
    ),
    Case("dye's stated limit", "the finest pattern fades at 0.999 of the stated limit, if any, and grows at 1.05",
         "D0 dt / d^2 times the sum of P T is 1", measure_limit, GROUP),
)  # fmt: skip
