"""Steps of any length: the layout that their kernels take, and how a frame is cut into steps after amounts jump.

A first step over a jump would ring or overshoot, and fibre would keep what it takes of that: the first one, and one
after cloth or supplies have changed, is taken in parts that grow with the time since (`split_steps`).
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from nuno_dye.laws.adsorption import NOTHING
from nuno_dye.laws.potential import Curve, curve_of
from nuno_dye.solvers import solving
from nuno_dye.solvers.bands import Cut
from nuno_dye.solvers.diffusion import LEFT, Rows, Weights
from nuno_dye.solvers.repair import repair
from nuno_dye.solvers.upkeep import sum_compensated
from nuno_schemas.dye import Dye, DyeReport, DyeState, DyeSystem
from nuno_schemas.fabric import Float, Memory
from nuno_schemas.layout import Bounds

BEYOND = 1e3
"""What a kept-up cell may hold beyond its capacity while others' excess is moved."""
MARGIN = 2
"""Rows of padding beyond the two that every layout has: factors look two rows ahead."""
MOST_WEIGHTS = 4
"""Lengths of steps whose weights are kept."""

Pair = tuple[Float, Float]
"""Mobile and fixed dye, (2 r, w) each."""


@dataclass
class Dyed:
    """One dye while it is advanced.

    number   its place among the system's dyes
    floor    (2 r, w) what is kept up of it, None where nothing is
    limited  whether limits may bind
    totals   what steps count, of all dyes
    given    what each step or stage took from supplies, less what it gave back
    why      why the last step that failed did
    """

    number: int
    one: Dye
    floor: Float | None
    limited: bool
    totals: dict[str, int]
    given: list[float] = field(default_factory=list)
    why: str = ""

    @property
    def curve(self) -> Curve | None:
        """How D falls with the dye."""
        return curve_of(self.one)

    @property
    def fixes(self) -> bool:
        """Whether fibre takes any in a kernel."""
        return solving.law_of(self.one, 1.0).kind != NOTHING


class LongSteps(solving.Banded):
    """A solver that takes steps of any length.

    counts   what its totals count beside steps
    longest  the most explicit limits that a step may reach; a longer one is taken in equal parts

    Its configuration says with `start` in how many steps each doubling of the time since a jump is taken at least.
    """

    name: ClassVar[str]
    counts: ClassVar[tuple[str, ...]]
    longest: ClassVar[float] = math.inf

    @abstractmethod
    def reach(self, layout: Layout, dyed: Dyed, scale: float) -> float:
        """Explicit limits in a step, `scale` being D0 dt / d^2."""

    @abstractmethod
    def step(self, layout: Layout, dyed: Dyed, start: Pair, scale: float) -> Pair | None:
        """Amounts after one step; None where it fails, and then nothing is added to `given` and `why` is told."""

    def prepare(self, config: Any, system: DyeSystem, state: DyeState) -> Memory:
        """Memory: `highest` (dyes,), the largest amount that any cell can have had; `met` (2,), sums of the room and of
        the floors that the last step met; `since` (1,), steps since they were others. Raises BadInput.
        """
        solving.require_compiled_laws(system, self.name)
        arrays = {"highest": solving.largest_amounts(state.phi), "met": np.full(2, np.nan), "since": np.zeros(1)}
        return Memory(arrays, Layout(config, system), {"since": Bounds(0.0)})

    def limit(self, config: Any, system: DyeSystem) -> float:
        """No limit: every step is stable."""
        return math.inf

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """See nuno_schemas.dye.DyeSolverPlugin."""
        layout: Layout = solving.renew_work(memory, system)
        highest, since = memory.arrays["highest"], memory.arrays["since"]
        if solving.begin_frame(memory.arrays, layout.known, steps):
            since[:] = 0.0
        totals, given, message = {"steps": steps, **dict.fromkeys(self.counts, 0)}, [], ""
        for k, one in enumerate(system.dyes):
            limited = not float(highest[k]) <= layout.known.room
            dyed = Dyed(k, one, layout.floor(k), limited, totals)
            failed = self._advance_one(layout, dyed, state, steps, dt, int(since[0]))
            given.append(math.fsum(dyed.given))
            message = message or failed
        state.t += steps * dt
        since[0] = int(since[0]) + steps
        return solving.make_report(system, state, totals, given, message)

    def _advance_one(self, layout: Layout, dyed: Dyed, state: DyeState, steps: int, dt: float, since: int) -> str:
        """Bring one dye from the start of a frame to its end or to where a step fails; why it fails."""
        phi, fixed = state.phi[dyed.number], state.fixed[dyed.number]
        amounts, failed, parts = (layout.planes(phi), layout.planes(fixed)), "", 1
        scale = dyed.one.D0 * dt / layout.known.system.cells.size**2
        while self.reach(layout, dyed, scale / parts) > self.longest:
            parts += parts
        reach = self.reach(layout, dyed, scale / parts)
        for share in split_steps(since * parts, steps * parts, reach, layout.config.start):
            leaves = layout.known.system.leave[0] != 0
            after = None if leaves else self.step(layout, dyed, amounts, float(share) * scale / parts)
            if after is None:
                failed = f"a step of {float(share) * dt / parts:g} s {dyed.why}"
                break
            amounts = after
        if steps == 0:
            # Compiles the kernels; nothing of it is kept.
            self.step(layout, replace(dyed, totals=dict(dyed.totals), given=[]), amounts, 0.0)
        layout.write_back(amounts, phi, fixed)
        return failed


