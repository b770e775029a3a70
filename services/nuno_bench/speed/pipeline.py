"""Whole runs, as services with everything written, against the kernels alone."""

from __future__ import annotations

import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno.service import Options
from nuno.supervision.supervisor import supervise
from nuno_bench.machine import cores
from nuno_bench.problem.observe import run_own
from nuno_bench.report.result import Result
from nuno_schemas.errors import RunFailed

DURATION = 2.0
"""Simulated seconds of a run."""
SKIRT = ("objects.0.model.columns=128", "objects.0.model.rows=96", "frame_rate=60 Hz", "solver.dt=auto",
         f"duration={DURATION}", "record.checkpoint_every=1 s")  # fmt: skip
MOST = 5
"""Pairs of runs at most: each takes a minute on two cores."""


def pipeline(repeats: int) -> list[Result]:
    """A skirt on the dancer, run as services and by the kernels alone, in turns, so that a slow machine slows both."""
    loaded = scene_file.read(shipped.find("skirt-hula"), SKIRT)
    bare_seconds(scene_file.read(shipped.find("skirt-hula"), (*SKIRT, "duration=0.05")))
    pairs = [(bare_seconds(loaded), *run_seconds(loaded)) for _ in range(min(repeats, MOST))]
    bare, run, whole = zip(*pairs, strict=True)
    what = f"128x96 skirt, {DURATION:g} s at 60 frames/s: "
    note = "bus, recorder and --save against the same integrator calls"
    results = [Result("pipeline", what + "kernels alone", "s", bare)]
    for name, times in (("frames through all services", run), ("until both files are closed", whole)):
        longer = tuple(100.0 * (b / a - 1.0) for a, b in zip(bare, times, strict=True))
        results.append(Result("pipeline", what + name, "% longer", longer, bar=10.0, at_most=True, note=note))
    return results


def bare_seconds(loaded: Loaded) -> float:
    """Wall time of a scene's integrator calls, bodies posed beforehand, everything compiled and prepared.

    In a thread that ends with it, as a run's own does: OpenMP keeps helpers for every thread that has run a kernel;
    with those of two there are more threads than cores, and it no longer lets any of them wait awake.
    """
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(run_own, loaded).result().seconds


def run_seconds(loaded: Loaded) -> tuple[float, float]:
    """Wall time from the first frame to the last, and until everything is written."""
    with tempfile.TemporaryDirectory() as folder:
        options = Options(record=Path(folder) / "run.mcap", save=Path(folder) / "run.rrd", threads=cores())
        start = time.perf_counter()
        outcome = supervise(loaded, options)
        total = time.perf_counter() - start
    if outcome.state != "done":
        raise RunFailed(f"{outcome.state}: {outcome.error}")
    return outcome.seconds["run"], total - outcome.seconds["prepare"]
