"""Data and reports that all dye solvers share, and supplies that are maintained through a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from nuno_dye.laws.adsorption import Law
from nuno_dye.laws.diffusivity import Faces, face_sums, face_values
from nuno_dye.laws.isotherms import KINDS, PARTITION, Known, formula_of
from nuno_kernels import kernel, threads_available
from nuno_kernels.lanes import WIDTH, higher, load, store
from nuno_schemas.dye import Dye, DyeReport, DyeState, DyeSystem
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Memory

# Maintained supplies: after every step a cell holds at least its floor, and the added amounts are summed.
#
# The sum is by cell, compensated (Kahan 1965), so that it depends neither on bands nor on passes. Rows without a floor
# are not touched, and without an Upkeep none of this is compiled. All sums of dye are compensated.


class Upkeep(NamedTuple):
    """Floors of one dye and the amounts they added, in bands as in nuno_dye.solvers.diffusion.Bands.

    floor  (b, 2 r, w)  least amounts, 0 without a floor
    given  (b, 2 r, w)  added amounts
    lost   (b, 2 r, w)  rounding errors of these
    rows   (b, r)       whether a row has a floor in either layer
    """

    floor: Float
    given: Float
    lost: Float
    rows: Bool


@kernel
def sum_compensated(values: Float) -> float:
    """Return the sum of a flat array after Neumaier (1974), to rounding of the result and n eps^2 sum |value|."""
    total, lost = 0.0, 0.0
    for i in range(values.shape[0]):
        value = values[i]
        larger = total + value
        lost += (total - larger) + value if abs(total) >= abs(value) else (value - larger) + total
        total = larger
    return total + lost


@kernel
def keep_both(phi: Float, upkeep: Upkeep, b: int, start: int, row: int, r: int) -> None:
    """Raise one row of both layers of band `b`, (2 r, w), to its floor, from column `start`."""
    if upkeep.rows[b, row]:
        keep_row(phi, upkeep.floor[b], upkeep.given[b], upkeep.lost[b], start, row)
        keep_row(phi, upkeep.floor[b], upkeep.given[b], upkeep.lost[b], start, row + r)


@kernel
def keep_row(phi: Float, floor: Float, given: Float, lost: Float, start: int, row: int) -> None:
    """Raise one row of one layer to its floor, from column `start`."""
    for c in range(start, phi.shape[1] - WIDTH, WIDTH):
        present = load(phi, row, c)
        raised = higher(load(floor, row, c), present)
        sum_before = load(given, row, c)
        added = (raised - present) - load(lost, row, c)
        sum_after = sum_before + added
        store(phi, row, c, raised)
        store(given, row, c, sum_after)
        store(lost, row, c, (sum_after - sum_before) - added)


# Data and reports that all dye solvers share.

NONE = Known(PARTITION, 0.0, 0.0)
"""The isotherm of a dye that fibre does not fix."""
Status = Literal["ok", "diverged", "unconverged"]
CELLS_PER_THREAD = 10_000
"""A pass over fewer takes some tens of microseconds, not much longer than waking a thread."""


@dataclass(frozen=True)
class Derived:
    """A system, and data derived from its arrays.

    faces   face values, and `most`, the largest sum of a cell's
    room    least capacity V_u of a cell with faces
    floors  (dyes, 2, ny, nx) maintained amounts, at most the capacity, None if there are none
    """

    system: DyeSystem
    faces: Faces
    most: float
    room: float
    floors: Float | None


class Work(Protocol):
    """A solver's data for a system; `fed` is the part that depends on maintained supplies."""

    derived: Derived
    floor_cache: dict[Any, Any]

    def rebuild(self, system: DyeSystem) -> Work:
        """Return the solver's data for another system."""
        ...


def derive(system: DyeSystem) -> Derived:
    """Return the data derived from a system."""
    faces = face_values(system.cells)
    sums = face_sums(faces)
    room = float(system.cells.mobile_room[sums > 0.0].min(initial=np.inf))
    floors = None if system.supply is None else np.minimum(system.supply, system.cells.mobile_room)
    return Derived(system, faces, float(sums.max()), room, floors)


