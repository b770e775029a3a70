"""Runge-Kutta-Legendre super-time-stepping: long explicit steps, of second order (Meyer, Balsara and Aslam 2014).

A step of s stages reaches (s^2 + s - 2) / 4 explicit limits, so that it costs about 4 / s of what they would. Stages
are as many as the step needs. Adsorption, limits and supplies act in every stage (nuno_dye.rkl2_stage), so that
nothing is split: adsorption apart from diffusion (Strang) was a hundred times less accurate beside a kept-up drop.
Smooth amounts converge with the second order in the step; where a limit begins to bind, or supply to act, with the
first.

A first step over a jump would ring: the first one, and one after cloth or supplies have changed, is taken in parts
that double from a quarter of an explicit step on.

An explicit stage can overshoot where amounts jump. What a step leaves below nothing or above capacity goes to or
comes from the nearest cells that can take or give it (nuno_dye.repair).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

from nuno_dye.bands import Cut
from nuno_dye.diffusion import LEFT, Rows
from nuno_dye.fixing import Taking, bound_bands, settle_bands
from nuno_dye.legendre import find_coefficients, find_stages
from nuno_dye.potential import Curve, curve_of
from nuno_dye.repair import repair
from nuno_dye.rkl2_rows import ROWS
from nuno_dye.rkl2_stage import LEVELS, Amounts, Law, Weights, super_step
from nuno_dye.solving import (
    Known,
    begin_frame,
    count_bands,
    describe_threads,
    know,
    largest_amounts,
    law_of,
    make_report,
    require_compiled_laws,
    same_cells,
)
from nuno_dye.sums import sum_compensated
from nuno_schemas.dye import Dye, DyeReport, DyeState, DyeSystem
from nuno_schemas.fabric import Float, Memory
from nuno_schemas.plugin import Config

MARGIN = 2
"""Rows of padding beyond the two that every layout has: factors look two rows ahead."""
MOST_STAGES = 201
"""Rounding grows with the square of the stages; a longer step is taken in parts."""
PACE = 0.25
"""Cells come to their limits in four explicit steps, or in the whole step where that is shorter."""
STIFFER = 1.25
"""By how much limits may raise the largest eigenvalue: PACE of them."""
QUARTERS = 4
"""Parts of each of a fresh step's first doublings: fibre takes most where amounts jump, and keeps it."""
QUARTERED = 4
"""Doublings that are taken in parts, to eight explicit steps. All of them took a third more stages for the same."""
SCALES = 10
"""Steps at most whose weights are kept."""
BEYOND = 1e3
"""What a kept-up cell may hold beyond its capacity while others' excess is moved."""


class Rkl2Config(Config):
    """The solver has no fields of its own."""


@dataclass
class Room:
    """One dye's arrays in the kernel's layout, and weights by their scale."""

    amounts: Amounts
    mobile: Float
    taking: Taking | None
    floor: Float | None
    limited: bool
    curve: Curve | None
    weights: dict[float, Weights] = field(default_factory=dict)


@dataclass
class Work:
    """What was made from a system; rooms by dye and whether limits may bind."""

    known: Known
    cut: Cut
    cuts: Rows
    rooms: dict[tuple[int, bool], Room] = field(default_factory=dict)


class Rkl2:
    """Second-order super-time-stepping."""

    name: ClassVar[str] = "rkl2"
    order: ClassVar[int] = 2
    Config: ClassVar[type[BaseModel]] = Rkl2Config

    def prepare(self, config: Rkl2Config, system: DyeSystem, state: DyeState) -> Memory:
        """Memory: `highest` (dyes,), the largest amount that any cell can have had; `met` (2,), sums of the room and of
        the floors that the last step met. Raises BadInput.
        """
        require_compiled_laws(system, self.name)
        return Memory({"highest": largest_amounts(state), "met": np.full(2, np.nan)}, _make_work(system))

    def limit(self, config: Rkl2Config, system: DyeSystem) -> float:
        """None: stages follow from the step."""
        return math.inf

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """See nuno_schemas.dye.DyeSolver."""
        work = memory.work = _renew_work(memory.work, system)  # type: ignore[arg-type]
        highest, fresh = memory.arrays["highest"], begin_frame(memory.arrays, work.known, steps)
        totals, given, message = {"steps": steps, "stages": 0}, [], ""
        for k in range(len(system.dyes)):
            limited = not float(highest[k]) <= work.known.room
            added, failed = _advance_one(work, k, state, steps, dt, limited, fresh, totals)
            given.append(added)
            message = message or failed
        state.t += steps * dt
        return make_report(system, state, totals, given, message)

    def about(self, system: DyeSystem) -> str:
        return describe_threads(system)


