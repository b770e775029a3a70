"""`nuno doctor`: whether this machine has what nuno needs and what it can use."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import psutil

from nuno.bus.sessions import hub_at
from nuno.formatting import data_size
from nuno.scene import scene_file, shipped
from nuno.scene.provenance import processor
from nuno.simulation.run import Simulation
from nuno.viewer.live import has_screen
from nuno_schemas.errors import BadInput

LEAST_MEMORY = 2**29
"""Memory of a run of a small scene, including the compilation of its kernels [bytes]."""
LEAST_DISK = 2**28
PROBE = 2**24
"""Bytes that are written to measure the speed of the disk."""


@dataclass(frozen=True)
class Row:
    """One line; the verdict is ok, note (an optional feature is missing) or failed (no run would work)."""

    name: str
    verdict: str
    text: str
    remedy: str = ""


def doctor_arguments(parser: argparse.ArgumentParser) -> None:
    del parser


def doctor_command(args: argparse.Namespace) -> int:
    """Print a line for each check; return 1 if no run would work."""
    del args
    checks = (_machine, _memory, _kernels, _bus, _rerun, _mp4, _paths, _screen, _disk)
    names = ("nuno", "numpy", "numba", "llvmlite", "eclipse-zenoh", "mcap")
    rows = [Row("python", "ok", platform.python_version()), *(Row(name, "ok", version(name)) for name in names)]
    for check in checks:
        rows.append(_checked(check))
        if check is _kernels and rows[-1].verdict == "ok":
            rows += [_checked(_threads), _checked(_cache)]
        elif check is _kernels:
            unknown = "not known: no kernel has run, see above"
            rows += [Row("threads", "note", unknown), Row("kernel cache", "note", unknown)]
    for row in rows:
        print(f"{row.verdict:6} {row.name:14} {row.text}")
        if row.remedy:
            print(f"{'':6} {'':14} remedy: {row.remedy}")
    return 1 if any(row.verdict == "failed" for row in rows) else 0


def _checked(check: Callable[[], Row]) -> Row:
    try:
        return check()
    except BadInput as error:
        problem = f"{error.field}={error.value}: {error.problem}"
        return Row(check.__name__.strip("_"), "failed", problem, error.remedy or "")
    except Exception as error:  # any error here would also break a run
        return Row(check.__name__.strip("_"), "failed", f"{type(error).__name__}: {error}")


def _machine() -> Row:
    return Row("machine", "ok", f"{processor()}, {platform.machine()}, {os.cpu_count()} cores")


def _memory() -> Row:
    memory = psutil.virtual_memory()
    text = f"{memory.available / 2**30:.1f} of {memory.total / 2**30:.1f} GiB are free"
    if memory.available < LEAST_MEMORY:
        return Row("memory", "failed", text, f"a small run takes {LEAST_MEMORY / 2**30:g} GiB: end other programs")
    return Row("memory", "ok", text)


def _kernels() -> Row:
    start = time.perf_counter()
    simulation = Simulation(scene_file.read(shipped.find("net")), None, None, 0)
    simulation.advance(None, None)
    simulation.about()  # chooses numba's threading layer, which `_threads` reads
    return Row("kernels", "ok", f"ready, and a scene stepped, in {time.perf_counter() - start:.1f} s")


def _threads() -> Row:
    from numba import config

    if config.THREADING_LAYER in ("omp", "tbb"):
        return Row("threads", "ok", f"at most {config.NUMBA_NUM_THREADS}, threading layer {config.THREADING_LAYER}")
    text = "large meshes run on one thread: numba has neither OpenMP nor TBB here; results are the same"
    return Row("threads", "note", text, "pip install tbb")


def _cache() -> Row:
    from numba import config

    folder = Path(config.CACHE_DIR)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    text = f"{folder}, {data_size(size)}"
    if not os.access(folder, os.W_OK):
        text = f"{folder} cannot be written: each run compiles its kernels again"
        return Row("kernel cache", "note", text, "make it writable, or set XDG_CACHE_HOME to a folder that is")
    return Row("kernel cache", "ok", text)


def _bus() -> Row:
    with hub_at(None):
        return Row("bus", "ok", "listens on loopback only, no scouting")


def _rerun() -> Row:
    return Row("rerun", "ok", version("rerun-sdk"))


def _mp4() -> Row:
    if importlib.util.find_spec("imageio_ffmpeg"):
        return Row("mp4", "ok", "can be exported")
    return Row("mp4", "note", "missing: no animations in MP4", "pip install 'nuno[video]'")


def _paths() -> Row:
    if importlib.util.find_spec("mitsuba"):
        return Row("paths", "ok", "pictures by --renderer paths can be drawn")
    return Row("paths", "note", "missing: no pictures by --renderer paths", "pip install 'nuno[paths]'")


def _screen() -> Row:
    if has_screen():
        return Row("screen", "ok", "yes")
    return Row("screen", "note", "none: runs write a picture instead of opening a window", "nuno run SCENE --view web")


def _disk() -> Row:
    """Check whether recordings can be written, and the speed of the disk."""
    folder = Path("recordings") if Path("recordings").exists() else Path.cwd()
    free = psutil.disk_usage(str(folder)).free
    probe, name = folder / f".nuno-doctor-{os.getpid()}", "recordings"
    remedy = "record elsewhere with --record FILE"
    if free < LEAST_DISK:
        return Row(name, "failed", f"{folder.resolve()}: {data_size(free)} are free", remedy)
    try:
        start = time.perf_counter()
        with probe.open("wb") as stream:
            stream.write(os.urandom(PROBE))
            stream.flush()
            os.fsync(stream.fileno())
        rate = PROBE / 1e6 / (time.perf_counter() - start)
    except OSError as error:
        return Row(name, "failed", f"{folder.resolve()} cannot be written: {error.strerror}", remedy)
    finally:
        with contextlib.suppress(OSError):
            probe.unlink()
    return Row(name, "ok", f"{folder.resolve()}: {data_size(free)} free, {rate:.0f} MB/s to disk")
