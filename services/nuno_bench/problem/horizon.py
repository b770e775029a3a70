"""How long positions can be predicted: a twin that starts a ten-billionth of the size away.

Cloth that swings freely is chaotic: whatever disturbs it grows, rounding and a solver's error alike.
The horizon is when the twin has come LOST of the size away. A reference that is only as good as the
disturbance cannot say better than LOST where a vertex is from there on, and LOST is the coarsest
accuracy that a comparison of positions is of use for; what is left to compare beyond are observables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nuno_bench.problem.dye import AnyProblem, DyeProblem
from nuno_bench.problem.dye_reference import make_dye_reference
from nuno_bench.problem.observe import Problem, Run
from nuno_bench.problem.reference import Compared, Reference, make_reference
from nuno_schemas.fabric import Float

DISTURBANCE = 1e-10
"""Root mean square over the free vertices, as a share of the size."""
LOST = 1e-3
SEED = 20


@dataclass(frozen=True)
class Horizon:
    """Up to when positions are compared.

    frames   frames whose positions are compared, the start among them
    t        the last of them [s]
    whole    whether that is the whole run
    growth   how far the disturbance has grown by then, as a multiple of itself
    distance (f,) of the twin at every frame, as a share of the size
    fades    whether nothing that disturbs the scene can grow
    """

    frames: int
    t: float
    whole: bool
    growth: float
    distance: Float
    fades: bool = False

    def describe(self) -> str:
        if self.fades:
            return "the whole run: what disturbs diffusion fades"
        grown = f"a disturbance of {DISTURBANCE:g} of the cloth's size grows {self.growth:.3g} times"
        if self.whole:
            return f"the whole run: {grown} in {self.t:.3g} s"
        return f"{self.t:.3g} s: {grown} by then, and passes {LOST:g} of the size in the next frame"


def disturb(problem: Problem) -> Float:
    """(n, 3) displacements of the free vertices [m], at random, the same for every run."""
    moved = np.zeros((problem.fabric.number, 3))
    moved[problem.free] = np.random.default_rng(SEED).normal(size=(int(problem.free.sum()), 3))
    spread = np.sqrt((moved[problem.free] ** 2).sum(axis=1).mean())
    result: Float = moved * (DISTURBANCE * problem.size / spread)
    return result


def refer(problem: AnyProblem, budget: float, told: Callable[[str], None]) -> tuple[Compared, Horizon]:
    """The reference, each run of which may take `budget` [s], and how long it can be predicted. Raises BadInput."""
    if isinstance(problem, DyeProblem):
        of_dye = make_dye_reference(problem, budget, told)
        t = of_dye.run.series.t
        return of_dye, Horizon(len(t), float(t[-1]), True, 0.0, np.zeros(len(t)), fades=True)
    reference = make_reference(problem, budget, told)
    told("predictable time: the disturbed twin")
    return reference, find_horizon(problem, reference)


def find_horizon(problem: Problem, reference: Reference) -> Horizon:
    """Run the twin."""
    t, x = reference.run.series.t, reference.run.series.x
    twin: Run = reference.twin(disturb(problem))
    reached = len(twin.series.t)
    apart = np.sqrt(((twin.series.x - x[:reached]) ** 2).sum(axis=2).mean(axis=1)) / problem.size
    lost = np.flatnonzero(~(apart <= LOST))
    frames = int(lost[0]) if lost.size else reached
    return Horizon(frames, float(t[frames - 1]), frames == len(t), float(apart[frames - 1] / DISTURBANCE), apart)
