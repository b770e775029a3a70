"""What the explicit integrators of a fixed step share: one compiled loop over an interval's steps."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel

from nuno_integrators.compiled import Compiled, Told, Work, source_of
from nuno_kernels.step.acceleration import Extra, Packed
from nuno_schemas.plugin import Config
from nuno_schemas.system import System


class NoConfig(Config):
    """An explicit integrator has nothing to configure but its step."""


class Explicit(Compiled):
    """An integrator whose `loop(x, v, stages, steps, dt, packed, extra)` is compiled."""

    Config: ClassVar[type[BaseModel]] = NoConfig
    explicit: ClassVar[bool] = True
    buffers: ClassVar[int]
    loop: ClassVar[Any]

    def make_work(self, config: BaseModel, system: System, packed: Packed) -> Work:
        n = system.fabric.number
        return Work(packed, np.empty((3, n)), np.empty((3, n)), np.empty((self.buffers, 3, n)))

    def loop_for(self, packed: Packed) -> Any:
        """The loop for a system."""
        return type(self).loop

    def go(self, work: Work, packed: Packed, extra: Extra, steps: int, dt: float) -> Told:
        source_of(self.loop_for(packed), extra)(work.x, work.v, work.stages, steps, dt, packed, extra)
        return Told(steps)

    def compile(self, work: Work, packed: Packed, extra: Extra) -> None:
        self.go(work, packed, extra, 0, 0.0)

    def step_at_rest(self, work: Work, extra: Extra) -> Any:
        return source_of(self.loop_for(work.packed), extra)
