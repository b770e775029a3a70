"""Our own solvers with cloth contact, on the pile; other scenes with it derive from this."""

from __future__ import annotations

import numpy as np

from nuno_bench.peers.contact.problem import OVERRIDES, SCENE
from nuno_bench.peers.python import Nuno
from nuno_schemas.fabric import Float


class Solver(Nuno):
    """`solver` as a scene has it; steps without services."""

    scene, overrides = SCENE, OVERRIDES

    def __init__(self, posed: object, solver: str) -> None:
        super().__init__(posed, solver, overrides=self.overrides)

    def advance(self, seconds: float) -> Float:
        frames = np.array([x.copy() for x in self.frames(seconds)])
        cut, steps = self.simulation.present().report.counts["cut_short"], self.simulation.steps
        self.remark = f"{cut:,} of {steps * frames[..., 0].size:,} steps of vertices cut short"
        return frames
