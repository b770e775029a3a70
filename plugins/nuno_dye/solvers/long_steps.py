"""Steps of any length: the layout of their kernels, the division of a frame into steps, and the repair of amounts."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from nuno_dye.laws.diffusivity import Curve, curve_of
from nuno_dye.solvers import solving
from nuno_dye.solvers.bands import Cut
from nuno_dye.solvers.diffusion import LEFT, Rows, Weights
from nuno_dye.solvers.solving import sum_compensated
from nuno_kernels import block_kernel, kernel
from nuno_schemas.dye import Dye, DyeReport, DyeState, DyeSystem
from nuno_schemas.fabric import Float, Int, Memory
from nuno_schemas.layout import Bounds

# Repair of amounts below 0 or above capacity after a step, from or to the nearest cells that can; no dye is lost.
#
# Excess flows over faces, through full cells, towards those with room: from every cell to the neighbours that are a
# face nearer to room, by the faces' weights, and at the end by the available room. The nearest cells that have dye fill
# a deficit likewise. Rejected: sharing excess with the neighbours until all are within bounds, which took hundreds of
# sweeps where many full cells are together, and then ended no better than rounding.

ROUNDS = 100
"""The most rounds in which excess moves, each with twice the reach of the last: nearly all of it finds room at once,
and overfilled cells pass their excess on in the next round."""

ROUNDING = 1.0 + 2.0**-49
"""A cell above its capacity by no more than rounding is set to it: among full cells no other could take so little."""
ROOM = 2.0**-20
"""Least free share of its capacity for which a cell is a target, unless there is none."""


@kernel
def face(weights: Any, r: int, row: int, c: int, side: int) -> tuple[float, int, int]:
    """Return the weight of a cell's face, and the row, (2 r, w), and column of the cell behind it; `weights` are of a
    tuple with the fields of Weights.
    """
    if side == 0:
        return weights.along[row, c], row, c + 1
    if side == 1:
        return weights.along[row, c - 1], row, c - 1
    if side == 2:
        return weights.down[row, c], row + 1, c
    if side == 3:
        return weights.down[row - 1, c], row - 1, c
    layer = row // r
    return weights.across[row - layer * r, c], row + r - 2 * layer * r, c


@kernel
def room_of(phi: Float, most: Float, row: int, c: int, lacking: bool) -> float:
    """Return the amount that a cell can take, or, if others are `lacking`, give."""
    there: float = phi[row, c]
    return there if lacking else most[row, c] - there


@kernel
def find_outside(
    phi: Float, most: Float, floor: Float, first: int, last: int, nx: int, lacking: bool, queue: Rows
) -> int:
    """Write cells above capacity, or below 0, into `queue` as row w + c. Return their number."""
    r, w, count = phi.shape[0] // 2, phi.shape[1], 0
    for layer in range(2):
        for row in range(first + layer * r, last + 1 + layer * r):
            for c in range(LEFT, LEFT + nx):
                present, limit = phi[row, c], most[row, c]
                if lacking:
                    outside = present < 0.0 and floor[row, c] == 0.0
                else:
                    outside = present > limit
                    if outside and present <= limit * ROUNDING:
                        phi[row, c] = limit
                        outside = False
                if outside:
                    queue[count] = row * w + c
                    count += 1
    return count


@kernel
def find_ends(
    phi: Float, most: Float, weights: Weights, lacking: bool, queue: Rows, count: int, far: Int, ends: Rows, reach: int
) -> int:
    """Write cells with room within `reach` faces of the `count` first of `queue` into `ends`. Return their number.
    `far` is then 0 in cells with room, -1 in visited ones, and -2 in others.
    """
    r, w, end_count, at = weights.across.shape[0], phi.shape[1], 0, 0
    worth = 0.0 if reach >= phi.size else ROOM
    for n in range(count):
        far[queue[n] // w, queue[n] % w] = -1
    for _ in range(reach):
        layer = count
        for n in range(at, layer):
            row, c = queue[n] // w, queue[n] % w
            for side in range(5):
                weight, i, k = face(weights, r, row, c, side)
                if weight > 0.0 and far[i, k] == -2:
                    if room_of(phi, most, i, k, lacking) > worth * most[i, k]:
                        far[i, k] = 0
                        ends[end_count] = i * w + k
                        end_count += 1
                    else:
                        far[i, k] = -1
                        queue[count] = i * w + k
                        count += 1
        if count == layer:
            break
        at = layer
    return end_count


@kernel
def measure_distances(weights: Weights, w: int, far: Int, ends: Rows, count: int) -> int:
    """Write visited cells into `ends`, nearest to room first, and their distance in faces into `far`. Return their
    number.
    """
    r, at = weights.across.shape[0], 0
    while at < count:
        row, c = ends[at] // w, ends[at] % w
        at += 1
        for side in range(5):
            weight, i, k = face(weights, r, row, c, side)
            if weight > 0.0 and far[i, k] == -1:
                far[i, k] = far[row, c] + 1
                ends[count] = i * w + k
                count += 1
    return count


@kernel
def move_excess(
    phi: Float, most: Float, weights: Weights, floor: Float, lacking: bool, far: Int, row: int, c: int
) -> None:
    """Bring one cell within its bounds; its excess moves a face nearer to room."""
    r, near = weights.across.shape[0], far[row, c] - 1
    if lacking and floor[row, c] > 0.0:
        return
    amount = -phi[row, c] if lacking else phi[row, c] - most[row, c]
    if amount <= 0.0:
        return
    total = 0.0
    for side in range(5):
        weight, i, k = face(weights, r, row, c, side)
        if weight > 0.0 and far[i, k] == near:
            total += max(room_of(phi, most, i, k, lacking), 0.0) if near == 0 else weight
    if total == 0.0:  # others have used all room: this cell waits for the next round
        return
    for side in range(5):
        weight, i, k = face(weights, r, row, c, side)
        if weight > 0.0 and far[i, k] == near:
            share = max(room_of(phi, most, i, k, lacking), 0.0) if near == 0 else weight
            phi[i, k] += (-amount if lacking else amount) * share / total
    phi[row, c] = 0.0 if lacking else most[row, c]


@block_kernel
def repair_side(
    phi: Float, most: Float, floor: Float, weights: Weights, first: int, last: int, nx: int, lacking: bool
) -> int:
    """Bring amounts below capacity, or above 0. Return the number of cells still outside."""
    w = phi.shape[1]
    queue = np.empty(phi.size, np.int64)
    outside = find_outside(phi, most, floor, first, last, nx, lacking, queue)
    if outside == 0:
        return 0
    ends, far = np.empty(phi.size, np.int64), np.empty(phi.shape, np.int32)
    reach = 1
    for _ in range(ROUNDS):
        far[:] = -2
        count = find_ends(phi, most, weights, lacking, queue, outside, far, ends, reach)
        if count == 0 and reach >= phi.size:
            break
        for n in range(measure_distances(weights, w, far, ends, count) - 1, count - 1, -1):
            move_excess(phi, most, weights, floor, lacking, far, ends[n] // w, ends[n] % w)
        outside = find_outside(phi, most, floor, first, last, nx, lacking, queue)
        if outside == 0:
            break
        reach = min(2 * reach, phi.size)
    return outside


@kernel
def repair(phi: Float, most: Float, floor: Float, weights: Weights, first: int, last: int, nx: int) -> int:
    """Bring amounts (2 r, w) into 0 .. `most`. Return the number of cells still outside. NaN stays. A cell with a
    `floor` above 0 may be below 0, since its supply fills it.
    """
    outside = repair_side(phi, most, floor, weights, first, last, nx, False)
    return outside + repair_side(phi, most, floor, weights, first, last, nx, True)


# Steps of any length: the layout of their kernels, and the division of a frame into steps after amounts jump.
#
# A first step over a jump would ring or overshoot, and fibre would keep the dye that it takes of that: the first step,
# and one after cloth or supplies have changed, is taken in parts that grow with the time since (`split_steps`).

BEYOND = 1e3
"""Amount that a maintained cell may hold beyond its capacity while others' excess moves."""
MARGIN = 2
"""Rows of padding beyond the two that every layout has: factors look two rows ahead."""
MOST_WEIGHTS = 4
"""The most lengths of steps with cached weights."""

