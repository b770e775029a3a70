"""`nuno doctor`: whether this machine has what nuno can use."""

from __future__ import annotations

import argparse
import importlib.util
import os
import platform
import time
from importlib.metadata import version
from pathlib import Path

import psutil

from nuno import scene_file
from nuno.sessions import hub_at
from nuno.simulation.run import Simulation
from nuno.viewer.require import has_screen


def add_arguments(parser: argparse.ArgumentParser) -> None:
    del parser


def main(args: argparse.Namespace) -> int:
    del args
    rows = [
        ("python", platform.python_version()),
        ("machine", f"{platform.machine()}, {os.cpu_count()} cores, {psutil.virtual_memory().total / 2**30:.0f} GiB"),
        *((name, version(name)) for name in ("nuno", "numpy", "numba", "eclipse-zenoh", "mcap")),
        ("kernels", _kernels()),
        ("bus", _bus()),
        ("rerun", version("rerun-sdk") if importlib.util.find_spec("rerun") else "missing: pip install 'nuno[view]'"),
        ("mp4", "ok" if importlib.util.find_spec("imageio_ffmpeg") else "missing: pip install 'nuno[video]'"),
        ("screen", "yes" if has_screen() else "no: runs write a picture instead of opening a window"),
        ("recordings", _recordings()),
    ]
    for name, text in rows:
        print(f"{name:14} {text}")
    return 1 if any(text.startswith("failed") for _, text in rows) else 0


def _kernels() -> str:
    try:
        start = time.perf_counter()
        simulation = Simulation(scene_file.read(scene_file.find("net")), None, None, 0)
        simulation.advance(None, None)
        return f"compiled and stepped in {time.perf_counter() - start:.1f} s, {simulation.about()}"
    except Exception as error:
        return f"failed: {error}"


def _bus() -> str:
    try:
        with hub_at(None):
            return "listens on loopback only, no scouting"
    except Exception as error:
        return f"failed: {error}"


def _recordings() -> str:
    folder = Path("recordings")
    if not folder.is_dir():
        return "made in ./recordings at the first run"
    return f"{folder.resolve()}, {psutil.disk_usage(str(folder)).free / 2**30:.0f} GiB free"
