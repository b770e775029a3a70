"""Description of the machine on which a figure was measured: without it a figure means nothing."""

from __future__ import annotations

import os
import platform
import shlex
import sys
import time
from importlib.metadata import version

import numba
import psutil

from nuno.scene.provenance import processor

DISTURBED = 0.05
"""Share of the machine in use by other processes above which times count as disturbed."""
PACKAGES = ("nuno", "numpy", "numba", "eclipse-zenoh", "mcap")


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class OtherLoad:
    """Measures the share of the machine that other processes used during a measurement."""

    besides = 0.0
    """Processor time [s] of own processes that are not waited for, such as a browser's children."""

    def __init__(self) -> None:
        self.started = time.perf_counter()
        self.before = self._seconds()

    def _seconds(self) -> float:
        """Return the processor time of all but this process and those it has waited for [s]."""
        all_times, own = psutil.cpu_times(), psutil.Process().cpu_times()
        idle = all_times.idle + getattr(all_times, "iowait", 0.0)
        # Guests are counted within user and nice.
        guests = getattr(all_times, "guest", 0.0) + getattr(all_times, "guest_nice", 0.0)
        return float(sum(all_times) - guests - idle - sum(own[:4])) - OtherLoad.besides

    def share(self) -> float:
        """Return the share of all cores since the start, 0 to 1."""
        wall = (time.perf_counter() - self.started) * (os.cpu_count() or 1)
        return min(1.0, max(0.0, (self._seconds() - self.before) / wall))


def describe_load(share: float) -> str:
    """Describe the share of the machine that other processes used."""
    text = f"other processes took {share:.0%} of the machine meanwhile"
    return f"{text}: TIMES ARE DISTURBED" if share > DISTURBED else text


def command() -> str:
    """Return the command line that reproduces the figures."""
    return "nuno " + shlex.join(sys.argv[1:])


def about(others: OtherLoad, **more: str) -> dict[str, str]:
    """Return the circumstances of a report, as text by name: command, `more`, machine, versions, other load.

    Call it after the kernels have run: numba knows its threading layer only then.
    """
    try:
        layer = f"threading layer {numba.threading_layer()}"
    except ValueError:
        layer = "no parallel kernel has run"
    return {
        "command": command(),
        **more,
        "processor": f"{processor()}, {cores()} cores, {psutil.virtual_memory().total / 2**30:.0f} GiB",
        "system": platform.platform(),
        "kernels": f"at most {numba.config.NUMBA_NUM_THREADS} threads, {layer}",
        "versions": ", ".join([f"Python {platform.python_version()}", *(f"{p} {version(p)}" for p in PACKAGES)]),
        "date": time.strftime("%Y-%m-%d"),
        "load": describe_load(others.share()),
    }
