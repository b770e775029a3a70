"""A resumed run ends in the bits of the uninterrupted one, whichever integrator is installed."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
from scenes import BALL, write_scene

import nuno
from nuno import scene_file, supervisor
from nuno.service import Options

INTEGRATORS = sorted(point.name for point in entry_points(group="nuno.integrators"))


@pytest.mark.parametrize("name", INTEGRATORS)
def test_resumed_run_ends_in_the_same_bits(name: str, tmp_path: Path) -> None:
    """The chain is cut off while it lies on the ball, so that friction's memory matters too."""
    solver = {"plugin": name, "dt": "1 ms"}
    scene = write_scene(tmp_path, bodies=BALL, solver=solver, allow_unstable=True, duration=0.4)
    whole = nuno.run(scene, record=tmp_path / "whole.mcap")
    part = nuno.run(scene, "duration=0.2", record=tmp_path / "part.mcap")
    assert part.report["frames"]["sent"] == 11
    options = Options(record=tmp_path / "resumed.mcap", resume=part.path)
    resumed = supervisor.supervise(scene_file.read(scene), options)
    assert resumed.state == "done"
    assert np.isfinite(whole.x).all()
    assert resumed.summary["digest"] == whole.digest
    with nuno.open(tmp_path / "resumed.mcap") as ours, nuno.open(whole.path) as reference:
        assert [f.digest for f in ours.frames()] == [f.digest for f in reference.frames()]


def test_memory_matters_where_the_run_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it the tests above would end in the same bits whatever a checkpoint holds."""
    scene = write_scene(tmp_path, bodies=BALL, duration=0.4)
    whole = nuno.run(scene, record=tmp_path / "whole.mcap")
    part = nuno.run(scene, "duration=0.2", record=tmp_path / "part.mcap")
    monkeypatch.setattr("nuno.simulation.run.Simulation._restore", lambda simulation, arrays: None)
    options = Options(record=tmp_path / "resumed.mcap", resume=part.path)
    assert supervisor.supervise(scene_file.read(scene), options).summary["digest"] != whole.digest