Pair = tuple[Float, Float]
"""Mobile and fixed dye, (2 r, w) each."""


@dataclass
class Dyed:
    """The state of one dye while it advances.

    number   its place among the system's dyes
    floor    (2 r, w) maintained amounts, None if there are none
    limited  whether limits may bind
    totals   counts of all dyes' steps
    supplied net amount that each step or stage took from supplies
    reason   of the last step that failed
    """

    number: int
    one: Dye
    floor: Float | None
    limited: bool
    totals: dict[str, int]
    supplied: list[float] = field(default_factory=list)
    reason: str = ""

    @property
    def curve(self) -> Curve | None:
        """G of the dye, None if its D is constant."""
        return curve_of(self.one)

    @property
    def fixes(self) -> bool:
        """Whether a kernel fixes this dye."""
        return solving.adsorbs(self.one)


class LongSteps(solving.Banded):
    """A solver that takes steps of any length.

    counts   its totals besides steps
    longest  the most explicit limits in a step; a longer one is taken in equal parts

    `start` of its configuration is the least number of steps in each doubling of the time since a jump.
    """

    name: ClassVar[str]
    counts: ClassVar[tuple[str, ...]]
    longest: ClassVar[float] = math.inf

    @abstractmethod
    def reach(self, layout: Layout, dyed: Dyed, scale: float) -> float:
        """Return the explicit limits in a step, `scale` being D0 dt / d^2."""

    @abstractmethod
    def step(self, layout: Layout, dyed: Dyed, start: Pair, scale: float) -> Pair | None:
        """Return amounts after one step, or None if it fails: then `supplied` is unchanged and `reason` is set."""

    def prepare(self, config: Any, system: DyeSystem, state: DyeState) -> Memory:
        """Return memory: `highest` (dyes,), the largest amount that any cell can have had; `met` (2,), sums of capacity
        and floors in the last step; `since` (1,), steps since these changed. Raises BadInput.
        """
        solving.require_laws(system)
        arrays = {"highest": solving.largest_amounts(state.phi), "met": np.full(2, np.nan), "since": np.zeros(1)}
        return Memory(arrays, Layout(config, system), {"since": Bounds(0.0)})

    def limit(self, config: Any, system: DyeSystem) -> float:
        """Return infinity: every step is stable."""
        return math.inf

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """Advance a state by a frame of `steps` of dt [s]."""
        layout: Layout = solving.renew_work(memory, system)
        highest, since = memory.arrays["highest"], memory.arrays["since"]
        if solving.begin_frame(memory.arrays, layout.derived, steps):
            since[:] = 0.0
        totals, supplied, message = {"steps": steps, **dict.fromkeys(self.counts, 0)}, [], ""
        for k, dye in enumerate(system.dyes):
            limited = not float(highest[k]) <= layout.derived.room
            dyed = Dyed(k, dye, layout.floor(k), limited, totals)
            failed = self._advance_one(layout, dyed, state, steps, dt, int(since[0]))
            supplied.append(math.fsum(dyed.supplied))
            message = message or failed
        state.t += steps * dt
        since[0] = int(since[0]) + steps
        return solving.make_report(system, state, totals, supplied, message)

    def _advance_one(self, layout: Layout, dyed: Dyed, state: DyeState, steps: int, dt: float, since: int) -> str:
        """Advance one dye to the end of a frame, or until a step fails. Return the reason of the failure or ""."""
        phi, fixed = state.phi[dyed.number], state.fixed[dyed.number]
        amounts, failed, parts = (layout.planes(phi), layout.planes(fixed)), "", 1
        scale = dyed.one.D0 * dt / layout.derived.system.cells.size**2
        while self.reach(layout, dyed, scale / parts) > self.longest:
            parts += parts
        reach = self.reach(layout, dyed, scale / parts)
        for share in split_steps(since * parts, steps * parts, reach, layout.config.start):
            stopped = layout.derived.system.leave[0] != 0
            result = None if stopped else self.step(layout, dyed, amounts, float(share) * scale / parts)
            if result is None:
                failed = f"a step of {float(share) * dt / parts:g} s {dyed.reason}"
                break
            amounts = result
        if steps == 0:
            # Compile the kernels, without effect on the state.
            self.step(layout, replace(dyed, totals=dict(dyed.totals), supplied=[]), amounts, 0.0)
        layout.write_back(amounts, phi, fixed)
        return failed


