"""Cases measured on whole processes: time to the first step, and memory."""

from __future__ import annotations

import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from nuno_bench.report.result import Result
from nuno_bench.speed.steps import meshes
from nuno_bench.speed.steps.explicit import sheet
from nuno_schemas.errors import RunFailed

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


def nuno(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "nuno", *arguments]


def start(repeats: int) -> list[Result]:
    """Process start to the first step of `hanging-sheet --no-view`, with compiled kernels and without."""
    first_step({})  # fills the cache where this machine never ran it
    warm = tuple(first_step({}) for _ in range(repeats))
    cold = []
    for _ in range(min(repeats, 3)):
        with tempfile.TemporaryDirectory() as cache:
            cold.append(first_step({"XDG_CACHE_HOME": cache}))
    what = "hanging-sheet --no-view, first step"
    return [
        Result("start", f"{what}, warm cache", "s", warm, bar=1.5, at_most=True),
        Result(
            "start",
            f"{what}, empty cache",
            "s",
            tuple(cold),
            bar=10.0,
            at_most=True,
            note="compiles everything; Python's own .pyc files are there",
        ),
    ]


def first_step(environment: dict[str, str]) -> float:
    """Seconds until the progress of a run of one frame shows that frame. Raises RunFailed."""
    with tempfile.TemporaryDirectory() as folder:
        command = nuno(
            "run", "hanging-sheet", "--no-view", "--record", f"{folder}/start.mcap", "--set", f"duration={FRAME}"
        )
        began = time.perf_counter()
        child = subprocess.Popen(
            command, env=os.environ | environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        assert child.stderr is not None
        seen, told = 0.0, []
        for line in child.stderr:
            told.append(line)
            match = STEPPED.match(line)
            if match and float(match[1]) > 0.0 and not seen:
                seen = time.perf_counter() - began
        if child.wait(PATIENCE) != 0 or not seen:
            raise RunFailed(f"{' '.join(command[1:])} showed no step: {''.join(told[-3:])}")
    return seen


def memory(repeats: int) -> list[Result]:
    """Bytes a vertex by which the peak grows from 256^2 to 512^2, in a recorded run of one frame."""
    del repeats
    scenes: list[tuple[str, float, dict[str, Any]]] = [
        ("grid, preset fabric (springs and hinges)", 400.0, {"fabric": "denim"}),
        ("grid, 12 springs a vertex", 400.0, {"damping": meshes.DAMPING}),
    ]
    results = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for what, bar, options in scenes:
            peaks = [peak_bytes(meshes.sheet_scene(side, side, **options), folder) for side in SIDES]
            results.append(_slope(what, bar, peaks))
        peaks = []
        for side in SIDES:
            np.savez(folder / "net.npz", allow_pickle=False, **meshes.net_arrays(sheet(side, side), varied=True))
            peaks.append(peak_bytes(meshes.scene_of({"plugin": "net", "file": "net.npz"}), folder))
        results.append(_slope("net, 12 springs a vertex, constants per spring", 700.0, peaks))
    return results


def _slope(what: str, bar: float, peaks: list[int]) -> Result:
    low, high = (side * side for side in SIDES)
    megabytes = " and ".join(f"{peak / 1e6:.0f} MB" for peak in peaks)
    return Result(
        "memory",
        what,
        "bytes a vertex",
        ((peaks[1] - peaks[0]) / (high - low),),
        bar=bar,
        at_most=True,
        note=f"peaks {megabytes}",
    )


def peak_bytes(scene: dict[str, Any], folder: Path) -> int:
    """Peak resident size of a recorded run: median of three. Raises RunFailed."""
    path = folder / "scene.yaml"
    path.write_text(json.dumps(scene))  # JSON is YAML
    return round(statistics.median(_peak(path) for _ in range(3)))


def _peak(path: Path) -> int:
    target = path.with_name("run.mcap")
    command = [sys.executable, "-S", "-c", LAUNCHER, *nuno("run", str(path), "--no-view", "--record", str(target))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    target.unlink(missing_ok=True)
    size, _, code = done.stdout.partition(" ")
    if done.returncode != 0 or int(code) != 0:
        raise RunFailed(f"the run for its memory ended with exit code {code.strip() or '?'}: {done.stderr[-300:]}")
    unit = 1 if sys.platform == "darwin" else 1024
    return int(size) * unit
