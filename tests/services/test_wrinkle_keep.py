"""How high what was drawn stays: measured in the report and over time, and kept where a scene says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import write_scene

import nuno
from nuno.exports.tables import export_csv
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno.simulation.run import Simulation

FABRIC = {"density": 0.12, "structural": 60, "hinge": 2e-5, "damping_ratio": 0.05}
LINES = {
    "level": [[-0.15, -0.12, 0], [0.15, -0.1, 0]],
    "upright": [[0.02, -0.2, 0], [0.03, 0.15, 0]],
}
MOVED = ((0.0, 0.0, 0.0), (0.001, 0.0007, 0.001), (-0.001, -0.0007, -0.001))
"""Of the line [m], and of its second end: triangles are crossed elsewhere, and a line's end lies on a vertex or not."""


def hung(folder: Path, line: str, keep: bool, passes: int = 3, moved: tuple[float, float, float] = MOVED[0]) -> Path:
    """A cloth hung at its upper corners, with one line."""
    model = {"plugin": "sheet", "resolution": [21, 21], "size": [0.6, 0.6], "cells": "triangles", "fabric": FABRIC}
    drawn = {"plugin": "wrinkle", "keep": keep, "smoothing": {"passes": passes}}
    points = np.array(LINES[line]) + np.array([*moved[:2], 0.0])
    points[1, 0] += moved[2]
    return write_scene(
        folder,
        objects=[{"name": "cloth", "model": model | {"pin": ["top-corners"]}}],
        operations=[drawn | {"lines": [{"height": 0.03, "points": points.tolist()}]}],
        duration=2.0,
        damping=3,
        solver="leapfrog",
    )


def left_of(scene: Path) -> float:
    """The share of a wrinkle's height that is left at the end."""
    simulation = Simulation(scene_file.read(scene), None, None, 1)
    begin = simulation.heights(0)["height"]
    while not simulation.finished:
        assert simulation.advance(None, None).report.status == "ok"
    return simulation.heights(0)["height"] / begin


@pytest.mark.full
@pytest.mark.quick(line=["level"])
@pytest.mark.parametrize("line", LINES)
def test_a_kept_wrinkle_holds_four_fifths_of_its_height_and_others_fade_more(line: str, tmp_path: Path) -> None:
    kept = [left_of(hung(tmp_path, line, True, moved=moved)) for moved in MOVED]
    assert min(kept) >= 0.8 and kept[0] > left_of(hung(tmp_path, line, False)) + 0.03


def test_the_height_of_an_unsmoothed_ridge_is_the_one_asked_for(tmp_path: Path) -> None:
    simulation = Simulation(scene_file.read(hung(tmp_path, "level", False, passes=0)), None, None, 1)
    found = simulation.heights(0)
    assert found["height"] == pytest.approx(0.03, rel=1e-12) and 0.03 < found["width"] < 0.12
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    simulation.state.x[...] = simulation.state.x @ turn + [1.0, 2.0, 3.0]
    assert simulation.heights(0) == pytest.approx(found, rel=1e-9)


def test_heights_are_in_the_report_over_time_and_in_resumed_runs(tmp_path: Path) -> None:
    scene = hung(tmp_path, "level", True)
    whole = nuno.run(scene, "duration=0.2", record=tmp_path / "whole.mcap")
    begin, end = whole.report["changes"][0]["measured"]
    with nuno.open(whole.path) as recording:
        series = recording.series()
    assert series["wrinkles_0_height"][[0, -1]].tolist() == [begin["height"], end["height"]]
    export_csv(whole.path, tmp_path / "a.csv")
    assert "wrinkles_0_width [m]" in (tmp_path / "a.csv").read_text().splitlines()[0]
    nuno.run(scene, "duration=0.1", record=tmp_path / "part.mcap")
    options = Options(record=tmp_path / "on.mcap", resume=tmp_path / "part.mcap")
    resumed = supervisor.supervise(scene_file.read(scene, ("duration=0.2",)), options)
    assert resumed.summary["changes"][0]["measured"][-1] == end


def test_a_rehearsed_change_leaves_nothing_behind(tmp_path: Path) -> None:
    scene = hung(tmp_path, "level", True)
    later = ("operations[0].at=0.05", "duration=0.1")
    plain, rehearsed = (Simulation(scene_file.read(scene, later), None, None, 1) for _ in range(2))
    rehearsed.rehearse()
    assert rehearsed.changes == [] and rehearsed.applied == 0 and rehearsed.fabric.number == plain.fabric.number
    while not plain.finished:
        ours, theirs = plain.advance(None, None), rehearsed.advance(None, None)
        assert ours.digest == theirs.digest
    assert rehearsed.applied == 1 and rehearsed.dt == plain.dt
