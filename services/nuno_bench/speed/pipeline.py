"""Cases that compare whole runs with the kernels alone, and recordings with what they hold."""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from nuno.collision.bodies import build_bodies
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno.service import Options
from nuno.simulation.run import Simulation
from nuno.supervision.supervisor import Outcome, supervise
from nuno_bench.machine import cores
from nuno_bench.report.result import Result
from nuno_bench.speed.timing import alternate
from nuno_schemas.errors import RunFailed

SKIRT = ("objects.0.model.columns=128", "objects.0.model.rows=96", "frame_rate=60 Hz", "solver.dt=auto")
DURATION = 2.0
"""Simulated seconds of a run."""
MOST = 5
"""Pairs of runs at most: each takes a minute on two cores."""
SOFT = "objects.0.model.fabric={density: 0.3, structural: 8}"
"""Cloth whose few steps a frame let a recording of any size be made quickly."""
FRAME_BYTES, CHECKPOINT_BYTES = 12, 48
"""Positions in float32; positions and velocities in float64 [bytes a vertex]."""


def pipeline(repeats: int) -> list[Result]:
    """A skirt on the dancer, run as services and by the kernels alone, in turns."""
    loaded = scene_file.read(
        scene_file.find("skirt-hula"), (*SKIRT, f"duration={DURATION}", "record.checkpoint_every=1 s")
    )
    _apart(lambda: bare_seconds(loaded, frames=1))
    times: dict[str, list[float]] = {"run": [], "whole": []}

    def whole() -> float:
        for name, value in run_seconds(loaded).items():
            times[name].append(value)
        return times["run"][-1]

    bare, _ = alternate(lambda: _apart(lambda: bare_seconds(loaded)), whole, min(repeats, MOST))
    what = f"128x96 skirt, {DURATION:g} s at 60 frames/s: "
    ratios = {
        name: tuple(100.0 * (b / a - 1.0) for a, b in zip(bare, values, strict=True)) for name, values in times.items()
    }
    note = "bus, recorder and --save against the same integrator calls"
    return [
        Result("pipeline", what + "kernels alone", "s", tuple(bare)),
        Result(
            "pipeline",
            what + "frames through all services",
            "% longer",
            ratios["run"],
            bar=10.0,
            at_most=True,
            note=note,
        ),
        Result(
            "pipeline",
            what + "until both files are closed",
            "% longer",
            ratios["whole"],
            bar=10.0,
            at_most=True,
            note=note,
        ),
    ]


def _apart(work: Callable[[], float]) -> float:
    """The result of `work` in a thread that ends with it, as a run's own does.

    OpenMP keeps helpers for every thread that has run a kernel; with those of two there are more threads
    than cores, and it no longer lets any of them wait awake.
    """
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(work).result()


def bare_seconds(loaded: Loaded, frames: int | None = None) -> float:
    """Wall time of a scene's integrator calls, bodies posed beforehand, everything compiled and prepared."""
    bodies = build_bodies(loaded)
    frames = loaded.scene.frames if frames is None else frames
    poses = [bodies.poses(i / loaded.scene.frame_rate) for i in range(frames + 1)]
    simulation = Simulation(loaded, bodies.geometry, poses[0], cores())
    simulation.measure(poses[0])
    plugin, config_steps, dt = loaded.integrator.plugin, simulation.steps, simulation.dt
    start = time.perf_counter()
    for before, after in itertools.pairwise(poses):
        report = plugin.advance(
            simulation.system, simulation.state, simulation.memory, (before, after), config_steps, dt
        )
        if report.status != "ok":
            raise RunFailed(f"{report.status}: {report.message}")
    return time.perf_counter() - start


def run_seconds(loaded: Loaded) -> dict[str, float]:
    """Wall time from the first frame to the last ("run"), and until everything is written ("whole")."""
    with tempfile.TemporaryDirectory() as folder:
        options = Options(record=Path(folder) / "run.mcap", save=Path(folder) / "run.rrd", threads=cores())
        start = time.perf_counter()
        outcome = _done(supervise(loaded, options))
        total = time.perf_counter() - start
    return {"run": outcome.seconds["run"], "whole": total - outcome.seconds["prepare"]}


def _done(outcome: Outcome) -> Outcome:
    if outcome.state != "done":
        raise RunFailed(f"{outcome.state}: {outcome.error}")
    return outcome


def recording(repeats: int) -> list[Result]:
    """What a frame and a checkpoint add to a recording, from the sizes of three recordings."""
    del repeats
    results = []
    for side in (32, 128):
        size = [f"objects.0.model.resolution=[{side}, {side}]", SOFT]
        short, long, full = (
            recorded_bytes([*size, *more])
            for more in (["duration=0.2"], ["duration=0.4"], ["duration=0.4", "record.checkpoint_every=20 ms"])
        )
        vertices, frames = side * side, 10
        frame = (long - short) / frames
        # The last state is kept in any case, so 20 frames have 19 further checkpoints.
        checkpoint = (full - long) / 19 / vertices
        over = 100.0 * (frame / (FRAME_BYTES * vertices) - 1.0)
        note = f"{frame:,.0f} bytes a frame of {vertices:,} vertices, status and events included"
        results += [
            Result(
                "recording",
                f"{side}x{side}: a frame over its positions",
                "%",
                (over,),
                bar=5.0,
                at_most=True,
                note=note,
            ),
            Result(
                "recording",
                f"{side}x{side}: a checkpoint",
                "bytes a vertex",
                (checkpoint,),
                bar=CHECKPOINT_BYTES * 1.05,
                at_most=True,
                note="48 are the state itself; 5 % are left for the headers",
            ),
        ]
    return results


def recorded_bytes(overrides: list[str]) -> int:
    """Size of a recording of hanging-sheet at 50 frames/s."""
    loaded = scene_file.read(scene_file.find("hanging-sheet"), ["frame_rate=50 Hz", *overrides])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        _done(supervise(loaded, Options(record=path, threads=cores())))
        return path.stat().st_size
