"""What every dye solver needs to know of a system, and what it reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from nuno_dye.laws.adsorption import FREUNDLICH, LANGMUIR, NOTHING, PARTITION, Uptake
from nuno_dye.laws.faces import Faces, face_sums, face_values
from nuno_dye.solvers.sums import sum_compensated
from nuno_kernels import threads_available
from nuno_schemas.dye import Dye, DyeReport, DyeState, DyeSystem
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

KINDS = {"partition": PARTITION, "freundlich": FREUNDLICH, "langmuir": LANGMUIR, "python": NOTHING}
"""Isotherms; one in Python is worked out between steps."""
CELLS_PER_THREAD = 10_000
"""A pass over fewer takes some tens of microseconds, not much longer than to wake a thread."""


@dataclass(frozen=True)
class Known:
    """A system, and what follows from its arrays.

    faces   face values, and `most`, the largest sum of a cell's
    room    least capacity V_u of a cell that a face reaches
    floors  (dyes, 2, ny, nx) what is kept up as far as there is room, None where nothing is
    """

    system: DyeSystem
    faces: Faces
    most: float
    room: float
    floors: Float | None


class Works(Protocol):
    """What a solver has made from a system."""

    known: Known


W = TypeVar("W", bound=Works)


def know(system: DyeSystem) -> Known:
    """What follows from a system."""
    faces = face_values(system.cells)
    sums = face_sums(faces)
    room = float(system.cells.mobile_room[sums > 0.0].min(initial=np.inf))
    floors = None if system.supply is None else np.minimum(system.supply, system.cells.mobile_room)
    return Known(system, faces, float(sums.max()), room, floors)


def measure_known(known: Known) -> Float:
    """(2,) sums of the room for mobile dye and of the floors."""
    room = sum_compensated(known.system.cells.mobile_room.reshape(-1))
    return np.array([room, 0.0 if known.floors is None else sum_compensated(known.floors.reshape(-1))])


def same_cells(one: DyeSystem, other: DyeSystem) -> bool:
    """Whether what was made from cells, dyes and threads holds for both; arrays count as changed if they are others."""
    return one.cells is other.cells and one.dyes == other.dyes and one.threads == other.threads


def renew_work(work: W, system: DyeSystem, make: Callable[[DyeSystem], W], fed: dict[Any, Any]) -> W:
    """What still holds for a system that may have other cells, dyes, threads or another supply than before.

    `fed` is the part of it that depends on the supply.
    """
    before = work.known.system
    if system is before:
        return work
    if not same_cells(system, before):
        return make(system)
    if system.supply is not before.supply:
        fed.clear()
    work.known = know(system)
    return work


def adsorbs(one: Dye) -> bool:
    """Whether fibre fixes any of it."""
    return one.isotherm is not None and one.adsorption > 0.0


def law_of(one: Dye) -> tuple[int, float, float]:
    """Kind of its isotherm for the kernels, and its numbers; with exponent 1 Freundlich's is partition."""
    law = one.isotherm
    if law is None or not adsorbs(one):
        return NOTHING, 0.0, 0.0
    kind = PARTITION if law.kind == "freundlich" and law.second == 1.0 else KINDS[law.kind]
    return kind, law.first, law.second


def uptake_of(one: Dye, fixed: Float, fibre: Float, scale: float) -> Uptake | None:
    """Adsorption of one dye, scale being D0 dt / d^2; None where no kernel fixes any."""
    kind, first, second = law_of(one)
    return None if kind == NOTHING else Uptake(fixed, fibre, one.adsorption * scale, kind, first, second)


def require_laws(system: DyeSystem) -> None:
    """Raises BadInput for an isotherm of an unknown kind."""
    for one in system.dyes:
        law = one.isotherm
        if law is not None and (law.kind not in KINDS or (law.kind == "python") != (law.function is not None)):
            raise BadInput("no kernel knows this isotherm", value=law.kind, limit=", ".join(KINDS))


def require_compiled_laws(system: DyeSystem, solver: str) -> None:
    """Raises BadInput for an isotherm that no kernel knows, and for one in Python."""
    require_laws(system)
    for one in system.dyes:
        if one.isotherm is not None and one.isotherm.kind == "python":
            remedy = "solver: explicit, or one of the isotherms that come with it"
            raise BadInput(f"{solver} knows no isotherm in Python", value=one.name, remedy=remedy)


def largest_amounts(state: DyeState) -> Float:
    """(dyes,) largest mobile amounts, a solver's memory of what any cell can have had."""
    largest: Float = state.phi.reshape(state.phi.shape[0], -1).max(axis=1)
    return largest


def raise_largest(highest: NDArray[Any], known: Known) -> None:
    """Count what supplies keep up among the largest amounts, in place."""
    if known.floors is not None:
        np.maximum(highest, known.floors.reshape(len(highest), -1).max(axis=1), out=highest)


def begin_frame(arrays: Mapping[str, NDArray[Any]], known: Known, steps: int) -> bool:
    """Bring a solver's memory, `highest` and `met`, up to date; whether the next step meets other cells or floors."""
    raise_largest(arrays["highest"], known)
    numba.set_num_threads(max(1, min(known.system.threads, threads_available()[0])))
    met = measure_known(known)
    fresh = steps > 0 and not np.array_equal(met, arrays["met"])
    if fresh:
        arrays["met"][:] = met
    return fresh


def count_bands(system: DyeSystem) -> int:
    """Bands of rows, one a thread: as many as are worth it. The result does not depend on them."""
    return max(1, min(system.threads, threads_available()[0], system.cells.fibre.size // CELLS_PER_THREAD))


def describe_threads(system: DyeSystem) -> str:
    """How kernels run it, in words."""
    available, why = threads_available()
    number = count_bands(system)
    if number == 1 and min(system.threads, available) > 1:
        return f"1 thread: {system.cells.fibre.size:,} cells are fewer than several threads pay for"
    return f"{number} thread{'s' if number > 1 else ''} of {available} ({why})"


def make_report(
    system: DyeSystem, state: DyeState, totals: dict[str, int], supplied: list[float], message: str = ""
) -> DyeReport:
    """What was done in a frame; `message` says why a step could not be taken."""
    mobile, fixed = (
        tuple(sum_compensated(values.reshape(-1)) for values in amounts) for amounts in (state.phi, state.fixed)
    )
    gave = tuple(supplied) if system.supply is not None else ()
    if not np.isfinite([*mobile, *fixed]).all():
        message = "amounts of dye are no longer finite"
        return DyeReport("diverged", totals["steps"], mobile, fixed, message, totals, gave)
    status = "unconverged" if message else "ok"
    return DyeReport(status, totals["steps"], mobile, fixed, message, totals, gave)  # type: ignore[arg-type]