def renew_work(memory: Memory, system: DyeSystem) -> Any:
    """Return a solver's data, renewed if the system has other cells, dyes, threads or supplies than before."""
    work: Work = memory.work  # type: ignore[assignment]
    before = work.derived.system
    if system.cells is not before.cells or (system.dyes, system.threads) != (before.dyes, before.threads):
        memory.work = work.rebuild(system)
    elif system is not before:
        if system.supply is not before.supply:
            work.floor_cache.clear()
        work.derived = derive(system)
    return memory.work


def adsorbs(one: Dye) -> bool:
    """Return whether fibre fixes this dye."""
    return one.isotherm is not None and one.adsorption > 0.0


def law_of(one: Dye, scale: float) -> Law:
    """Return a dye's law for kernels, `scale` being D0 dt / d^2."""
    isotherm = NONE if one.isotherm is None else formula_of(one.isotherm)
    return Law(isotherm, one.adsorption * scale if adsorbs(one) else 0.0, float(one.uptake == "difference"))


def require_laws(system: DyeSystem) -> None:
    """Raise BadInput for an isotherm of an unknown kind that is no formula."""
    for one in system.dyes:
        if (law := one.isotherm) is not None and (law.kind in KINDS) == (law.law is not None):
            limit = f"{', '.join(KINDS)}, or another kind with a law (nuno_kernels.formula)"
            raise BadInput("no kernel knows this isotherm", value=law.kind, limit=limit)


def largest_amounts(amounts: Float) -> Float:
    """Return the largest (dyes,) of amounts (dyes, 2, ny, nx)."""
    return np.asarray(amounts.reshape(len(amounts), -1).max(axis=1))


def use_threads(highest: NDArray[Any], derived: Derived) -> None:
    """Let kernels use a system's threads, and raise `highest` to the largest maintained amounts, in place."""
    numba.set_num_threads(max(1, min(derived.system.threads, threads_available()[0])))
    if derived.floors is not None:
        np.maximum(highest, largest_amounts(derived.floors), out=highest)


def begin_frame(arrays: Mapping[str, NDArray[Any]], derived: Derived, steps: int) -> bool:
    """Update a solver's memory, `highest` and `met`. Return whether the next step has other cells or floors."""
    use_threads(arrays["highest"], derived)
    room = sum_compensated(derived.system.cells.mobile_room.reshape(-1))
    met = np.array([room, 0.0 if derived.floors is None else sum_compensated(derived.floors.reshape(-1))])
    fresh = steps > 0 and not np.array_equal(met, arrays["met"])
    if fresh:
        arrays["met"][:] = met
    return fresh


def count_bands(system: DyeSystem) -> int:
    """Return the useful number of bands of rows, one a thread. The result does not depend on it."""
    return max(1, min(system.threads, threads_available()[0], system.cells.fibre.size // CELLS_PER_THREAD))


class Banded:
    """A solver whose kernels process bands of rows on several threads."""

    def about(self, system: DyeSystem) -> str:
        """Describe how kernels run a system."""
        available, why = threads_available()
        number = count_bands(system)
        if number == 1 and min(system.threads, available) > 1:
            return f"1 thread: {system.cells.fibre.size:,} cells are fewer than several threads pay for"
        return f"{number} thread{'s' if number > 1 else ''} of {available} ({why})"


def make_report(
    system: DyeSystem, state: DyeState, totals: dict[str, int], supplied: list[float], message: str = ""
) -> DyeReport:
    """Return the report of a frame; `message` gives the reason of a step that failed."""
    mobile, fixed = (
        tuple(sum_compensated(values.reshape(-1)) for values in amounts) for amounts in (state.phi, state.fixed)
    )
    supplied_amounts = tuple(supplied) if system.supply is not None else ()
    status: Status = "unconverged" if message else "ok"
    if not np.isfinite([*mobile, *fixed]).all():
        status, message = "diverged", "amounts of dye are no longer finite"
    return DyeReport(status, totals["steps"], mobile, fixed, message, totals, supplied_amounts)
