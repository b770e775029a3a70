"""Each engine in a process of its own: what crashes, hangs or warns there is a mark, not the end.

`python -m nuno_bench.peers.process REQUEST.json` is such a process. It writes a line before the first
second, with the time that start and compiling took, and one after each second that it simulated.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nuno_bench.peers.problem import SECONDS, Peer, Score, Sheet, judge
from nuno_bench.peers.table import Kind, Setting
from nuno_schemas.fabric import Float

MARK = "peer: "
"""Before each line of ours, since engines write lines of their own."""
ENOUGH = 1 / 3
"""Of a setting's limit, after which its seconds are not repeated."""


@dataclass(frozen=True)
class Point:
    """One engine at one setting.

    start     from an empty process to the first step: imports, the model, compiling [s]
    seconds   wall times of the simulated second, one per repeat [s]
    failure   why there is no score
    remark    what the engine says of the run
    """

    kind: str
    setting: str
    start: float | None = None
    seconds: tuple[float, ...] = ()
    score: Score | None = None
    failure: str = ""
    remark: str = ""

    @property
    def median(self) -> float:
        return float(np.median(self.seconds))


def measure(kind: Kind, setting: Setting, name: str, sheet: Sheet, exact: Float, repeats: int, limit: float) -> Point:
    """Run it in a process of its own, ended after `limit` [s]."""
    with tempfile.TemporaryDirectory() as folder:
        request, problem, end = (Path(folder) / file for file in ("request.json", "sheet.npz", "end.npy"))
        sheet.save(problem)
        asked = {"module": kind.module, "made": kind.made, "setting": setting, "repeats": repeats, "limit": limit}
        asked |= {"sheet": str(problem), "end": str(end), "began": time.time()}
        request.write_text(json.dumps(asked))
        lines, failure = _watch([sys.executable, "-m", "nuno_bench.peers.process", str(request)], folder, limit)
        start = next((line["start"] for line in lines if "start" in line), None)
        seconds = tuple(line["seconds"] for line in lines if "seconds" in line)
        failure = next((line["failure"] for line in lines if "failure" in line), failure)
        if not seconds:
            return Point(kind.name, name, start, failure=failure or "its process ended without a result")
        x, remark = np.load(end, allow_pickle=False), next((line["remark"] for line in lines if line.get("remark")), "")
    if failure:  # what broke while it repeated itself has been measured all the same
        remark = f"a repeat: {failure}"
    if not np.isfinite(x).all():
        return Point(kind.name, name, start, seconds, failure="positions are no longer finite", remark=remark)
    return Point(kind.name, name, start, seconds, judge(sheet, x, exact), remark=remark)


def _watch(command: Sequence[str], folder: str, limit: float) -> tuple[list[dict[str, Any]], str]:
    """What a process wrote, and why it did not end well; it and all that it started end with the limit."""
    out, told = Path(folder) / "out", Path(folder) / "told"
    with out.open("wb") as stdout, told.open("wb") as stderr:
        child = subprocess.Popen(command, stdout=stdout, stderr=stderr, cwd=folder, start_new_session=True)
        try:
            code, failure = child.wait(limit), ""
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            code, failure = child.wait(), f"not done after {limit:g} s"
        except BaseException:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
            raise
    lines = []
    for text in out.read_text(errors="replace").splitlines():
        if text.startswith(MARK):
            lines.append(json.loads(text.removeprefix(MARK)))
    if code and not failure:
        last = told.read_text(errors="replace").strip().splitlines()[-1:]
        what = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        failure = f"its process ended with {what}{': ' + last[0][:200] if last and code > 0 else ''}"
    return lines, failure


def main(path: Path) -> None:
    """The process: make the engine, one short run that compiles, then the repeats."""
    asked = json.loads(path.read_text())
    signal.alarm(int(asked["limit"]) + 1)  # it ends by itself where whoever should end it was killed
    try:
        peer: Peer = getattr(importlib.import_module(asked["module"]), asked["made"])(
            Sheet.load(Path(asked["sheet"])), **asked["setting"]
        )
        peer.advance(1 / 60)
        _tell({"start": time.time() - asked["began"]})
        spent = 0.0
        for repeat in range(asked["repeats"]):
            peer.reset()
            at = time.perf_counter()
            x = peer.advance(SECONDS)
            spent += time.perf_counter() - at
            if repeat == 0:
                np.save(asked["end"], x)
            _tell({"seconds": time.perf_counter() - at, "remark": peer.remark})
            if spent > ENOUGH * asked["limit"]:
                break
    except Exception as error:  # whatever an engine raises is a finding about it
        _tell({"failure": f"{type(error).__name__}: {error}"[:300]})


def _tell(line: dict[str, Any]) -> None:
    print(f"{MARK}{json.dumps(line)}", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
