"""Our own solvers, on the skirt."""

from __future__ import annotations

import time

from nuno_bench.peers.contact import ours
from nuno_bench.peers.problem import RATE
from nuno_bench.peers.process import Point
from nuno_bench.peers.skirt.problem import OVERRIDES, SCENE, Seen, Skirt, look
from nuno_schemas.fabric import Float

CONVERGED, FINE = "leapfrog", (640, 320)
"""What the converged run and its check are stepped by, and how often a frame: the explicit limit is near 100."""


class Solver(ours.Solver):
    """`solver` as a scene has it; steps without services, from where and how the skirt is."""

    scene, overrides = SCENE, OVERRIDES

    def __init__(self, skirt: Skirt, solver: str) -> None:
        self.skirt = skirt
        super().__init__(skirt, solver)

    def reset(self) -> None:
        super().reset()
        self.skirt.go_on(self.simulation)
        self.simulation.present()


def converge(skirt: Skirt, seconds: float) -> tuple[Float, list[Point[Seen]]]:
    """Frames (frames, n, 3) [m] of the converged run; it, and one of half as many steps that checks it, as points.

    Errors mean little below what the two are apart. Raises RuntimeError where one breaks down.
    """
    runs, found = list[Float](), list[Point[Seen]]()
    for name, steps in zip(("converged", "check"), FINE, strict=True):
        engine, begin = Solver(skirt, f"plugin: {CONVERGED}, dt: {1.0 / RATE / steps!r}"), time.perf_counter()
        runs.append(engine.advance(seconds))
        taken = time.perf_counter() - begin
        setting = f"{CONVERGED}, {steps} steps a frame"
        found.append(Point(name, setting, seconds=(taken,), score=look(skirt, runs[-1], runs[0])))
    return runs[0], found
