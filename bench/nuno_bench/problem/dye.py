"""A scene of dye run by any dye solver, without services, and what is observed of it at every frame."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel

from nuno import registry
from nuno.dye.run import DyeRun
from nuno.scene.chosen_plugins import Chosen
from nuno.scene.scene_file import Loaded
from nuno_bench.machine import cores
from nuno_bench.problem.observe import Problem, Run, Series, advance_all, check_memory, make_problem
from nuno_schemas.dye import DyeReport, DyeState
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.system import StepLimit

AMOUNTS = "amounts"
SCHEME = "explicit"
"""The plainest solver: what errors are measured against is made of it."""


@dataclass(frozen=True)
class DyeProblem:
    """A scene of dye ready to be run by any solver; see nuno_bench.problem.observe.Problem, which is one of cloth.

    Its series hold mobile and fixed dye of every cell as x (f, dyes * cells, 2), and by dye as values (f, dyes)
    their totals, and the spread [m]: the root mean square distance of dye from its middle.
    """

    loaded: Loaded
    threads: int
    group: ClassVar[str] = "nuno.dye_solvers"
    leading: ClassVar[str] = AMOUNTS
    observables: ClassVar[Mapping[str, str]] = {
        "mobile": "all mobile dye",
        "fixed": "all dye that fibre has taken",
        "spread": "root of the second moment of all dye about its middle",
    }
    scaled: ClassVar[str] = (
        "Errors are shares of the largest root mean square of the cells' amounts (amounts, mobile and fixed dye of "
        "every cell), of all dye (mobile, fixed), or of the largest spread (spread); each is the root mean square over "
        "the frames."
    )

    @property
    def frame(self) -> float:
        """Dyeing in a frame [s]."""
        speed = self.loaded.scene.dye.speed if self.loaded.scene.dye else 1.0
        return float(speed / self.loaded.scene.frame_rate)

    @property
    def frames(self) -> int:
        return int(self.loaded.scene.frames)

    @cached_property
    def start(self) -> DyeRun:
        """The scene at its start, whatever its own solver is."""
        plugin = registry.load(self.group, SCHEME)
        return self.begin(plugin, plugin.Config(), 1)

    @cached_property
    def size(self) -> float:
        """Diagonal of the cloth [m]."""
        cells = self.start.cells
        return float(cells.size * math.hypot(*cells.fibre.shape[1:]))

    @property
    def preset(self) -> tuple[str, Mapping[str, Any]]:
        """The scene's own solver, and its configuration."""
        dye = self.loaded.scene.dye
        return (dye.solver.plugin, dye.solver.config) if dye else ("", {})

    def describe(self) -> str:
        """How large it is, in words."""
        return f"{self.start.cells.fibre.size:,} cells, {len(self.start.names)} of dye"

    def limit(self, plugin: Any, config: BaseModel) -> StepLimit:
        """A solver's limit; dye does not swing. Raises BadInput where it refuses the scene."""
        return StepLimit(float(plugin.limit(config, self.start.system)), 0.0, 0.0)

    def own_steps(self, limit: StepLimit) -> int:
        """Steps a frame that the scene itself says, of its own solver. Raises BadInput where it says one too long."""
        return DyeRun(self.loaded, self.threads).steps

    def begin(self, plugin: Any, config: BaseModel, steps: int) -> DyeRun:
        """The scene at its start, to be run by a solver with so many steps a frame. Raises BadInput."""
        chosen = self.loaded.dye
        if chosen is None:
            raise BadInput("the scene has no dye", self.loaded.file)
        solver = Chosen(self.group, plugin, config, "dye.solver", {})
        return DyeRun(replace(self.loaded, dye=replace(chosen, solver=solver)), self.threads, steps)

    def run(self, plugin: Any, config: BaseModel, steps: int, most_seconds: float = math.inf) -> Run:
        """Run the scene by one solver with `steps` steps a frame. Raises BadInput where it refuses them."""
        dyeing = self.begin(plugin, config, steps)
        rows = [self._observe(dyeing.state)]

        def advance(frame: int) -> tuple[DyeReport, float]:
            found = dyeing.advance()
            return found.report, found.seconds

        ended = advance_all(self, advance, lambda report: rows.append(self._observe(dyeing.state)), most_seconds)
        return Run(self._series(rows), *ended)

    def first_call(self, plugin: Any, config: BaseModel, steps: int, taken: int) -> tuple[float, float]:
        """Seconds that a solver's first call takes, then `taken` of its steps. Raises BadInput where it refuses."""
        begin = time.perf_counter()
        dyeing = self.begin(plugin, config, steps)
        moments, state = [begin, time.perf_counter()], dyeing.state
        with np.errstate(all="ignore"):
            for count in (1, taken):
                plugin.advance(dyeing.system, state, dyeing.memory, count, dyeing.dt)
                moments.append(time.perf_counter())
        return moments[2] - moments[0], moments[3] - moments[2]

    def scales(self, reference: Series) -> dict[str, float]:
        """What errors are divided by: the largest root mean square of the amounts, all dye, the largest spread."""
        amounts = float(np.sqrt((reference.x**2).sum(axis=2).mean(axis=1)).max()) or 1.0
        total = float((reference.values["mobile"] + reference.values["fixed"]).max()) or 1.0
        spread = float(reference.values["spread"].max()) or 1.0
        return {AMOUNTS: amounts, "mobile": total, "fixed": total, "spread": spread}

    def _observe(self, state: DyeState) -> tuple[Float, Float, Float, Float]:
        """Amounts (dyes * cells, 2), and by dye: mobile, fixed, spread [m]."""
        total = (state.phi + state.fixed).sum(axis=1)
        moments = [_spread(one) * self.start.cells.size for one in total]
        amounts = np.stack([state.phi.reshape(-1), state.fixed.reshape(-1)], axis=1)
        mobile, fixed = (values.reshape(len(moments), -1).sum(axis=1) for values in (state.phi, state.fixed))
        return amounts, mobile, fixed, np.array(moments)

    def _series(self, rows: list[tuple[Float, Float, Float, Float]]) -> Series:
        x, mobile, fixed, spread = (np.array(column) for column in zip(*rows, strict=True))
        values = {"mobile": mobile, "fixed": fixed, "spread": spread}
        t = self.frame * np.arange(len(rows))
        return Series(t.astype(np.float64), x, values, np.zeros((len(rows), 0)), AMOUNTS)


def make_dye_problem(loaded: Loaded, threads: int = 0) -> DyeProblem:
    """Raises BadInput for a scene without dye, or too large to keep."""
    problem = DyeProblem(loaded, threads or cores())
    check_memory(loaded, 2 * problem.start.state.phi.size)
    return problem


def _spread(amounts: Float) -> float:
    """Root mean square distance [cells] of amounts (ny, nx) from their middle; 0 of none."""
    total = float(amounts.sum())
    if not total > 0.0:
        return 0.0
    square = 0.0
    for axis in (0, 1):
        along = amounts.sum(axis=1 - axis)
        place = np.arange(len(along), dtype=np.float64)
        middle = float(along @ place) / total
        square += float(along @ (place - middle) ** 2) / total
    return math.sqrt(max(0.0, square))


AnyProblem = Problem | DyeProblem


def pose(loaded: Loaded, threads: int = 0) -> AnyProblem:
    """A scene as a problem for solvers: dye where nothing moves, else cloth. Raises BadInput.

    `threads` (0: all cores) step it, to the same bits.
    """
    return make_dye_problem(loaded, threads) if loaded.solver is None else make_problem(loaded, threads)
