"""The explicit solver: the dye paper's scheme, whole frames of steps in one compiled call for each dye.

Where no limit can bind, the faster kernel of diffusion alone takes the steps, with adsorption as the case is. A step
of it replaces each amount by a mean of itself and its neighbours', with weights that add to 1 and are none of them
negative as long as D0 dt / size^2 sum P T <= 1; limits only make the neighbours' weights smaller, and adsorption the
amounts. So no amount ever exceeds the largest of those at the start and of what supplies have kept up since, and a
cell's inflow is at most (that - phi). Nothing can be limited, then, if every cell that a face reaches has room for
it. Memory keeps this largest amount, so that a resumed run chooses its kernel as the whole run did.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numba
import numpy as np
from pydantic import BaseModel

from nuno_dye.adsorption import FREUNDLICH, LANGMUIR, NOTHING, PARTITION, Uptake
from nuno_dye.bands import Cut, make_bands, make_dye_bands, read_bands
from nuno_dye.diffusion import GHOST, Bands, diffuse
from nuno_dye.dyeing import LEVELS, DyeBands, dye
from nuno_dye.faces import Faces, face_sums, face_values
from nuno_dye.sums import sum_compensated
from nuno_dye.upkeep import Upkeep, begin_upkeep, make_upkeep, sum_given
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
    """What was made from a system's cells, dyes and threads, and from its supply.

    faces   face values, and `most`, the largest sum of a cell's
    room    least capacity V_u of a cell that a face reaches
    floors  (dyes, 2, ny, nx) what is kept up as far as there is room, None where nothing is
    bands   by dye, and whether limits may bind: the step [s] and the kernel's layout for it
    upkeep  by dye and ghost rows: the layout of its floors
    fibre   by ghost rows: the layout of V_d
    """

    system: DyeSystem
    faces: Faces
    most: float
    room: float
    floors: Float | None
    bands: dict[tuple[int, bool], tuple[float, Bands | DyeBands]] = field(default_factory=dict)
    upkeep: dict[tuple[int, int], Upkeep] = field(default_factory=dict)
    fibre: dict[int, Float] = field(default_factory=dict)


class Explicit:
    """Adsorption, then diffusion with all fluxes from the same amounts."""

    name: ClassVar[str] = "explicit"
    Config: ClassVar[type[BaseModel]] = ExplicitConfig

    def prepare(self, config: ExplicitConfig, system: DyeSystem, state: DyeState) -> Memory:
        """Memory: `highest` (dyes,), the largest amount that any cell can have had."""
        for one in system.dyes:
            law = one.isotherm
            if law is not None and (law.kind not in KINDS or (law.kind == "python") != (law.function is not None)):
                raise BadInput("no kernel knows this isotherm", value=law.kind, limit=", ".join(KINDS))
        highest = state.phi.reshape(len(system.dyes), -1).max(axis=1)
        return Memory({"highest": highest.astype(np.float64)}, _make_work(system))

    def limit(self, config: ExplicitConfig, system: DyeSystem) -> float:
        """D0 dt / size^2 times the largest sum of P T over a cell's faces is 1 there."""
        most = float(face_sums(face_values(system.cells)).max()) * max(one.D0 for one in system.dyes)
        return system.cells.size**2 / most if most > 0.0 else float(np.inf)

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """See nuno_schemas.dye.DyeSolver."""
        work = memory.work = _renew_work(memory.work, system)  # type: ignore[arg-type]
        highest = memory.arrays["highest"]
        numba.set_num_threads(max(1, min(system.threads, threads_available()[0])))
        supplied = []
        for k in range(len(system.dyes)):
            if work.floors is not None:
                highest[k] = max(highest[k], work.floors[k].max())
            supplied.append(_advance_one(work, k, state, steps, dt, float(highest[k])))
        state.t += steps * dt
        mobile, fixed = (
            tuple(sum_compensated(values.reshape(-1)) for values in amounts) for amounts in (state.phi, state.fixed)
        )
        finite = bool(np.isfinite([*mobile, *fixed]).all())
        status, message = ("ok", "") if finite else ("diverged", "amounts of dye are no longer finite")
        gave = tuple(supplied) if system.supply is not None else ()
        return DyeReport(status, steps, mobile, fixed, message, {"steps": steps}, gave)  # type: ignore[arg-type]

    def about(self, system: DyeSystem) -> str:
        available, why = threads_available()
        number = _bands(system)
        if number == 1 and min(system.threads, available) > 1:
            return f"1 thread: {system.cells.fibre.size:,} cells are fewer than several threads pay for"
        return f"{number} thread{'s' if number > 1 else ''} of {available} ({why})"


def _make_work(system: DyeSystem) -> Work:
    faces = face_values(system.cells)
    sums = face_sums(faces)
    room = float(system.cells.mobile_room[sums > 0.0].min(initial=np.inf))
    return Work(system, faces, float(sums.max()), room, _floors(system))


