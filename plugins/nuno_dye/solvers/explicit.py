"""The explicit solver: the dye paper's scheme, whole frames of steps in one compiled call for each dye.

If no limit can bind, the faster kernel of diffusion alone takes the steps, with adsorption if there is any. Its step
replaces each amount by a mean of itself and its neighbours', with weights that add to 1 and are not negative as long as
D0 dt / size^2 sum P T <= 1; limits only reduce the neighbours' weights, and adsorption the amounts. So no amount ever
exceeds the largest of those at the start and of maintained ones since, and a cell's inflow is at most (that - phi).
Nothing can be limited, then, if every cell with faces has room for it. Memory keeps this largest amount, so that a
resumed run chooses the same kernel as the whole run.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

from nuno_dye.laws.adsorption import Uptake
from nuno_dye.laws.diffusivity import curve_of, face_values, largest_sum
from nuno_dye.solvers.bands import Cut, make_bands, make_dye_bands, read_bands
from nuno_dye.solvers.diffusion import GHOST, Bands, diffuse
from nuno_dye.solvers.dyeing import LEVELS, DyeBands, dye
from nuno_dye.solvers.solving import (
    Banded,
    Derived,
    Upkeep,
    adsorbs,
    count_bands,
    derive,
    largest_amounts,
    law_of,
    make_report,
    renew_work,
    require_laws,
    sum_compensated,
    use_threads,
)
from nuno_schemas.dye import DyeReport, DyeState, DyeSystem
from nuno_schemas.fabric import Float, Memory
from nuno_schemas.plugin import Config


class ExplicitConfig(Config):
    """The explicit solver has no fields of its own."""


@dataclass
class ExplicitWork:
    """A system in the kernels' layouts.

    bands   by dye, and whether limits may bind: the step [s] and the kernel's layout for it
    floor_cache  by dye and ghost rows: the layout of its floors
    fibre   by ghost rows: the layout of V_d
    """

    derived: Derived
    bands: dict[tuple[int, bool], tuple[float, Bands | DyeBands]] = field(default_factory=dict)
    floor_cache: dict[tuple[int, int], Upkeep] = field(default_factory=dict)
    fibre: dict[int, Float] = field(default_factory=dict)

    def rebuild(self, system: DyeSystem) -> ExplicitWork:
        return ExplicitWork(derive(system))


class Explicit(Banded):
    """Adsorption, then diffusion with all fluxes from the same amounts."""

    name: ClassVar[str] = "explicit"
    order: ClassVar[int] = 1
    Config: ClassVar[type[BaseModel]] = ExplicitConfig

    def prepare(self, config: ExplicitConfig, system: DyeSystem, state: DyeState) -> Memory:
        """Return memory: `highest` (dyes,), the largest amount that any cell can have had."""
        require_laws(system)
        return Memory({"highest": largest_amounts(state.phi)}, ExplicitWork(derive(system)))

    def limit(self, config: ExplicitConfig, system: DyeSystem) -> float:
        """Return the dt at which the largest D0 g, times dt / size^2 and the largest sum of P T over a cell's faces, is
        1.
        """
        most = largest_sum(face_values(system.cells)) * max(one.D0 * one.steepest for one in system.dyes)
        return system.cells.size**2 / most if most > 0.0 else float(np.inf)

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """Advance a state by a frame of `steps` of dt [s]."""
        work: ExplicitWork = renew_work(memory, system)
        highest = memory.arrays["highest"]
        use_threads(highest, work.derived)
        supplied = [_advance_one(work, k, state, steps, dt, float(highest[k])) for k in range(len(system.dyes))]
        state.t += steps * dt
        return make_report(system, state, {"steps": steps}, supplied)


def _upkeep(work: ExplicitWork, k: int, cut: Cut) -> Upkeep | None:
    """Return the floors of one dye in a kernel's layout, with sums of 0; None if it has none."""
    if work.derived.floors is None or not work.derived.floors[k].any():
        return None
    if (k, cut.ghost) not in work.floor_cache:
        floor = cut.fill(work.derived.floors[k])[0]
        rows = floor.reshape(floor.shape[0], 2, -1, floor.shape[2]).max(axis=(1, 3)) > 0.0
        work.floor_cache[k, cut.ghost] = Upkeep(floor, np.zeros_like(floor), np.zeros_like(floor), rows)
    upkeep = work.floor_cache[k, cut.ghost]
    upkeep.given.fill(0.0)
    upkeep.lost.fill(0.0)
    return upkeep


def _uptake(work: ExplicitWork, k: int, cut: Cut, scale: float) -> Uptake | None:
    """Return the fibre of one dye in a kernel's layout; None if the kernel does not fix it."""
    if cut.ghost not in work.fibre:
        work.fibre[cut.ghost] = cut.fill(work.derived.system.cells.fixed_room)[0]
    one = work.derived.system.dyes[k]
    return Uptake(np.empty(cut.shape), work.fibre[cut.ghost], *law_of(one, scale)) if adsorbs(one) else None


def _advance_one(work: ExplicitWork, k: int, state: DyeState, steps: int, dt: float, highest: float) -> float:
    """Advance one dye by a frame; without steps, compile its kernels. Return the amount that its supplies added."""
    system, phi, fixed = work.derived.system, state.phi[k], state.fixed[k]
    one, cells = system.dyes[k], system.cells
    scale, curve = one.D0 * dt / cells.size**2, curve_of(one)
    limited = not highest <= work.derived.room or scale * work.derived.most > 1.0 or curve is not None
    cut = Cut(phi.shape, count_bands(system), 2 * LEVELS if limited else GHOST)
    bands = _layout(work, k, limited, dt, scale, cut.number)
    uptake, upkeep = _uptake(work, k, cut, scale), _upkeep(work, k, cut)
    bands = bands._replace(phi=cut.fill(phi)[0])
    uptake = uptake and uptake._replace(fixed=cut.fill(fixed)[0])
    if isinstance(bands, DyeBands):
        dye(steps, bands, uptake, upkeep, curve, system.leave)
    else:
        diffuse(steps, bands, uptake, upkeep, system.leave)
    read_bands(bands, bands.phi, phi)
    if uptake is not None:
        read_bands(bands, uptake.fixed, fixed)
    if upkeep is None:
        return 0.0
    given, lost = (read_bands(bands, part, np.empty(phi.shape)) for part in (upkeep.given, upkeep.lost))
    return sum_compensated(np.concatenate([given.reshape(-1), -lost.reshape(-1)]))


def _layout(work: ExplicitWork, k: int, limited: bool, dt: float, scale: float, number: int) -> Bands | DyeBands:
    """Return one dye's weights in a kernel's layout."""
    cached_dt, bands = work.bands.get((k, limited), (0.0, None))
    steepest = work.derived.system.dyes[k].steepest
    if bands is None or cached_dt != dt:
        empty, cells = np.zeros(work.derived.system.cells.fibre.shape), work.derived.system.cells
        bands = (
            make_dye_bands(empty, cells, work.derived.faces, scale, number, steepest)
            if limited
            else make_bands(empty, work.derived.faces, scale, number)
        )
        work.bands[k, limited] = dt, bands
    return bands