class Layout:
    """A system in the kernels' layout; arrays (2 r, w) hold the weft's rows before the warp's.

    cuts     (b + 1,) first rows of the bands, and the one after the last
    mobile   V_u
    fibre    V_d
    floor_cache  data that depend on maintained supplies
    weights  of the faces, by D0 dt / d^2
    """

    def __init__(self, config: Any, system: DyeSystem) -> None:
        self.config, self.derived, cells = config, solving.derive(system), system.cells
        self.cut = cut = Cut(cells.fibre.shape, 1, MARGIN)
        self.cuts: Rows = cut.top + np.linspace(0, cut.ny, solving.count_bands(system) + 1).astype(np.int64)
        self.mobile, self.fibre = self.planes(cells.mobile_room), self.planes(cells.fixed_room)
        self.floor_cache: dict[Any, Any] = {}
        self.weights: dict[float, Weights] = {}

    def rebuild(self, system: DyeSystem) -> Layout:
        """Return a layout for another system, of the same configuration."""
        return Layout(self.config, system)

    def planes(self, amounts: Float) -> Float:
        """Return amounts (2, ny, nx) in this layout (2 r, w)."""
        return np.asarray(self.cut.fill(amounts)[0][0])

    def floor(self, k: int) -> Float | None:
        """Return the maintained amounts (2 r, w) of dye `k`, None if there are none."""
        floors = self.derived.floors
        if floors is None or not floors[k].any():
            return None
        if k not in self.floor_cache:
            self.floor_cache[k] = self.planes(floors[k])
        return np.asarray(self.floor_cache[k])

    def weights_of(self, scale: float) -> Weights:
        """Return the weights of the faces at D0 dt / d^2, cached for a few lengths of steps."""
        if scale not in self.weights:
            if len(self.weights) >= MOST_WEIGHTS:
                self.weights.clear()
            self.weights[scale] = Weights(*(plane[0] for plane in self.cut.fill_faces(self.derived.faces, scale)))
        return self.weights[scale]

    def write_back(self, amounts: tuple[Float, Float], phi: Float, fixed: Float) -> None:
        """Write mobile and fixed amounts (2 r, w) into `phi` and `fixed` (2, ny, nx)."""
        cut = self.cut
        for values, out in zip(amounts, (phi, fixed), strict=True):
            for layer in range(2):
                at = cut.top + layer * cut.height
                out[layer] = values[at : at + cut.ny, LEFT : LEFT + cut.nx]

    def repair_bounds(self, phi: Float, most: Float, floor: Float | None, scale: float) -> int:
        """Bring amounts (2 r, w) into 0 .. `most`, in place. Return the number of cells still outside. Maintained cells
        take any excess of their neighbours and return it to their supply.
        """
        bounds = most if floor is None else np.where(floor > 0.0, most + BEYOND, most)
        least, cut = np.zeros_like(phi) if floor is None else floor, self.cut
        return repair(phi, bounds, least, self.weights_of(scale), cut.top, cut.top + cut.ny - 1, cut.nx)


