"""Explicit integrators of a fixed step: one compiled loop over an interval's steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel

from nuno_integrators.compiled import Compiled, StepResult, Work, source_of
from nuno_kernels.step.acceleration import Extra, Packed
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config
from nuno_schemas.system import System

SPARE = 4
"""Unused buffers behind a loop's own. Compiled code does not check bounds: a loop that uses more buffers than it
declares would write into foreign memory."""


@dataclass
class GuardedWork(Work):
    """`spare` (SPARE, 3, n) lies behind `stages`, and is NaN at the first vertex as long as no loop has written there.

    The first vertex alone: a buffer is written whole, and the memory of the others is never touched.
    """

    spare: Float


class NoConfig(Config):
    """No configuration: the step is the scene's."""


class Explicit(Compiled):
    """An integrator whose `loop(x, v, stages, steps, dt, packed, extra)` is compiled.

    buffers  arrays (3, n) of float64 that the loop has in `stages`, from number 0 to buffers - 1
    """

    Config: ClassVar[type[BaseModel]] = NoConfig
    explicit: ClassVar[bool] = True
    buffers: ClassVar[int]
    loop: ClassVar[Any]

    def make_work(self, config: BaseModel, system: System, packed: Packed) -> GuardedWork:
        n = system.fabric.number
        room = np.empty((self.buffers + SPARE, 3, n))
        stages, spare = room[: self.buffers], room[self.buffers :]
        spare[:, :, :1] = np.nan
        return GuardedWork(packed, np.empty((3, n)), np.empty((3, n)), stages, spare)

    def loop_for(self, packed: Packed) -> Any:
        """Return the loop for a system."""
        return type(self).loop

    def go(self, work: GuardedWork, packed: Packed, extra: Extra, steps: int, dt: float) -> StepResult:
        """Raise RunFailed if the loop has written behind its buffers."""
        source_of(self.loop_for(packed), extra)(work.x, work.v, work.stages, steps, dt, packed, extra)
        written = np.flatnonzero(~np.isnan(work.spare[:, :, :1]).all(axis=(1, 2)))
        if written.size:
            last = self.buffers + int(written[-1])
            raise RunFailed(
                f"the solver {self.name!r} writes into stages[{last}], and its buffers = {self.buffers} end at "
                f"stages[{self.buffers - 1}]: give its class buffers = {last + 1}"
            )
        return StepResult(steps)

    def compile(self, work: GuardedWork, packed: Packed, extra: Extra) -> None:
        self.go(work, packed, extra, 0, 0.0)

    def step_at_rest(self, work: Work, extra: Extra) -> Any:
        return source_of(self.loop_for(work.packed), extra)
