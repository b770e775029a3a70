"""Scenes at the edge of what can run: nothing, one particle, less than a frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import of_file, write_net
from scenes import BALL, write_scene

import nuno
from nuno.cli import main

NO_SPRINGS = {"springs": np.zeros((0, 2), int), "k": np.zeros(0), "rest": np.zeros(0), "c": np.zeros(0)}


def finished(folder: Path, **fields: Any) -> nuno.Result:
    return nuno.run(write_scene(folder, **fields), record=folder / "run.mcap")


def test_nothing_at_all_runs_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for bodies in ([], BALL):
        scene = write_scene(tmp_path, objects=[], bodies=bodies, solver={"plugin": "rk4"}, duration=0.1)
        flags = ["--report", "--record", str(tmp_path / "run.mcap"), *(["--no-view"] if bodies else [])]
        for command in (["run", str(scene), *flags], ["plan", str(scene)]):
            assert main(command) == 0
            assert "the scene has no objects" in capsys.readouterr().out
        with nuno.open(tmp_path / "run.mcap") as recording:
            assert recording.complete
            assert len(list(recording.frames())) == 6
            assert recording.last_checkpoint().x.shape == (0, 3)
        assert (tmp_path / "run.png").stat().st_size > 0


@pytest.mark.parametrize("number", [1, 3])
def test_particles_without_springs_fall_by_the_steps_closed_form(number: int, tmp_path: Path) -> None:
    write_net(tmp_path / "bare.npz", number, pinned=np.zeros(number, bool), **NO_SPRINGS)
    dt, steps = 0.02 / 4, 40
    result = finished(
        tmp_path, objects=of_file("bare.npz"), solver={"plugin": "symplectic_euler", "dt": dt}, duration=0.2
    )
    # Symplectic Euler: v grows by g dt each step, so y = g dt^2 (1 + 2 + ... + n).
    assert result.x[:, 1] == pytest.approx(-9.81 * dt**2 * steps * (steps + 1) / 2, rel=1e-12)
    assert result.x[:, 0] == pytest.approx(np.arange(number), abs=1e-15)


def test_a_duration_shorter_than_a_frame_is_one_frame(tmp_path: Path) -> None:
    result = finished(tmp_path, duration=0.0001)
    assert result.t == pytest.approx(0.02)
    assert result.report["frames"]["recorded"] == 2
