"""Fits of stockings: seconds from a scene to its knit at rest on a leg, without recording it."""

from __future__ import annotations

import time
from typing import NamedTuple

from nuno.collision.bodies import build_bodies
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.report.result import Result
from nuno_bench.speed.timing import watch_compiler

CASE = "fit"
BARS = {"stocking-150": 15.0, "stocking-300": 90.0}
"""Seconds, on two cores."""
COARSE = 48
"""Vertices round a leg of about a quarter of the triangles of the one that scenes have."""
MOST = 3
"""Samples: fits take long, and always the same steps."""


class Fit(NamedTuple):
    """Seconds until it could be stepped, and of the steps; how many steps, and triangles of the leg."""

    prepared: float
    stepped: float
    steps: int
    triangles: int


def fit(name: str, *overrides: str, frames: int | None = None) -> Fit:
    """From reading the scene to rest, or for so many frames. Raises RuntimeError for one that does not come to rest."""
    began = time.perf_counter()
    loaded = scene_file.read(scene_file.find(f"knit/{name}"), overrides)
    bodies = build_bodies(loaded)
    poses = bodies.poses(0.0)
    simulation = Simulation(loaded, bodies.geometry, poses, 0)
    start = time.perf_counter()
    while not simulation.finished and simulation.frame != frames:
        simulation.advance(poses, poses)
    taken = time.perf_counter() - start
    if frames is None and not simulation.balanced:
        raise RuntimeError(f"{name} did not come to rest in {simulation.t:g} s")
    steps = simulation.frame * (simulation.steps or 0)
    return Fit(start - began, taken, steps, len(bodies.geometry.faces))


def fits(repeats: int) -> list[Result]:
    """Both stockings on the leg that scenes have, of over 50,000 triangles, and on a coarser one."""
    results = []
    for name, bar in BARS.items():
        for around in (COARSE, None):
            other = () if around is None else (f"bodies.leg.collider.resolution={around}",)
            with watch_compiler() as compiler:
                first = fit(name, *other, frames=1)
            found = [fit(name, *other) for _ in range(min(repeats, MOST))]
            one = found[0]
            note = (
                f"{one.steps:,} steps; of the first sample {one.prepared:.3g} s before the first of them; "
                f"{compiler.number} functions compiled"
            )
            taken = tuple(each.prepared + each.stepped for each in found)
            what = f"{name}, {one.triangles:,} triangles"
            results.append(Result(CASE, what, "s", taken, bar, None, True, first.prepared + first.stepped, None, note))
    return results
