"""Our own solvers, on the skirt."""

from __future__ import annotations

import time

from nuno_bench.peers.contact import ours
from nuno_bench.peers.contact.problem import RATE
from nuno_bench.peers.process import Point
from nuno_bench.peers.skirt.problem import OVERRIDES, SCENE, Seen, Skirt, look

CONVERGED, FINE = ("leapfrog", "symplectic_euler"), 1280
"""What the converged run and its check are stepped by, and how often a frame: about twelve times as often as must be."""


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


def converge(skirt: Skirt, seconds: float) -> list[Point[Seen]]:
    """The converged run, and one by another method that checks it: what the two are apart is what errors mean little
    below. Raises RuntimeError where one breaks down.
    """
    found: list[Point[Seen]] = []
    for name, solver in zip(("converged", "check"), CONVERGED, strict=True):
        engine, begin = Solver(skirt, f"plugin: {solver}, dt: {1.0 / RATE / FINE!r}"), time.perf_counter()
        frames = engine.advance(seconds)
        taken = time.perf_counter() - begin
        score = look(skirt, frames, found[0].score.frames if found and found[0].score else frames)
        found.append(Point(name, f"{solver}, {FINE:,} a frame", seconds=(taken,), score=score))
    return found
