"""How a law of dye runs a solver: cells posed as data, through the plugin protocol alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import ValidationError

from nuno_bench.validation.laws.base import ACCURATE, Broken, Unsupported, whole_steps
from nuno_schemas.dye import Cells, Dye, DyeReport, DyeState, DyeSystem, Tortuosity
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

GROUP = "nuno.dye_solvers"
SIZE, D0, POROSITY = 5e-5, 5e-10, 0.5
"""Side of a cell [m], diffusion in water [m^2/s] and P of all cases, about those of the dye paper."""
RATE = D0 * POROSITY / SIZE**2
"""D0 P / size^2 [1/s]: what passes a face of tortuosity 1 in a second, as a share of the difference."""
SHARE = 0.9
"""Of the stable step, at most."""


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
