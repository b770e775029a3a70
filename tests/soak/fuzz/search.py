"""Every kind of input tried in a process of its own, as many at once as there are cores."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from nuno_bench.report.page import Result
from soak.fuzz import KINDS
from soak.fuzz.kind import Kind
from soak.fuzz.worker import MEMORY, SLOW
from soak.processes import ENVIRONMENT

INPUTS, SECONDS, QUICK_SECONDS = 100_000, 1200.0, 20.0
"""Of each kind, and how long they may take at most [s of processor time]."""
KEPT = Path("recordings") / "fuzz"
"""Where inputs are kept that a reader crashed at or took too long for."""
START = 600.0
"""Longest that a worker may take beside its inputs [s]: it may have to compile kernels."""
SHARED = 4
"""Of so many others a worker may have to share its core with."""


def run(quick: bool, seed: int) -> list[Result]:
    """A result for each kind, and what all have in common."""
    seconds, least = (QUICK_SECONDS, None) if quick else (SECONDS, INPUTS)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        reports = list(pool.map(lambda kind: try_kind(kind, INPUTS, seconds, seed), KINDS.values()))
    results = [judge(kind, report) for kind, report in zip(KINDS.values(), reports, strict=True)]
    if worked := [report for report in reports if "failure" not in report]:
        most = {key: max(report[key] for report in worked) for key in ("slowest", "peak_mb")}
        inputs = [report["inputs"] for report in worked]
        results += [
            Result("all", "inputs", "", (sum(inputs),), bar=least and least * len(KINDS)),
            Result("all", "fewest of a kind", "", (min(inputs),), bar=least),
            Result("all", "slowest input", "s", (most["slowest"],), bar=SLOW, at_most=True),
            Result("all", "most memory taken", "MB", (most["peak_mb"],), bar=MEMORY / 2**20, at_most=True),
        ]
    return results


def judge(kind: Kind, report: dict[str, Any]) -> Result:
    """One row: what went wrong, of how much."""
    if "failure" in report:
        return Result(kind.name, "crashes and hangs", "", failure=report["failure"])
    pace = report["inputs"] / max(report["seconds"], 1e-9)
    counted = f"{report['inputs']:,} inputs, {report['accepted']:,} accepted; {pace:,.0f} / s"
    what = f"crashes and hangs in {counted}, {report['peak_mb']:.0f} MB"
    note = "; ".join([f"{said} ({place})" for place, said in report["found"].items()] + report["kept"])
    return Result(kind.name, what, "", (report["crashes"] + report["hangs"],), bar=0, at_most=True, note=note)


def try_kind(kind: Kind, inputs: int, seconds: float, seed: int) -> dict[str, Any]:
    """What a worker counted, and where inputs are kept; or `failure`."""
    fast = Path("/dev/shm")  # in memory where there is such a folder: each input is written to a file
    where = fast if fast.is_dir() and os.access(fast, os.W_OK) else None
    words = [sys.executable, "-m", "soak.fuzz.worker", kind.name]
    with tempfile.TemporaryDirectory(prefix="nuno-fuzz-", dir=where) as name:
        folder, patience = Path(name), SHARED * seconds + START
        command = [*words, name, str(inputs), str(seconds), str(seed)]
        with (folder / "said").open("w+") as log:
            try:
                subprocess.run(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, timeout=patience,
                               env=ENVIRONMENT, check=False)  # fmt: skip
            except subprocess.TimeoutExpired:
                log.write(f"not over after {patience:g} s")
        kept = []
        for number, found in enumerate(sorted(folder.glob("found-*"))):
            KEPT.mkdir(parents=True, exist_ok=True)
            target = KEPT / f"{kind.name.replace(' ', '-').replace('/', '-')}-{seed}-{number}"
            kept.append(str(shutil.copy(found, target)))
        try:
            report: dict[str, Any] = json.loads((folder / "report.json").read_text())
        except (OSError, ValueError):
            said = (folder / "said").read_text(errors="replace")[-300:].strip()
            return {"failure": "; ".join([f"the process of this kind did not end well: {said}", *kept])}
        return report | {"kept": kept}
