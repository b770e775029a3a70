"""Fits of stockings: seconds from a scene to its knit at rest on a leg, without recording it."""

from __future__ import annotations

import time

from nuno.collision.bodies import build_bodies
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.report.result import Result
from nuno_bench.speed.timing import watch_compiler

BARS = {"stocking-150": 15.0, "stocking-300": 90.0}
"""Seconds, on two cores."""
LEGS = {"13,728": ("bodies.leg.collider.resolution=48",), "51,840": ()}
"""Triangles of a coarse leg, and of the one that scenes have."""
MOST = 3
"""Samples: fits take long, and always the same steps."""


def fit(name: str, *overrides: str, frames: int | None = None) -> tuple[float, int]:
    """Seconds from reading the scene to rest, or for so many frames, and steps. Raises RuntimeError without rest."""
    began = time.perf_counter()
    loaded = scene_file.read(shipped.find(f"knit/{name}"), overrides)
    bodies = build_bodies(loaded)
    poses = bodies.poses(0.0)
    simulation = Simulation(loaded, bodies.geometry, poses, 0)
    while not simulation.finished and simulation.frame != frames:
        simulation.advance(poses, poses)
    if frames is None and not simulation.balanced:
        raise RuntimeError(f"{name} did not come to rest in {simulation.t:g} s")
    return time.perf_counter() - began, simulation.frame * (simulation.steps or 0)


def fits(repeats: int) -> list[Result]:
    """Both stockings on the leg that scenes have, of over 50,000 triangles, and on a coarser one."""
    results = []
    for name, bar in BARS.items():
        for triangles, leg in LEGS.items():
            with watch_compiler() as compiler:
                first, _ = fit(name, *leg, frames=1)
            taken, steps = zip(*(fit(name, *leg) for _ in range(min(repeats, MOST))), strict=True)
            note = f"{steps[0]:,} steps; {compiler.number} functions compiled"
            what = f"{name}, {triangles} triangles"
            results.append(Result("fit", what, "s", taken, bar=bar, at_most=True, compile_seconds=first, note=note))
    return results