def apply_floor(phi: Float, floor: Float | None, most: Float) -> float:
    """Bring maintained cells between their floor and `most`, in place. Return the net amount that this added."""
    if floor is None:
        return 0.0
    at = np.flatnonzero(floor > 0.0)
    cells = phi.reshape(-1)
    before = cells[at]
    cells[at] = np.clip(before, floor.reshape(-1)[at], most.reshape(-1)[at])
    return sum_compensated(cells[at] - before)


def split_steps(since: int, steps: int, reach: float, start: int) -> Float:
    """Return the shares of a step, in order, in which `steps` steps are taken, `since` steps after amounts jumped.

    The spread of a jump depends on r^2 / t, so that steps of equal error grow with the time since: every doubling of it
    takes at least `start` of them. The first step, `reach` explicit steps long, begins with a `start`-th of one. Fibre
    keeps the dye that it takes meanwhile, so that later steps would not correct an error.
    """
    shares: list[float] = []
    for n in range(since, since + steps):
        if n == 0:
            doublings = max(0, math.ceil(math.log2(max(reach, 1.0))))
            for length in (0.5**doublings, *(0.5**i for i in range(doublings, 0, -1))):
                shares += [length / start] * start
        else:
            parts = -(-start // n)
            shares += [1.0 / parts] * parts
    return np.array(shares)
