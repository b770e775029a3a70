"""The Python API: the same runs as on the command line, from a script or a notebook."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nuno import scene_file, supervisor
from nuno.recording.reader import Recording, open_recording
from nuno.report import Report, make_report
from nuno.service import Options
from nuno.supervisor import Deployment
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float


@dataclass(frozen=True)
class Result:
    """A finished run.

    x (n, 3) [m] and v (n, 3) [m/s] are the last state, float64; report is what the command line
    prints; recording is the file with every frame.
    """

    state: str
    t: float
    x: Float
    v: Float
    digest: str
    report: Report
    path: Path

    @property
    def recording(self) -> Recording:
        return open_recording(self.path)


def run(
    scene: str | os.PathLike[str] | Mapping[str, Any],
    *overrides: str,
    record: str | os.PathLike[str] | None = None,
    roots: Sequence[str | os.PathLike[str]] = (),
    processes: bool = False,
    threads: int = 0,
) -> Result:
    """Simulate a scene: a file, the name of a shipped scene, or a mapping of its fields.

    `overrides` are "key=value" as after --set; `record` is the recording's file (default: a
    temporary one). Raises BadInput for a bad scene and RunFailed for a run that failed or
    diverged, whose recording is kept.
    """
    folders = tuple(Path(root) for root in roots)
    if isinstance(scene, Mapping):
        with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
            path = Path(folder) / "scene.yaml"
            path.write_text(json.dumps(dict(scene)))
            return run(
                path, *overrides, record=record, roots=(Path.cwd(), *folders), processes=processes, threads=threads
            )
    loaded = scene_file.read(scene_file.find(os.fspath(scene)), overrides, folders)
    run_id = supervisor.new_run_id(loaded.scene.name)
    path = Path(record) if record is not None else Path(tempfile.mkdtemp(prefix="nuno-")) / f"{run_id}.mcap"
    options = Options(record=path, threads=threads)
    outcome = supervisor.supervise(
        loaded, options, Deployment(processes=processes, run=run_id), None, lambda o: make_report(loaded, o)
    )
    if outcome.state in ("failed", "diverged"):
        raise RunFailed(
            f"{outcome.state}: {outcome.error or 'positions are no longer finite'}; recording kept in {path}"
        )
    last = open_recording(path).last_checkpoint()
    return Result(
        outcome.state,
        last.t,
        np.array(last.x),
        np.array(last.v),
        outcome.summary["digest"],
        make_report(loaded, outcome),
        path,
    )
