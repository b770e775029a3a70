"""What a figure was measured on: without it a figure says nothing."""

from __future__ import annotations

import os
import platform
import shlex
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numba
import psutil

PACKAGES = ("nuno", "numpy", "numba", "eclipse-zenoh", "mcap")


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def describe() -> dict[str, str]:
    """Machine, load, threads and versions, as text by name.

    Call it after the kernels have run: numba names its threading layer only then.
    """
    busy = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    return {
        "processor": f"{_processor()}, {cores()} cores, {psutil.virtual_memory().total / 2**30:.0f} GiB",
        "system": platform.platform(),
        "kernels": f"at most {numba.config.NUMBA_NUM_THREADS} threads, {_layer()}",
        "versions": ", ".join([f"Python {platform.python_version()}", *(f"{p} {version(p)}" for p in PACKAGES)]),
        "load": f"{busy} (running processes, averaged over the last minute; includes the measurement itself)",
        "date": time.strftime("%Y-%m-%d"),
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _layer() -> str:
    try:
        return f"threading layer {numba.threading_layer()}"
    except ValueError:
        return "no parallel kernel has run"


def command() -> str:
    """The command line that makes these figures again."""
    return "nuno " + shlex.join(sys.argv[1:])
