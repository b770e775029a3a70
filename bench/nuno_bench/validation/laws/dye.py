"""How a law of dye runs a solver, and laws of how much there is: kept, in its bounds, at rest as the isotherm says."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pydantic import ValidationError

from nuno_bench.validation.laws.base import ACCURATE, Broken, Found, Laws, Unsupported, bisect, relative, whole_steps
from nuno_schemas.dye import Cells, Dye, DyeReport, DyeState, DyeSystem, Isotherm, Tortuosity
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

GROUP = "nuno.dye_solvers"
SIZE, D0, POROSITY = 5e-5, 5e-10, 0.5
"""Side of a cell [m], diffusion in water [m^2/s] and P of all cases, about those of the dye paper."""
RATE = D0 * POROSITY / SIZE**2
"""D0 P / size^2 [1/s]: what passes a face of tortuosity 1 in a second, as a share of the difference."""
SHARE = 0.9
"""Of the stable step, at most."""
laws = Laws(GROUP)
TAKEN = 0.02
"""D_ab / D0 of what adsorbs."""
ADSORB = TAKEN * D0 / SIZE**2
"""D_ab / size^2 [1/s]: how fast fibre takes what is beside it."""
ADSORBED = Dye("dye", D0, TAKEN, Isotherm("langmuir", 2.0))
LONG = 1000.0
"""Explicit steps in one of a solver for which every step is stable."""
AMOUNT = 0.4
LAWS: dict[str, tuple[Isotherm, Callable[[float], float]]] = {
    "partition": (Isotherm("partition", 0.5), lambda phi: 0.5 * phi),
    "freundlich": (Isotherm("freundlich", 0.2, 0.5), lambda phi: 0.2 * math.sqrt(phi)),
    "langmuir": (Isotherm("langmuir", 1.0), lambda phi: (1.0 - POROSITY) * phi / (1.0 + phi)),
}
"""A_d of phi."""


def make_cells(
    ny: int,
    nx: int,
    *,
    yarn: float = 1.0,
    beside: float = 1.0,
    layers: float = 0.0,
    porosity: Float | float = POROSITY,
    resist: Float | float = 0.0,
) -> Cells:
    """Two layers, all fibre; what passes along yarns, across them and between the layers; weft lies along x."""
    one = np.ones((2, ny, nx))
    up = np.zeros((2, ny, nx), bool)
    up[1] = True
    tortuosity = Tortuosity(layers=layers, beside=beside, rim=1.0, gap=1.0, yarn=yarn, weave=1.0)
    return Cells(one > 0.0, up, porosity * one, one, resist * one, SIZE, tortuosity)


class DyeRun:
    """A solver on one cloth with one dye, from amounts phi (2, ny, nx) and nothing fixed.

    `phi` (2, ny, nx) is the mobile dye, `fixed` what fibre has taken; `report` is the last one; `supplied` is all
    that was given so far, `steps` how many were taken.
    """

    def __init__(
        self,
        plugin: Any,
        cells: Cells,
        phi: Float,
        dye: Dye | None = None,
        supply: Float | None = None,
        settings: Mapping[str, Any] = ACCURATE,
    ) -> None:
        """Raises Unsupported where the solver refuses it, or its configuration cannot be guessed."""
        self.plugin = plugin
        kept = None if supply is None else np.ascontiguousarray(supply, np.float64)[None]
        self.system = DyeSystem(cells, (dye or Dye("dye", D0),), 1, kept)
        known = {name: value for name, value in settings.items() if name in plugin.Config.model_fields}
        try:
            self.config = plugin.Config(**known)
        except ValidationError as error:
            missing = ", ".join(str(one["loc"][0]) for one in error.errors() if one["loc"])
            raise Unsupported(f"its configuration has no defaults ({missing})") from None
        start = np.ascontiguousarray(phi, np.float64)[None]
        self.state = DyeState(start.copy(), np.zeros_like(start))
        self.phi: Float = self.state.phi[0]
        self.fixed: Float = self.state.fixed[0]
        try:
            self.memory = plugin.prepare(self.config, self.system, self.state)
        except BadInput as refused:
            # A solver may know no isotherm, or no diffusion that falls with dye; what else it refuses all must pose.
            (one,) = self.system.dyes
            if one.isotherm is None and one.weisz_zollinger is None:
                raise Broken(f"refuses a system of neither isotherm nor law of diffusion: {refused.problem}") from None
            raise Unsupported(refused.problem) from None
        self.limit = float(plugin.limit(self.config, self.system))
        self.supplied, self.steps = 0.0, 0
        self.start = self.measure()

    def step(self, steps: int, dt: float) -> DyeReport:
        """So many steps. Raises Broken where the solver does not end well."""
        with np.errstate(all="ignore"):
            report: DyeReport = self.plugin.advance(self.system, self.state, self.memory, steps, dt)
        if report.status != "ok":
            raise Broken(f"{report.status}: {report.message}")
        self.supplied += math.fsum(report.supplied)
        self.steps += steps
        return report

    def go(self, duration: float, longest: float) -> DyeRun:
        """`duration` [s] in whole steps of at most `longest` [s] and SHARE of the limit. Raises Unsupported, Broken."""
        self.step(*whole_steps(duration, min(longest, SHARE * self.limit)))
        return self

    def measure(self) -> float:
        """All dye, mobile and fixed, as the solver reports it."""
        report = self.step(0, 1.0)
        return math.fsum(report.mobile) + math.fsum(report.fixed)


def _uneven() -> tuple[Cells, Float]:
    """Cells of any porosity, a third of them with any resist, half of them full."""
    rng, shape = np.random.default_rng(4), (2, 24, 26)
    resist = rng.random(shape) * (rng.random(shape) < 0.3)
    cells = make_cells(*shape[1:], layers=0.3, beside=0.4, porosity=rng.random(shape), resist=resist)
    return cells, cells.mobile_room * (rng.random(shape) < 0.5)


@laws("balance", "fluxes cancel in pairs")
def measure_balance(plugin: Any) -> Found:
    """mobile + fixed - supplied stays as it is, but for rounding: 1e-13 of it, times sqrt(steps)."""
    cells, phi = _uneven()
    supply = np.zeros_like(phi)
    supply[:, 5:9, 5:9] = 0.5 * cells.mobile_room[:, 5:9, 5:9]
    run = DyeRun(plugin, cells, phi, ADSORBED, supply).go(400.0, 2.0)
    return relative(run.measure() - run.supplied, run.start, 1e-13 * math.sqrt(run.steps))


@laws({"bounds": {"length": 0.2}, "bounds, longest steps": {"length": 20.0}}, "dye paper, equations 6 and 9")
def measure_bounds(plugin: Any, length: float) -> Found:
    """0 <= phi <= V_u and 0 <= A <= V_d, at steps of at most 0.2 or 20 SIZE^2 / D0, or as long as it allows."""
    cells, phi = _uneven()
    run, worst = DyeRun(plugin, cells, phi, ADSORBED), 0.0
    for _ in range(20):
        run.go(4.0 * length * SIZE**2 / D0, length * SIZE**2 / D0)
        over = max(float((run.phi - cells.mobile_room).max()), float((run.fixed - cells.fixed_room).max()))
        worst = max(worst, over, -float(run.phi.min()), -float(run.fixed.min()))
    return Found(worst, 0.0, worst, 1e-14)


@laws("resist line", "V_u = 0 there")
def measure_resist(plugin: Any) -> Found:
    """Nothing comes through a line of B = 1 across the cloth: not a molecule in it or behind it."""
    resist, phi = np.zeros((2, 12, 20)), np.zeros((2, 12, 20))
    resist[:, :, 10:12] = 1.0
    phi[:, :, :10] = POROSITY
    run = DyeRun(plugin, make_cells(12, 20, layers=0.5, resist=resist), phi, ADSORBED, phi).go(2000.0, 5.0)
    behind = float(np.abs(run.phi[:, :, 10:]).max() + np.abs(run.fixed[:, :, 10:]).max())
    return Found(behind, 0.0, behind, 0.0)


def _taken(plugin: Any, isotherm: Isotherm, duration: float, step: float) -> float:
    """What fibre holds of even dye AMOUNT after `duration` / r, in steps of at most `step` / r, r = ADSORB."""
    dye, phi = Dye("dye", D0, TAKEN, isotherm), np.full((2, 4, 4), AMOUNT)
    return float(DyeRun(plugin, make_cells(4, 4), phi, dye).go(duration / ADSORB, step / ADSORB).fixed.mean())


@laws("uptake", "closed form")
def measure_uptake(plugin: Any) -> Found:
    """Even dye M, of which fibre may take all it meets, is taken as A = M / 2 (1 - exp(-2 r t)), r = D_ab / d^2.

    It is the solution of dA/dt = r (phi - A).
    """
    measured = _taken(plugin, Isotherm("partition", 1.0), 0.5, 0.5 / 2000.0)
    return relative(measured, 0.5 * AMOUNT * (1.0 - math.exp(-1.0)), 1e-3)


@laws({f"rest, {name}": {"isotherm": of, "limit": a} for name, (of, a) in LAWS.items()}, "A = A_d(M - A)")
def measure_rest(plugin: Any, isotherm: Isotherm, limit: Callable[[float], float]) -> Found:
    """Even dye M that adsorbs until nothing changes leaves A on the fibre as the isotherm A_d says.

    Fibre takes at least r (phi - A) until it holds what it may: that is done before 5 / r.
    """
    expected = bisect(0.0, AMOUNT, lambda held: limit(AMOUNT - held) <= held)
    return relative(_taken(plugin, isotherm, 5.0, 1e-3), expected, 3e-3)


@laws("dye's stated limit", "D0 dt / d^2 times the sum of P T is 1")
def measure_limit(plugin: Any) -> Found:
    """The finest pattern fades at 0.999 of the stated limit, if any, and grows at 1.05 of it, in 60 steps.

    Who states none must let it fade at LONG explicit steps, too.
    """
    n = 40
    place = np.indices((n, n)).sum(axis=0) % 2
    phi = np.broadcast_to(0.25 + 1e-6 * (place - 0.5), (2, n, n)).copy()

    def growth(share: float, steps: int) -> float:
        run = DyeRun(plugin, make_cells(n, n), phi)
        run.step(steps, share * run.limit if math.isfinite(run.limit) else LONG / (4.0 * RATE))
        return float(np.ptp(run.phi)) / float(np.ptp(phi))

    if not math.isfinite(DyeRun(plugin, make_cells(n, n), phi).limit):
        fading = growth(1.0, 6)
        return Found(fading, 0.0, max(0.0, fading - 1.0), 1e-9)
    below, above = growth(0.999, 60), growth(1.05, 60)
    return Found(above, below, max(0.0, below - 1.0) + max(0.0, 1.0 - above), 1e-9)