class Layout:
    """What was made from a system; arrays (2 r, w) hold the weft's rows before the warp's.

    cuts     (b + 1,) first rows of the bands, and the one after the last
    mobile   V_u
    fibre    V_d
    fed      what depends on what supplies keep up
    weights  of the faces, by D0 dt / d^2
    """

    def __init__(self, config: Any, system: DyeSystem) -> None:
        self.config, self.known, cells = config, solving.know(system), system.cells
        self.cut = cut = Cut(cells.fibre.shape, 1, MARGIN)
        self.cuts: Rows = cut.top + np.linspace(0, cut.ny, solving.count_bands(system) + 1).astype(np.int64)
        self.mobile, self.fibre = self.planes(cells.mobile_room), self.planes(cells.fixed_room)
        self.fed: dict[Any, Any] = {}
        self.weights: dict[float, Weights] = {}

    def made_for(self, system: DyeSystem) -> Layout:
        """A layout for another system, of the same configuration."""
        return Layout(self.config, system)

    def planes(self, amounts: Float) -> Float:
        """(2 r, w) amounts (2, ny, nx) in this layout."""
        return np.asarray(self.cut.fill(amounts)[0][0])

    def floor(self, k: int) -> Float | None:
        """(2 r, w) what is kept up of dye `k`, None where nothing is."""
        floors = self.known.floors
        if floors is None or not floors[k].any():
            return None
        if k not in self.fed:
            self.fed[k] = self.planes(floors[k])
        return np.asarray(self.fed[k])

    def weights_of(self, scale: float) -> Weights:
        """Weights of the faces at D0 dt / d^2; those of the last few lengths of steps are kept."""
        if scale not in self.weights:
            if len(self.weights) >= MOST_WEIGHTS:
                self.weights.clear()
            self.weights[scale] = Weights(*(plane[0] for plane in self.cut.fill_faces(self.known.faces, scale)))
        return self.weights[scale]

    def write_back(self, amounts: tuple[Float, Float], phi: Float, fixed: Float) -> None:
        """Put mobile and fixed amounts (2 r, w) into (2, ny, nx)."""
        cut = self.cut
        for values, out in zip(amounts, (phi, fixed), strict=True):
            for layer in range(2):
                at = cut.top + layer * cut.height
                out[layer] = values[at : at + cut.ny, LEFT : LEFT + cut.nx]

    def mend(self, phi: Float, most: Float, floor: Float | None, scale: float) -> int:
        """Bring amounts (2 r, w) into 0 .. `most`, in place; how many cells still lie outside.

        Kept-up cells take any excess of their neighbours': it is given back to the supply that fed them.
        """
        bounds = most if floor is None else np.where(floor > 0.0, most + BEYOND, most)
        least, cut = np.zeros_like(phi) if floor is None else floor, self.cut
        return repair(phi, bounds, least, self.weights_of(scale), cut.top, cut.top + cut.ny - 1, cut.nx)


def keep_up(phi: Float, floor: Float | None, most: Float) -> float:
    """Bring kept-up cells between their floor and `most`, in place; what that took, less what it gave back."""
    if floor is None:
        return 0.0
    at = np.flatnonzero(floor > 0.0)
    cells = phi.reshape(-1)
    before = cells[at]
    cells[at] = np.clip(before, floor.reshape(-1)[at], most.reshape(-1)[at])
    return sum_compensated(cells[at] - before)


def split_steps(since: int, steps: int, reach: float, start: int) -> Float:
    """Shares of a step, in order, that `steps` steps are taken in, `since` steps after amounts have jumped.

    What a jump spreads depends on r^2 / t, so that steps of equal error grow with the time since: every doubling of
    it takes `start` of them at least. The first step begins with a `start`-th of an explicit step, `reach` of which
    it is long. Fibre keeps what it takes meanwhile, so that no later step would mend it.
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