def _make_work(system: DyeSystem) -> Work:
    known = know(system)
    cut = Cut(system.cells.fibre.shape, 1, MARGIN)
    cuts = cut.top + np.linspace(0, cut.ny, count_bands(system) + 1).astype(np.int64)
    return Work(known, cut, cuts)


def _renew_work(work: Work, system: DyeSystem) -> Work:
    """What still holds for a system that may have other cells, dyes, threads or another supply than before."""
    if system is work.known.system:
        return work
    if not same_cells(system, work.known.system):
        return _make_work(system)
    if system.supply is not work.known.system.supply:
        work.rooms.clear()
    work.known = know(system)
    return work


def _planes(work: Work, array: Float) -> Float:
    """(2, ny, nx) in the kernel's layout (2 r, w)."""
    layout: Float = work.cut.fill(array)[0][0]
    return layout


def _room(work: Work, k: int, limited: bool) -> Room:
    found = work.rooms.get((k, limited))
    if found is not None:
        return found
    system, shape, floors = work.known.system, work.cut.shape[1:], work.known.floors
    floor = _planes(work, floors[k]) if floors is not None and floors[k].any() else None
    kind, first, second = law_of(system.dyes[k])

    def planes() -> Float:
        return np.zeros((3 * shape[0], shape[1]))

    own = planes()
    held, seen = planes() if kind else own, own if floor is None else planes()
    # Bands shrink by a row or two a stage at either end, and must keep one: what lies between them stays apart then.
    levels = int(min(LEVELS, max(1, np.diff(work.cuts).min() // 4)))
    scratch = np.zeros((len(work.cuts) - 1, levels * ROWS, shape[1]))
    amounts = Amounts(own, np.zeros(shape), seen, held, planes() if limited else own, scratch)
    fibre = _planes(work, system.cells.fixed_room)
    taking = Taking(held[: shape[0]], np.zeros(shape), fibre, 0.0, kind, first, second) if kind else None
    found = Room(amounts, _planes(work, system.cells.mobile_room), taking, floor, limited, curve_of(system.dyes[k]))
    work.rooms[k, limited] = found
    return found


def _advance_one(
    work: Work, k: int, state: DyeState, steps: int, dt: float, limited: bool, fresh: bool, totals: dict[str, int]
) -> tuple[float, str]:
    """Bring one dye from the start of a frame to its end; what its supplies gave, and why a step failed."""
    room, parts = _room(work, k, limited), 1
    one, cells = work.known.system.dyes[k], work.known.system.cells
    scale = one.D0 * dt / cells.size**2
    while find_stages(_reach(work, room, one, scale / parts)) > MOST_STAGES:
        parts += parts
    amounts = _planes(work, state.phi[k]), _planes(work, state.fixed[k])
    given: list[float] = []
    shares = np.ones(steps * parts)
    if fresh:
        doublings = max(0, math.ceil(math.log2(max(_reach(work, room, one, scale / parts), 1.0))))
        doubling = np.concatenate([[0.5**doublings], 0.5 ** np.arange(doublings, 0, -1.0)])
        quartered = np.repeat(doubling[:QUARTERED] / QUARTERS, QUARTERS)
        shares = np.concatenate([quartered, doubling[QUARTERED:], shares[1:]])
    for share in shares:
        after, added = _step(work, room, one, amounts, float(share) * scale / parts, totals)
        if after is None:
            return math.fsum(given), f"a step of {float(share) * dt / parts:g} s leaves amounts beyond capacity"
        amounts = after
        given.append(added)
    if steps == 0:
        _step(work, room, one, amounts, 0.0, dict(totals))
    for values, out in zip(amounts, (state.phi[k], state.fixed[k]), strict=True):
        for layer in range(2):
            at = work.cut.top + layer * work.cut.height
            out[layer] = values[at : at + work.cut.ny, LEFT : LEFT + work.cut.nx]
    return math.fsum(given), ""


def _reach(work: Work, room: Room, one: Dye, scale: float) -> float:
    """Explicit limits in a step."""
    stiffer = STIFFER if room.limited or room.taking is not None else 1.0
    return scale * (work.known.most * one.steepest * stiffer + (one.adsorption if room.taking is not None else 0.0))


def _step(
    work: Work, room: Room, one: Dye, start: tuple[Float, Float], scale: float, totals: dict[str, int]
) -> tuple[tuple[Float, Float] | None, float]:
    """One step; mobile and fixed dye at its end, None where that fails, and what was given."""
    phi = start[0]
    reach = _reach(work, room, one, scale)
    pace, taking = max(PACE * reach, 1.0), room.taking
    taking = taking and taking._replace(rate=one.adsorption * scale)
    found, bound = _run(work, room, start, taking, scale, reach, pace)
    totals["stages"] += find_stages(reach)
    if taking is not None:
        bound_bands(work.cuts, found, phi, bound, taking, room.floor, work.cut.nx)
    first, weights = work.cut.top, _weights(work, room, scale)
    most = np.maximum(room.mobile, phi)
    # Kept-up cells take any excess of their neighbours': it is given back to the supply that fed them.
    bound_for = most if room.floor is None else np.where(room.floor > 0.0, most + BEYOND, most)
    if repair(found, bound_for, room.floor, weights, first, first + work.cut.ny - 1, work.cut.nx) > 0:
        return None, 0.0
    given = _keep(room, found, most)
    if taking is not None:
        settle_bands(work.cuts, found, phi, bound, taking, room.floor, work.cut.nx, pace)
        given += _keep(room, found, most)
    return (found, bound), given


def _keep(room: Room, phi: Float, most: Float) -> float:
    """Bring kept-up cells between their floor and `most`; what that took, less what it gave back."""
    if room.floor is None:
        return 0.0
    kept = np.where(room.floor > 0.0, np.clip(phi, room.floor, most), phi)
    given = sum_compensated((kept - phi).reshape(-1))
    np.copyto(phi, kept)
    return given


def _weights(work: Work, room: Room, scale: float) -> Weights:
    if scale not in room.weights:
        if len(room.weights) >= SCALES:
            room.weights.clear()
        along, down, across = (plane[0] for plane in work.cut.fill_faces(work.known.faces, scale))
        room.weights[scale] = Weights(along, down, across)
    return room.weights[scale]


def _run(
    work: Work, room: Room, start: tuple[Float, Float], taking: Taking | None, scale: float, reach: float, pace: float
) -> tuple[Float, Float]:
    """All stages; raw mobile and fixed amounts at their end."""
    amounts, height = room.amounts, len(start[0])
    amounts.mobile.reshape(3, height, -1)[:] = start[0]
    if taking is not None:
        amounts.held.reshape(3, height, -1)[:] = start[1]
    if room.floor is not None:
        np.maximum(start[0], room.floor, out=amounts.seen[:height])
    weights, mobile = _weights(work, room, scale), room.mobile if room.limited else None
    coefficients = find_coefficients(find_stages(reach))
    bite, fibre, law = None, None, Law(0.0, 0, 0.0, 0.0, pace)
    if taking is not None:
        bite, fibre = taking.slope, taking.fibre
        law = Law(taking.rate, taking.isotherm, taking.first, taking.second, pace)
    super_step(coefficients, law, work.cuts, weights, room.curve, amounts, bite, fibre, room.floor, mobile)
    even = slice(height, 2 * height)
    return amounts.mobile[even].copy(), amounts.held[even].copy() if taking is not None else start[1]
