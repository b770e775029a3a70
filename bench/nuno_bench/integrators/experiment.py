"""One scene run by several integrators, with split and unsplit bones, and what each run did.

The simulation is stepped directly: services would add nothing to the physics (their digests are
equal) and would blur the times.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.collision.bodies import build_bodies
from nuno.collision.distance import signed_distance
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno_bench.problem.observe import make_problem
from nuno_schemas.fabric import Float

INTEGRATORS = ("euler", "symplectic_euler", "rk4", "rk4_printed")
SPLIT = "bodies.0.collider.split"
RUNAWAY = 10.0
"""A run counts as run away once its energy has grown by this multiple of the work that lifts the
garment by its own size. Growth, and that work, are the same wherever height zero is; the energy
itself is not, so a multiple of the start would be another limit for a dancer on a stage."""
SERIES = ("t", "kinetic", "gravitational", "springs", "hinges", "energy", "penetration", "distance", "stretch")


@dataclass(frozen=True)
class Trace:
    """One run.

    series   (frames + 1,) per name of SERIES: time [s], energies [J], deepest penetration [m],
             mean distance of free vertices from the bodies [m], largest stretch (1 = twice as long)
    ended    [s] when the state stopped being finite, or None
    seconds  time of all steps, per repeat; steps taken; limit: largest stable step [s]
    lift     work that lifts the garment by its own size, the diagonal of its box at the start [J]; 0 without gravity
    """

    integrator: str
    split: bool
    series: dict[str, Float]
    ended: float | None
    message: str
    seconds: tuple[float, ...]
    steps: int
    dt: float
    limit: float
    rest_depth: float | None
    primitives: int
    lift: float

    @property
    def outcome(self) -> str:
        return "done" if self.ended is None else f"diverged at {self.ended:.2f} s"

    @property
    def runaway(self) -> float | None:
        """When the energy had first grown by RUNAWAY times the lift [s]; None if it never had.

        Without gravity a run has only run away where it is no longer finite.
        """
        energy = self.series["energy"]
        most = RUNAWAY * self.lift if self.lift > 0.0 else np.inf
        return self.first(energy - energy[0] > most)

    def first(self, happened: NDArray[np.bool_]) -> float | None:
        """Time of the first frame in which something happened, or the state was not finite [s]."""
        frames = np.flatnonzero(happened | ~np.isfinite(self.series["energy"]))
        return float(self.series["t"][frames[0]]) if frames.size else self.ended

    @property
    def rounds(self) -> tuple[float, ...]:
        """Time of a step in each repeat [us]; runs that end early take fewer steps."""
        return tuple(seconds / max(1, self.steps) * 1e6 for seconds in self.seconds)

    @property
    def microseconds(self) -> float:
        """Median time of a step [us]."""
        return statistics.median(self.rounds)

    def finite(self, name: str) -> Float:
        """The finite values of a series."""
        values = self.series[name]
        return values[np.isfinite(values)]

    def peak(self, name: str) -> float:
        """Largest finite value of a series."""
        return float(self.finite(name).max())

    @property
    def energies(self) -> tuple[float, float, float]:
        """At the start, at most, and at the end [J], of the frames in which it was finite."""
        energy = self.finite("energy")
        return float(energy[0]), float(energy.max()), float(energy[-1])

    @property
    def derived(self) -> dict[str, Any]:
        """What follows from the fields."""
        peaks = {name: self.peak(name) for name in ("penetration", "distance", "stretch")}
        found = {name: getattr(self, name) for name in ("outcome", "runaway", "microseconds", "energies")}
        return found | {"peaks": peaks}


def run_experiment(
    path: Path, overrides: Sequence[str], integrators: Sequence[str], repeats: int, say: Callable[[str], None]
) -> list[Trace]:
    """All integrators with split and unsplit bones. Raises BadInput for a scene that cannot be run.

    Repeats are taken in rounds over all variants, so that a machine that slows down slows all.
    """
    variants = [(name, split) for split in (True, False) for name in integrators]
    scenes = [
        scene_file.read(
            path, [*overrides, f"solver.plugin={name}", f"{SPLIT}={str(split).lower()}", "allow_unstable=true"]
        )
        for name, split in variants
    ]
    traces: list[Trace] = []
    for variant, loaded in zip(variants, scenes, strict=True):
        say(f"{variant[0]}, {'split' if variant[1] else 'unsplit'} bones")
        traces.append(run_variant(loaded, *variant))
    for turn in range(1, repeats):
        say(f"times, round {turn + 1} of {repeats}")
        for i, (variant, loaded) in enumerate(zip(variants, scenes, strict=True)):
            again = run_variant(loaded, *variant, measured=False)
            traces[i] = replace(traces[i], seconds=traces[i].seconds + again.seconds)
    return traces


def run_variant(loaded: Loaded, name: str, split: bool, measured: bool = True) -> Trace:
    """One run to its end, or to the frame in which it diverges; unmeasured runs are only timed."""
    problem, chosen, bodies = make_problem(loaded), loaded.integrator, build_bodies(loaded)
    limit = problem.limit(chosen.plugin, chosen.config)
    steps = problem.own_steps(limit)
    run, rows = problem.run(chosen.plugin, chosen.config, steps), list[tuple[float, ...]]()
    for t, x, report, poses in zip(run.series.t, run.series.x, run.reports, problem.poses, strict=False):
        if measured and poses is not None:
            distance = signed_distance(x, bodies.geometry, poses)
            finite = distance[np.isfinite(distance)]
            inside, mean = (max(0.0, -finite.min()), finite.mean()) if finite.size else (np.nan, np.nan)
            energy = [float(report.energy.get(kind, 0.0)) for kind in SERIES[1:5]]
            rows.append((t, *energy, sum(energy), float(inside), float(mean), report.stretch))
    depths = [term.facts["rest_depth"] for term in problem.system.terms if "rest_depth" in term.facts]
    weight = float(problem.fabric.mass.sum()) * float(np.linalg.norm(problem.system.gravity))
    return Trace(
        integrator=name,
        split=split,
        series=dict(zip(SERIES, np.array(rows).T, strict=True)) if measured else {},
        ended=None if run.status == "ok" else problem.frame * len(run.series.t),
        message=run.message,
        seconds=(run.seconds,),
        steps=run.totals["steps"],
        dt=problem.frame / steps,
        limit=limit.dt,
        rest_depth=depths[0] if depths else None,
        primitives=len(bodies.geometry.kind),
        lift=weight * problem.size,
    )
