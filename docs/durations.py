"""How long each command of the README takes: those whose comment ends in a time are run, and the time is put there.

`make tour` runs all in a new folder, then again in another one, and takes the second time: kernels are then compiled.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from nuno_bench import machine
from nuno_bench.report import page

ROOT = Path(__file__).resolve().parents[1]
TIMED = re.compile(r"^(nuno .*?\S)(\s+#.*)\((?:[\d.]+ (?:s|min))\)$", re.MULTILINE)
"""A command, its comment, and how long it took."""


def write_durations(text: str, run: Callable[[str], float]) -> str:
    """The page's text with the time [s] that `run` says of each command that is timed."""
    return TIMED.sub(lambda found: f"{found[1]}{found[2]}({describe(run(found[1]))})", text)


def describe(seconds: float) -> str:
    """As a reader wants it: whole seconds, and minutes from two on."""
    return f"{seconds / 60:.0f} min" if seconds >= 120 else f"{max(1, round(seconds))} s"


def _run(command: str, folder: Path) -> float:
    """How long a shell takes for it [s]. Ends the script where it fails."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    began = time.perf_counter()
    ended = subprocess.run(
        command, shell=True, cwd=folder, env=os.environ | {"PATH": path}, stdin=subprocess.DEVNULL, capture_output=True
    )
    took = time.perf_counter() - began
    print(f"{took:8.1f} s  {command}", flush=True)
    if ended.returncode:
        sys.exit(f"{command} ended with {ended.returncode}:\n{ended.stderr.decode()[-2000:]}")
    return took


def _run_all(text: str) -> str:
    """The page with times, its commands run in a new folder."""
    with tempfile.TemporaryDirectory(prefix="nuno-tour-") as name:
        return write_durations(text, lambda command: _run(command, Path(name)))


def main() -> None:
    """Run the commands of README.md, and write what they took into it."""
    readme = ROOT / "README.md"
    text = readme.read_text(encoding="utf-8")
    _run_all(text)
    others = machine.OtherLoad()
    timed = _run_all(text)
    readme.write_text(timed, encoding="utf-8")
    facts = machine.about(others)
    said = f"Times in brackets: {facts['processor']}, kernels compiled, {facts['date']}; {facts['load']} (`make tour`)."
    page.replace_section(readme, "tour", [said])


if __name__ == "__main__":
    main()
