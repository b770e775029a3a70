"""Runge-Kutta-Legendre super-time-stepping: long explicit steps, of second order (Meyer, Balsara and Aslam 2014).

A step of s stages reaches (s^2 + s - 2) / 4 explicit limits, so that it costs about 4 / s of what they would. Stages
are as many as the step needs. Adsorption, limits and supplies act in every stage (nuno_dye.solvers.rkl2_stage), so that
nothing is split: adsorption apart from diffusion (Strang) was a hundred times less accurate beside a kept-up drop.
Smooth amounts converge with the second order in the step; where a limit begins to bind, or supply to act, with the
first.

A first step over a jump would ring, and fibre would keep what it takes of that: the first one, and one after cloth or
supplies have changed, is taken in parts that grow with the time since, from a quarter of an explicit step on, and so
are the few after it (nuno_dye.solvers.long_steps).

An explicit stage can overshoot where amounts jump. What a step leaves below nothing or above capacity goes to or
comes from the nearest cells that can take or give it (nuno_dye.solvers.repair).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_dye.laws.potential import Curve, curve_of
from nuno_dye.solvers.bands import Cut
from nuno_dye.solvers.diffusion import Rows
from nuno_dye.solvers.fixing import Taking, bound_bands, settle_bands
from nuno_dye.solvers.legendre import find_coefficients, find_stages
from nuno_dye.solvers.long_steps import BEYOND, split_steps, weights_of, write_back
from nuno_dye.solvers.repair import repair
from nuno_dye.solvers.rkl2_rows import ROWS
from nuno_dye.solvers.rkl2_stage import LEVELS, Amounts, Law, Weights, super_step
from nuno_dye.solvers.solving import (
    Known,
    begin_frame,
    count_bands,
    describe_threads,
    know,
    largest_amounts,
    law_of,
    make_report,
    renew_work,
    require_compiled_laws,
)
from nuno_dye.solvers.sums import sum_compensated
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


class Rkl2Config(Config):
    """How a step begins where amounts jump."""

    start: int = Field(4, ge=1, le=1024, description="steps in each doubling of the time since amounts jumped")


@dataclass
class Room:
    """One dye's arrays in the kernel's layout; `floor` is 0 where nothing is kept up, `kept` whether anything is."""

    amounts: Amounts
    mobile: Float
    taking: Taking | None
    floor: Float
    kept: bool
    limited: bool
    curve: Curve | None


@dataclass
class Work:
    """What was made from a system; rooms by dye and whether limits may bind, weights by their scale."""

    config: Rkl2Config
    known: Known
    cut: Cut
    cuts: Rows
    rooms: dict[tuple[int, bool], Room] = field(default_factory=dict)
    weights: dict[float, Weights] = field(default_factory=dict)


class Rkl2:
    """Second-order super-time-stepping."""

    name: ClassVar[str] = "rkl2"
    order: ClassVar[int] = 2
    Config: ClassVar[type[BaseModel]] = Rkl2Config

    def prepare(self, config: Rkl2Config, system: DyeSystem, state: DyeState) -> Memory:
        """Memory: `highest` (dyes,), the largest amount that any cell can have had; `met` (2,), sums of the room and of
        the floors that the last step met; `since` (1,), steps since they were others. Raises BadInput.
        """
        require_compiled_laws(system, self.name)
        arrays = {"highest": largest_amounts(state), "met": np.full(2, np.nan), "since": np.zeros(1)}
        return Memory(arrays, _make_work(config, system))

    def limit(self, config: Rkl2Config, system: DyeSystem) -> float:
        """None: stages follow from the step."""
        return math.inf

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """See nuno_schemas.dye.DyeSolver."""
        work = _renew_work(memory, system)
        highest, since = memory.arrays["highest"], memory.arrays["since"]
        if begin_frame(memory.arrays, work.known, steps):
            since[:] = 0.0
        totals, given, message = {"steps": steps, "stages": 0}, [], ""
        for k in range(len(system.dyes)):
            limited = not float(highest[k]) <= work.known.room
            added, failed = _advance_one(work, k, state, steps, dt, limited, int(since[0]), totals)
            given.append(added)
            message = message or failed
        state.t += steps * dt
        since[0] = int(since[0]) + steps
        return make_report(system, state, totals, given, message)

    def about(self, system: DyeSystem) -> str:
        return describe_threads(system)


def _make_work(config: Rkl2Config, system: DyeSystem) -> Work:
    known = know(system)
    cut = Cut(system.cells.fibre.shape, 1, MARGIN)
    cuts = cut.top + np.linspace(0, cut.ny, count_bands(system) + 1).astype(np.int64)
    return Work(config, known, cut, cuts)


def _renew_work(memory: Memory, system: DyeSystem) -> Work:
    work: Work = memory.work  # type: ignore[assignment]
    memory.work = work = renew_work(work, system, lambda other: _make_work(work.config, other), work.rooms)
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
    floor = np.zeros((2 * work.cut.height, shape[-1])) if floors is None else _planes(work, floors[k])
    kept = bool(floor.any())
    kind, first, second = law_of(system.dyes[k])

    def planes() -> Float:
        return np.zeros((3 * shape[0], shape[1]))

    own = planes()
    held, seen = planes() if kind else own, planes() if kept else own
    # Bands shrink by a row or two a stage at either end, and must keep one: what lies between them stays apart then.
    levels = int(min(LEVELS, max(1, np.diff(work.cuts).min() // 4)))
    scratch = np.zeros((len(work.cuts) - 1, levels * ROWS, shape[1]))
    amounts = Amounts(own, np.zeros(shape), seen, held, planes() if limited else own, scratch)
    fibre = _planes(work, system.cells.fixed_room)
    taking = Taking(held[: shape[0]], np.zeros(shape), fibre, 0.0, kind, first, second) if kind else None
    mobile = _planes(work, system.cells.mobile_room)
    found = Room(amounts, mobile, taking, floor, kept, limited, curve_of(system.dyes[k]))
    work.rooms[k, limited] = found
    return found


def _advance_one(
    work: Work, k: int, state: DyeState, steps: int, dt: float, limited: bool, since: int, totals: dict[str, int]
) -> tuple[float, str]:
    """Bring one dye from the start of a frame to its end or to where a step fails; what was given, why it fails."""
    room, parts = _room(work, k, limited), 1
    one, cells = work.known.system.dyes[k], work.known.system.cells
    scale = one.D0 * dt / cells.size**2
    while find_stages(_reach(work, room, one, scale / parts)) > MOST_STAGES:
        parts += parts
    amounts = _planes(work, state.phi[k]), _planes(work, state.fixed[k])
    given: list[float] = []
    failed, reach = "", _reach(work, room, one, scale / parts)
    for share in split_steps(since * parts, steps * parts, reach, work.config.start):
        after, added = _step(work, room, one, amounts, float(share) * scale / parts, totals)
        if after is None:
            failed = f"a step of {float(share) * dt / parts:g} s leaves amounts beyond capacity"
            break
        amounts = after
        given.append(added)
    if steps == 0:
        _step(work, room, one, amounts, 0.0, dict(totals))
    write_back(work.cut, amounts, state.phi[k], state.fixed[k])
    return math.fsum(given), failed


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
    first, weights = work.cut.top, weights_of(work.weights, work.cut, work.known.faces, scale)
    most = np.maximum(room.mobile, phi)
    # Kept-up cells take any excess of their neighbours': it is given back to the supply that fed them.
    bound_for = np.where(room.floor > 0.0, most + BEYOND, most) if room.kept else most
    if repair(found, bound_for, room.floor, weights, first, first + work.cut.ny - 1, work.cut.nx) > 0:
        return None, 0.0
    given = _keep(room, found, most)
    if taking is not None:
        settle_bands(work.cuts, found, phi, bound, taking, room.floor, work.cut.nx, pace)
        given += _keep(room, found, most)
    return (found, bound), given


def _keep(room: Room, phi: Float, most: Float) -> float:
    """Bring kept-up cells between their floor and `most`; what that took, less what it gave back."""
    if not room.kept:
        return 0.0
    kept = np.where(room.floor > 0.0, np.clip(phi, room.floor, most), phi)
    given = sum_compensated((kept - phi).reshape(-1))
    np.copyto(phi, kept)
    return given


def _run(
    work: Work, room: Room, start: tuple[Float, Float], taking: Taking | None, scale: float, reach: float, pace: float
) -> tuple[Float, Float]:
    """All stages; raw mobile and fixed amounts at their end."""
    amounts, height = room.amounts, len(start[0])
    amounts.mobile.reshape(3, height, -1)[:] = start[0]
    if taking is not None:
        amounts.held.reshape(3, height, -1)[:] = start[1]
    if room.kept:
        np.maximum(start[0], room.floor, out=amounts.seen[:height])
    weights, mobile = weights_of(work.weights, work.cut, work.known.faces, scale), room.mobile if room.limited else None
    coefficients = find_coefficients(find_stages(reach))
    bite, fibre, law = amounts.slope, room.mobile, Law(0.0, 0, 0.0, 0.0, pace, False, room.kept)
    if taking is not None:
        bite, fibre = taking.slope, taking.fibre
        law = Law(taking.rate, taking.isotherm, taking.first, taking.second, pace, True, room.kept)
    super_step(coefficients, law, work.cuts, weights, room.curve, amounts, bite, fibre, room.floor, mobile)
    even = slice(height, 2 * height)
    return amounts.mobile[even].copy(), amounts.held[even].copy() if taking is not None else start[1]
