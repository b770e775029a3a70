"""Whole runs: time to the first step, memory, and services with everything written against the kernels alone."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import nuno
from nuno.python_api.active_run import Heard
from nuno.runtime import runs, supervisor
from nuno.runtime.outcome import Outcome
from nuno.runtime.service import Options
from nuno.runtime.supervisor import Deployment, supervise
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno.simulation.solver_selection.cloth import decide
from nuno_bench.machine import cores
from nuno_bench.problem import run_own
from nuno_bench.report.page import Result
from nuno_bench.speed.steps import DAMPING, net_arrays, scene_of, sheet, sheet_scene
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import BODIES, STATE

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


# Poses from another process into a skirt that swings by the clock: what is lost on the way, and how old it is then.

RATE, SECONDS, BODY = 100.0, 4.0, "hips"
"""Poses and frames a second; how long they are sent; whom."""
MOST_WAIT = 3
"""Runs at most."""
FINISH_PATIENCE = 120.0
"""Longest that a run is waited for before it stands still at its first frame [s]: it may compile."""
SWING = 0.1
"""Amplitude of the hips' motion [m]."""


def live(repeats: int) -> list[Result]:
    """A skirt of 3,072 vertices on hips that another process moves a hundred times a second."""
    found = [measure() for _ in range(min(repeats, MOST_WAIT))]
    what = "3,072-vertex skirt, poses at 100 Hz on loopback: "

    def of(name: str) -> tuple[float, ...]:
        return tuple(one[name] for one in found)

    note = "from sending poses to receiving the first state that they are in, frames of 10 ms"
    return [
        Result("live", what + "poses that did not come", "poses", of("lost"), bar=0.0, at_most=True),
        Result("live", what + "frames that did not come", "frames", of("missing"), bar=0.0, at_most=True),
        Result("live", what + "frames that were late", "frames", of("late")),
        Result("live", what + "age, median", "frames", of("median"), bar=2.0, at_most=True, note=note),
        Result("live", what + "age, 99 of 100", "frames", of("most"), bar=2.0, at_most=True, note=note),
    ]


def measure() -> dict[str, float]:
    """Measure one run. Raises RunFailed if it does not reach its end."""
    with (
        tempfile.TemporaryDirectory() as folder, _standing(Path(folder)) as (run, endpoint, outcome),
        ThreadPoolExecutor(1) as thread, ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as sender,
        nuno.watch(run, STATE.name, BODIES.name) as messages,
    ):  # fmt: skip
        arrivals = thread.submit(_arrivals, messages)
        sent = np.array(sender.submit(send_poses, run, endpoint).result())
        ended = outcome()
        first, missing = arrivals.result()
    if ended.state != "done":
        raise RunFailed(f"{ended.state}: {ended.error}")
    followed = ended.services["collision"]["followed"][BODY]
    ages = [(at - sent[number]) * RATE for number, at in first.items()]
    return {
        "lost": float(len(sent) - followed["heard"]),
        "missing": float(missing),
        "late": float(ended.summary["clock"]["late"]),
        "median": float(np.median(ages)),
        "most": float(np.percentile(ages, 99)),
    }


def send_poses(run: str, endpoint: str) -> list[float]:
    """Let a run go on, and send it poses whose heights encode their numbers; return when they were sent [s]."""
    with nuno.drive(run, BODY, connect=endpoint) as body:
        body.send((0.0, 0.0, 0.0))
        supervisor.control(run, endpoint, {"action": "resume"})
        start, sent = time.monotonic(), [time.monotonic()]
        for number in range(1, round(SECONDS * RATE)):
            due = start + number / RATE
            time.sleep(max(0.0, due - time.monotonic()))
            sent.append(time.monotonic())
            body.send((SWING * np.sin(2.0 * np.pi * number / RATE), height_of(number), 0.0))
        return sent


def height_of(number: int) -> float:
    """By how much the hips are raised with the pose of a number [m]: too little to be seen, and exact to the bit."""
    return 1e-6 * number


def _arrivals(messages: Iterable[Heard]) -> tuple[dict[int, float], int]:
    """Return when the first state that follows each pose arrived [s], by the pose's number, and how many states did not
    come. Ends with the run.
    """
    arrived, followed, missing = dict[int, float](), dict[int, int](), 0
    for heard in messages:
        if heard.topic == STATE.name:
            arrived[heard.frame] = time.monotonic()
            missing += heard.skipped
        else:
            followed[heard.frame] = round(heard.value[0]["translation"][0, 1] / height_of(1))
    first = {followed[frame]: at for frame, at in reversed(arrived.items()) if followed.get(frame, 0) > 0}
    return first, missing


@contextmanager
def _standing(folder: Path) -> Iterator[tuple[str, str, Callable[[], Outcome]]]:
    """A run that stands at its first frame: its id, its endpoint, and what waits for how it ends."""
    skirt = {
        "plugin": "skirt", "waist_radius": "13 cm", "hem_radius": "22 cm", "length": "45 cm", "columns": 96, "rows": 32,
        "attach": {"body": BODY, "frame": "body"}, "fabric": "denim",
    }  # fmt: skip
    scene = {
        "nuno": 1, "name": "live", "duration": SECONDS, "frame_rate": RATE, "damping": 1.0, "accuracy": "preview",
        "objects": [{"name": "skirt", "model": skirt}],
        "bodies": [{
            "name": BODY, "motion": {"plugin": "topic"},
            "collider": {"plugin": "capsule", "a": [0, -0.1, 0], "b": [0, 0.1, 0], "radius": "12 cm"},
        }],
    }  # fmt: skip
    path = folder / "live.yaml"
    path.write_text(yaml.safe_dump(scene))
    loaded, run = decide(scene_file.read(path)), runs.new_id("live")
    ended: list[Outcome] = []
    options = Options(threads=cores())

    def go() -> None:
        ended.append(supervisor.supervise(loaded, options, Deployment(run=run, paused=True)))

    thread = threading.Thread(target=go, daemon=True)
    thread.start()
    end = time.monotonic() + FINISH_PATIENCE
    while run not in runs.running() or not _stands(run):
        if time.monotonic() > end or not thread.is_alive():
            raise RunFailed("the run did not come to its first frame")
        time.sleep(0.05)

    def outcome() -> Outcome:
        thread.join()
        return ended[0]

    yield run, runs.running()[run], outcome


def _stands(run: str) -> bool:
    try:
        return bool(supervisor.control(run, runs.running()[run], {"action": "status"})["state"] == "paused")
    except (RunFailed, KeyError):
        return False
