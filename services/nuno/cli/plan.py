"""`nuno plan`: what will run, what is left out and why, the stable step, the estimated cost."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from nuno import build
from nuno.cli.common import add_scene, load_scene
from nuno.plan import make_plan
from nuno.service import Options
from nuno.simulation.run import Simulation


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)


def main(args: argparse.Namespace) -> int:
    loaded = load_scene(args)
    scene = loaded.scene
    plan = make_plan(loaded, Options(record=Path("recordings")))
    bodies = build.build_bodies(loaded) if scene.bodies else None
    poses = bodies.poses(0.0) if bodies else None
    simulation = Simulation(loaded, bodies.geometry if bodies else None, poses, 0)
    seconds = _time_frame(simulation, bodies)
    vertices, limit = simulation.fabric.number, simulation.limit.dt
    terms = sorted({term.kind for term in simulation.system.terms})
    parts = [
        name
        for name, part in (("springs", simulation.fabric.springs), ("hinges", simulation.fabric.hinges))
        if part is not None
    ]
    checkpoints = 1 + (int(scene.duration / scene.record.checkpoint_every) if scene.record.checkpoint_every else 0)
    size = scene.frames * 12 * vertices + checkpoints * 48 * vertices
    rows = [
        ("scene", f"{scene.name}: {scene.description}"),
        ("services", ", ".join(plan.services)),
        (
            "fabric",
            f"{vertices:,} vertices, {simulation.fabric.springs.number if simulation.fabric.springs else 0:,} springs, {simulation.fabric.hinges.number if simulation.fabric.hinges else 0:,} hinges",
        ),
        ("terms", ", ".join([*parts, *terms]) or "gravity only"),
        (
            "solver",
            f"{loaded.integrator.name}, dt {simulation.dt * 1e3:.4g} ms, {simulation.steps} steps a frame; limit {limit * 1e3:.4g} ms",
        ),
        ("frames", f"{scene.frames} in {scene.frames / scene.frame_rate:g} s"),
        (
            "cost",
            f"about {seconds * scene.frames:.2g} s ({1 / scene.frame_rate / seconds:.1f}x real time, from one frame measured here), {size / 1e6:.3g} MB recorded, {vertices * build.BYTES_PER_VERTEX / 2**20:.3g} MiB of memory at most",
        ),
        *(("left out" if i == 0 else "", text) for i, text in enumerate(plan.left_out)),
    ]
    for name, text in rows:
        print(f"{name:9} {text}")
    return 0


def _time_frame(simulation: Simulation, bodies: build.Bodies | None) -> float:
    """Wall time of the second frame [s]; the first one may compile."""
    seconds = 0.0
    for frame in range(2):
        rate = simulation.loaded.scene.frame_rate
        ends = [bodies.poses((frame + i) / rate) if bodies else None for i in range(2)]
        start = time.perf_counter()
        simulation.advance(*ends)
        seconds = time.perf_counter() - start
    return max(seconds, 1e-9)