def _renew_work(work: Work, system: DyeSystem) -> Work:
    """What still holds for a system that may have other cells, dyes, threads or another supply than before."""
    before = work.system
    if system is before:
        return work
    if system.cells is not before.cells or system.dyes != before.dyes or system.threads != before.threads:
        return _make_work(system)
    if system.supply is not before.supply:
        work.floors = _floors(system)
        work.upkeep.clear()
    work.system = system
    return work


def _floors(system: DyeSystem) -> Float | None:
    return None if system.supply is None else np.minimum(system.supply, system.cells.mobile_room)


def _adsorbs(one: Dye) -> bool:
    return one.isotherm is not None and one.adsorption > 0.0


def _bands(system: DyeSystem) -> int:
    """Bands, one a thread: as many as are worth it. The result does not depend on them."""
    return max(1, min(system.threads, threads_available()[0], system.cells.fibre.size // CELLS_PER_THREAD))


def _upkeep(work: Work, k: int, cut: Cut) -> Upkeep | None:
    """Floors of one dye in a kernel's layout, with nothing given yet; None where it has none."""
    if work.floors is None or not work.floors[k].any():
        return None
    found = work.upkeep.get((k, cut.ghost))
    if found is None:
        found = work.upkeep[k, cut.ghost] = make_upkeep(cut.fill(work.floors[k])[0])
    return begin_upkeep(found)


def _uptake(work: Work, k: int, cut: Cut, dt: float) -> Uptake | None:
    """Fibre of one dye in a kernel's layout; None where the kernel fixes nothing."""
    one, cells = work.system.dyes[k], work.system.cells
    law = one.isotherm
    if law is None or not _adsorbs(one) or law.kind == "python":
        return None
    if cut.ghost not in work.fibre:
        work.fibre[cut.ghost] = cut.fill(cells.fixed_room)[0]
    kind = PARTITION if law.kind == "freundlich" and law.second == 1.0 else KINDS[law.kind]
    rate = one.adsorption * (one.D0 * dt / cells.size**2)
    return Uptake(np.empty(cut.shape), work.fibre[cut.ghost], rate, kind, law.first, law.second)


def _advance_one(work: Work, k: int, state: DyeState, steps: int, dt: float, highest: float) -> float:
    """Bring one dye from the start of a frame to its end; with no steps, compile what they need.

    Returns what its supplies gave.
    """
    system, phi, fixed = work.system, state.phi[k], state.fixed[k]
    one, cells = system.dyes[k], system.cells
    scale = one.D0 * dt / cells.size**2
    limited = not highest <= work.room or scale * work.most > 1.0
    cut = Cut(phi.shape, _bands(system), 2 * LEVELS if limited else GHOST)
    bands = _layout(work, k, limited, dt, scale, cut.number)
    uptake, upkeep = _uptake(work, k, cut, dt), _upkeep(work, k, cut)
    function = one.isotherm.function if one.isotherm is not None and _adsorbs(one) else None
    for count in [steps] if function is None or not steps else [1] * steps:
        if function is not None and count:
            _adsorb(phi, fixed, cells, one.adsorption * scale, function)
        bands = bands._replace(phi=cut.fill(phi)[0])
        uptake = uptake and uptake._replace(fixed=cut.fill(fixed)[0])
        (dye if limited else diffuse)(count, bands, uptake, upkeep)
        read_bands(bands, bands.phi, phi)
        if uptake is not None:
            read_bands(bands, uptake.fixed, fixed)
    if upkeep is None:
        return 0.0
    return sum_given(*(read_bands(bands, values, np.empty(phi.shape)) for values in (upkeep.given, upkeep.lost)))


def _layout(work: Work, k: int, limited: bool, dt: float, scale: float, number: int) -> Bands | DyeBands:
    """One dye's weights in a kernel's layout."""
    known, bands = work.bands.get((k, limited), (0.0, None))
    if bands is None or known != dt:
        empty, cells = np.zeros(work.system.cells.fibre.shape), work.system.cells
        bands = (
            make_dye_bands(empty, cells, work.faces, scale, number)
            if limited
            else make_bands(empty, work.faces, scale, number)
        )
        work.bands[k, limited] = dt, bands
    return bands


def _adsorb(phi: Float, fixed: Float, cells: Cells, rate: float, function: Callable[[Float, Float], Float]) -> None:
    """What nuno_dye.adsorption.adsorb_row does, with an isotherm that no kernel knows."""
    room = cells.fixed_room
    most = np.minimum(room, function(phi, room)) - fixed
    taken = np.maximum(np.minimum(np.minimum(rate * (phi - fixed), most), phi), 0.0)
    phi -= taken
    fixed += taken
