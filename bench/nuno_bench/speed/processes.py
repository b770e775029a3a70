"""Whole runs: time to the first step, memory, and services with everything written against the kernels alone."""

from __future__ import annotations

import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from nuno.runtime.service import Options
from nuno.runtime.supervisor import supervise
from nuno.scene import files as shipped
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno_bench.machine import cores
from nuno_bench.problem import run_own
from nuno_bench.report.page import Result
from nuno_bench.speed.steps import DAMPING, net_arrays, scene_of, sheet, sheet_scene
from nuno_schemas.errors import RunFailed

NUNO = (sys.executable, "-P", "-m", "nuno", "run")
STEPPED = re.compile(r"^(\d+\.\d+) of ")
"""A line of `nuno run`'s progress where there is no terminal: simulated time first."""
PATIENCE = 120.0
FRAME = 1.0 / 60.0
SIDES = (256, 512)

# Linux hands a process's peak over to the program it turns into, so a benchmark that holds
# arrays would show up in its children. This small one stands between.
LAUNCHER = """
import os, subprocess, sys
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, used = os.wait4(child.pid, 0)
print(used.ru_maxrss, os.waitstatus_to_exitcode(status))
"""
DURATION = 2.0
"""Simulated seconds of a run."""
SKIRT = ("objects.0.model.columns=128", "objects.0.model.rows=96", "frame_rate=60 Hz", "solver.dt=auto",
         f"duration={DURATION}", "record.checkpoint_every=1 s")  # fmt: skip
MOST = 5
"""Pairs of runs at most: each takes a minute on two cores."""


def start(repeats: int) -> list[Result]:
    """Process start to the first step of `hanging-sheet --no-view`, with compiled kernels and without."""
    first_step({})  # fills the cache where this machine never ran it
    warm, cold = tuple(first_step({}) for _ in range(repeats)), []
    for _ in range(min(repeats, 3)):
        with tempfile.TemporaryDirectory() as cache:
            cold.append(first_step({"XDG_CACHE_HOME": cache}))
    what, note = "hanging-sheet --no-view, first step", "compiles everything; Python's own .pyc files are there"
    return [
        Result("start", f"{what}, warm cache", "s", warm, bar=1.5, at_most=True),
        Result("start", f"{what}, empty cache", "s", tuple(cold), bar=10.0, at_most=True, note=note),
    ]


def first_step(environment: dict[str, str]) -> float:
    """Seconds until the progress of a run of one frame shows that frame. Raises RunFailed."""
    with tempfile.TemporaryDirectory() as folder:
        options = ("--no-view", "--record", f"{folder}/start.mcap", "--set", f"duration={FRAME}")
        began, seen, lines = time.perf_counter(), 0.0, []
        child = subprocess.Popen(
            [*NUNO, "hanging-sheet", *options], env=os.environ | environment,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert child.stderr is not None
        for line in child.stderr:
            lines.append(line)
            match = STEPPED.match(line)
            if match and float(match[1]) > 0.0 and not seen:
                seen = time.perf_counter() - began
        if child.wait(PATIENCE) != 0 or not seen:
            raise RunFailed(f"hanging-sheet showed no step: {''.join(lines[-3:])}")
    return seen


def memory(repeats: int) -> list[Result]:
    """Bytes a vertex by which the peak grows from 256^2 to 512^2, in a recorded run of one frame."""
    del repeats
    results = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def net_scene(side: int) -> dict[str, Any]:
            np.savez(folder / "net.npz", allow_pickle=False, **net_arrays(sheet(side, side), varied=True))
            return scene_of({"plugin": "net", "file": "net.npz"})

        for what, bar, scene in (
            ("grid, preset fabric (springs and hinges)", 400.0, lambda side: sheet_scene(side, side, fabric="denim")),
            ("grid, 12 springs a vertex", 400.0, lambda side: sheet_scene(side, side, DAMPING)),
            ("net, 12 springs a vertex, constants per spring", 700.0, net_scene),
        ):
            low, high = (peak_bytes(scene(side), folder) for side in SIDES)
            each, note = (
                (high - low) / (SIDES[1] ** 2 - SIDES[0] ** 2),
                f"peaks {low / 1e6:.0f} and {high / 1e6:.0f} MB",
            )
            results.append(Result("memory", what, "bytes a vertex", (each,), bar=bar, at_most=True, note=note))
    return results


def peak_bytes(scene: dict[str, Any], folder: Path) -> int:
    """Peak resident size of a recorded run: median of three. Raises RunFailed."""
    path, target = folder / "scene.yaml", folder / "run.mcap"
    path.write_text(json.dumps(scene))  # JSON is YAML
    command = [sys.executable, "-S", "-c", LAUNCHER, *NUNO, str(path), "--no-view", "--record", str(target)]
    peaks = []
    for _ in range(3):
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
        target.unlink(missing_ok=True)
        size, _, code = done.stdout.partition(" ")
        if done.returncode != 0 or int(code) != 0:
            raise RunFailed(f"the run for its memory ended with exit code {code.strip() or '?'}: {done.stderr[-300:]}")
        peaks.append(int(size) * (1 if sys.platform == "darwin" else 1024))
    return round(statistics.median(peaks))


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
