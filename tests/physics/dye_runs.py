"""Runs of dye by every solver, from amounts to amounts."""

from __future__ import annotations

from dataclasses import replace
from math import fsum
from typing import Any

import numpy as np

from nuno_dye.solvers.explicit import Explicit, ExplicitConfig
from nuno_dye.solvers.implicit import Implicit, ImplicitConfig
from nuno_dye.solvers.rkl2 import Rkl2, Rkl2Config
from nuno_schemas.dye import DyeReport, DyeState, DyeSystem
from nuno_schemas.fabric import Float

SOLVERS: dict[str, tuple[Any, Any, int]] = {
    "explicit": (Explicit(), ExplicitConfig(), 1),
    "rkl2": (Rkl2(), Rkl2Config(), 2),
    "sdirk2": (Implicit(), ImplicitConfig(scheme="sdirk2", residual=1e-11), 2),
    "backward_euler": (Implicit(), ImplicitConfig(scheme="backward_euler", residual=1e-11), 1),
}
"""By name or scheme: solver, how it is set, and its order; implicit ones are solved nearly to rounding."""
SECOND = ("rkl2", "sdirk2")
LONG = (*SECOND, "backward_euler")
"""Solvers that take steps of any length."""


def run(
    name: str,
    system: DyeSystem,
    phi: Float,
    fixed: Float,
    t: float,
    steps: int,
    frames: int = 1,
    *,
    resumed: bool = False,
) -> tuple[DyeState, DyeReport]:
    """`steps` steps in each of some frames, to `t` [s]; the report's `supplied` is of all.

    `resumed`: before each frame everything is made anew, and only the memory's arrays are taken over.
    """
    solver, config, _ = SOLVERS[name]
    state, reports = DyeState(phi[None].copy(), fixed[None].copy()), []
    memory = solver.prepare(config, system, state)
    for _ in range(frames):
        if resumed:
            fresh = solver.prepare(config, system, DyeState(0 * state.phi, 0 * state.fixed))
            for key, values in memory.arrays.items():
                np.copyto(fresh.arrays[key], values)
            memory = fresh
        reports.append(solver.advance(system, state, memory, steps, t / (steps * frames)))
    given = (fsum(r.supplied[0] for r in reports),) if reports[0].supplied else ()
    return state, replace(reports[-1], supplied=given)


def follow(system: DyeSystem, phi: Float, fixed: Float, t: float, steps: int) -> DyeState:
    """The explicit solver's amounts."""
    return run("explicit", system, phi, fixed, t, steps)[0]


def limit(system: DyeSystem) -> float:
    """The explicit solver's limit [s]."""
    return Explicit().limit(ExplicitConfig(), system)


def orders(errors: list[float]) -> Float:
    """Of errors at steps that halve."""
    found: Float = np.log2(np.array(errors[:-1]) / errors[1:])
    return found
