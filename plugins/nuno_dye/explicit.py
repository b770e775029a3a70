"""The explicit solver: the dye paper's scheme, whole frames of steps in one compiled call for each dye.

Where nothing is adsorbed and no limit can bind, the faster kernel of diffusion alone takes the steps. A step of
it replaces each amount by a mean of itself and its neighbours', with weights that add to 1 and are none of them
negative as long as D0 dt / size^2 sum P T <= 1; so no amount leaves the range of those at the start, and a cell's
inflow is at most (max - phi). Nothing can be limited, then, if every cell that a face reaches has room for the
largest amount of the start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numba
import numpy as np
from pydantic import BaseModel

from nuno_dye.bands import Cut, make_bands, make_dye_bands, read_bands
from nuno_dye.diffusion import GHOST, Bands, diffuse
from nuno_dye.dyeing import FREUNDLICH, LANGMUIR, LEVELS, NOTHING, PARTITION, DyeBands, dye
from nuno_dye.faces import Faces, face_sums, face_values
from nuno_dye.sums import sum_compensated
from nuno_kernels import threads_available
from nuno_schemas.dye import Cells, Dye, DyeReport, DyeState, DyeSystem
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Memory
from nuno_schemas.plugin import Config

KINDS = {"partition": PARTITION, "freundlich": FREUNDLICH, "langmuir": LANGMUIR, "python": NOTHING}
"""Isotherms; one in Python is worked out between the kernel's steps."""
CELLS_PER_THREAD = 10_000
"""A pass over fewer takes some tens of microseconds, not much longer than to wake a thread."""


class ExplicitConfig(Config):
    """The explicit solver has no fields of its own."""


@dataclass
class Work:
    """Face values, their largest sum, and by dye: the step [s] and the kernels' layout for it."""

    faces: Faces
    most: float
    plain: dict[int, tuple[float, Bands]] = field(default_factory=dict)
    whole: dict[int, tuple[float, DyeBands]] = field(default_factory=dict)


class Explicit:
    """Adsorption, then diffusion with all fluxes from the same amounts."""

    name: ClassVar[str] = "explicit"
    Config: ClassVar[type[BaseModel]] = ExplicitConfig

    def prepare(self, config: ExplicitConfig, system: DyeSystem, state: DyeState) -> Memory:
        """Memory: which dyes a limit can bind. A resumed run must choose its kernel as the whole run did."""
        for one in system.dyes:
            law = one.isotherm
            if law is not None and (law.kind not in KINDS or (law.kind == "python") != (law.function is not None)):
                raise BadInput("no kernel knows this isotherm", value=law.kind, limit=", ".join(KINDS))
        faces = face_values(system.cells)
        sums = face_sums(faces)
        room = float(system.cells.mobile_room[sums > 0.0].min(initial=np.inf))
        limited = [_adsorbs(one) or float(state.phi[k].max()) > room for k, one in enumerate(system.dyes)]
        return Memory({"limited": np.array(limited)}, Work(faces, float(sums.max())))

    def limit(self, config: ExplicitConfig, system: DyeSystem) -> float:
        """D0 dt / size^2 times the largest sum of P T over a cell's faces is 1 there."""
        most = float(face_sums(face_values(system.cells)).max()) * max(one.D0 for one in system.dyes)
        return system.cells.size**2 / most if most > 0.0 else float(np.inf)

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """See nuno_schemas.dye.DyeSolver."""
        work: Work = memory.work  # type: ignore[assignment]
        numba.set_num_threads(max(1, min(system.threads, threads_available()[0])))
        for k in range(len(system.dyes)):
            _advance_one(system, work, k, state, steps, dt, bool(memory.arrays["limited"][k]))
        state.t += steps * dt
        mobile, fixed = (
            tuple(sum_compensated(values.reshape(-1)) for values in amounts) for amounts in (state.phi, state.fixed)
        )
        finite = bool(np.isfinite([*mobile, *fixed]).all())
        totals = {"steps": steps}
        if not finite:
            return DyeReport("diverged", steps, mobile, fixed, "amounts of dye are no longer finite", totals)
        return DyeReport("ok", steps, mobile, fixed, "", totals)

    def about(self, system: DyeSystem) -> str:
        available, why = threads_available()
        number = _bands(system)
        if number == 1 and min(system.threads, available) > 1:
            return f"1 thread: {system.cells.fibre.size:,} cells are fewer than several threads pay for"
        return f"{number} thread{'s' if number > 1 else ''} of {available} ({why})"


def _adsorbs(one: Dye) -> bool:
    return one.isotherm is not None and one.adsorption > 0.0


def _bands(system: DyeSystem) -> int:
    """Bands, one a thread: as many as are worth it. The result does not depend on them."""
    return max(1, min(system.threads, threads_available()[0], system.cells.fibre.size // CELLS_PER_THREAD))


def _advance_one(system: DyeSystem, work: Work, k: int, state: DyeState, steps: int, dt: float, limited: bool) -> None:
    """Bring one dye from the start of a frame to its end; with no steps, compile what they need."""
    one, phi, fixed = system.dyes[k], state.phi[k], state.fixed[k]
    scale, number = one.D0 * dt / system.cells.size**2, _bands(system)
    if limited or scale * work.most > 1.0:
        _step_whole(system, work, k, phi, fixed, steps, dt)
        return
    known, plain = work.plain.get(k, (0.0, None))
    if plain is None or known != dt:
        plain = make_bands(phi, work.faces, scale, number)
        work.plain[k] = dt, plain
    plain = plain._replace(phi=Cut(phi.shape, number, GHOST).fill(phi)[0])
    diffuse(steps, plain)
    read_bands(plain, plain.phi, phi)


def _step_whole(system: DyeSystem, work: Work, k: int, phi: Float, fixed: Float, steps: int, dt: float) -> None:
    """The same with adsorption, capacities and resist."""
    one, cells, number = system.dyes[k], system.cells, _bands(system)
    scale = one.D0 * dt / cells.size**2
    known, whole = work.whole.get(k, (0.0, None))
    if whole is None or known != dt:
        whole = make_dye_bands(phi, fixed, cells, work.faces, scale, number)
        work.whole[k] = dt, whole
    law = one.isotherm if _adsorbs(one) else None
    kind, first, second = (KINDS[law.kind], law.first, law.second) if law else (NOTHING, 0.0, 0.0)
    function = law.function if law else None
    for count in [steps] if function is None or not steps else [1] * steps:
        if function is not None and count:
            _adsorb(phi, fixed, cells, one.adsorption * scale, function)
        amounts = Cut(phi.shape, number, 2 * LEVELS).fill(phi, fixed)
        whole = whole._replace(phi=amounts[0], fixed=amounts[1])
        dye(count, whole, one.adsorption * scale, kind, first, second)
        read_bands(whole, whole.phi, phi)
        read_bands(whole, whole.fixed, fixed)


def _adsorb(phi: Float, fixed: Float, cells: Cells, rate: float, function: Callable[[Float, Float], Float]) -> None:
    """What nuno_dye.dyeing.adsorb_row does, with an isotherm that no kernel knows."""
    room = cells.fixed_room
    most = np.minimum(room, function(phi, room)) - fixed
    taken = np.maximum(np.minimum(np.minimum(rate * (phi - fixed), most), phi), 0.0)
    phi -= taken
    fixed += taken
