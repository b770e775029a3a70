"""Every kind of input tried in a process of its own, as many at once as there are cores."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from nuno_bench.report.result import Result
from soak.fuzz import KINDS
from soak.fuzz.kind import Kind
from soak.fuzz.worker import MEMORY, SLOW
from soak.processes import ENVIRONMENT

INPUTS, SECONDS = 100_000, 1200.0
"""Of each kind, and how long they may take at most [s of processor time]."""
QUICK_SECONDS = 20.0
KEPT = Path("recordings") / "fuzz"
"""Where inputs are kept that a reader crashed at or took too long for."""
START = 600.0
"""Longest that a worker may take beside its inputs [s]: it may have to compile kernels."""
SHARED = 4
"""Of so many others a worker may have to share its core with."""
LIVE: set[subprocess.Popen[bytes]] = set()
"""Processes that are going on, to be ended where this one is."""


def run(quick: bool, seed: int) -> list[Result]:
    """A result for each kind, and what all have in common."""
    seconds = QUICK_SECONDS if quick else SECONDS

    def tried(kind: Kind) -> dict[str, Any]:
        report = try_kind(kind, INPUTS, seconds, seed)
        print(f"  {kind.name}: {judge(kind, report).what}", file=sys.stderr, flush=True)
        return report

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            reports = list(pool.map(tried, KINDS.values()))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in tuple(LIVE):
                _kill(process)
            raise
    results = [judge(kind, report) for kind, report in zip(KINDS.values(), reports, strict=True)]
    worked = [report for report in reports if "failure" not in report]
    if worked:
        least = None if quick else INPUTS
        results += [
            Result("all", "inputs", "", (sum(r["inputs"] for r in worked),), bar=least and least * len(KINDS)),
            Result("all", "fewest of a kind", "", (min(r["inputs"] for r in worked),), bar=least),
            Result("all", "slowest input", "s", (max(r["slowest"] for r in worked),), bar=SLOW, at_most=True),
            Result("all", "most memory taken", "MB", (max(r["peak_mb"] for r in worked),), bar=MEMORY / 2**20,
                   at_most=True),
        ]  # fmt: skip
    return results


def judge(kind: Kind, report: dict[str, Any]) -> Result:
    """One row: what went wrong, of how much."""
    if "failure" in report:
        return Result(kind.name, "crashes and hangs", "", failure=report["failure"])
    pace = report["inputs"] / max(report["seconds"], 1e-9)
    what = (
        f"crashes and hangs in {report['inputs']:,} inputs, {report['accepted']:,} accepted; {pace:,.0f} / s, "
        f"{report['peak_mb']:.0f} MB"
    )
    note = "; ".join(f"{said} ({place})" for place, said in report["found"].items())
    note += f"; inputs: {', '.join(map(str, report['kept']))}" if report.get("kept") else ""
    return Result(kind.name, what, "", (report["crashes"] + report["hangs"],), bar=0, at_most=True, note=note)


def try_kind(kind: Kind, inputs: int, seconds: float, seed: int) -> dict[str, Any]:
    """What a worker counted, or `failure`."""
    with tempfile.TemporaryDirectory(prefix="nuno-fuzz-", dir=_fast_folder()) as name:
        folder = Path(name)
        said = _in_process(seconds, kind.name, str(folder), str(inputs), str(seconds), str(seed))
        kept = _keep(folder, f"{kind.name}-{seed}")
        try:
            return dict(json.loads((folder / "report.json").read_text()) | {"kept": kept})
        except (OSError, ValueError):
            where = f"; inputs: {', '.join(map(str, kept))}" if kept else ""
            return {"failure": f"the process of this kind did not end well: {said[-300:].strip()}{where}"}


def _keep(folder: Path, name: str) -> list[Path]:
    """Put what was found where it outlives the search."""
    kept = []
    for found in sorted(folder.glob("found-*")):
        KEPT.mkdir(parents=True, exist_ok=True)
        kept.append(Path(shutil.copy(found, KEPT / f"{name.replace(' ', '-').replace('/', '-')}-{found.name}")))
    return kept


def _in_process(patience: float, *arguments: str) -> str:
    """Run a worker to its end; what it said."""
    command = [sys.executable, "-m", "soak.fuzz.worker", *arguments]
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True, env=ENVIRONMENT
        )
        LIVE.add(process)
        try:
            process.wait(SHARED * patience + START)
        except subprocess.TimeoutExpired:
            pass
        finally:
            _kill(process)
            process.wait()
            LIVE.discard(process)
        log.seek(0)
        return log.read().decode(errors="replace")


def _kill(process: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _fast_folder() -> str | None:
    """In memory where there is such a folder: each input is written to a file."""
    shared = Path("/dev/shm")
    return str(shared) if shared.is_dir() and os.access(shared, os.W_OK) else None
