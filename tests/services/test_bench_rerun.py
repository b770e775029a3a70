"""Sweeps as rerun files: every point stands where its figures say, in the colour of its class."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from rrd import columns

from nuno.viewer.layout import entity
from nuno_bench.stability.case import Point
from nuno_bench.stability.drift import Amplification, Drift, Modes
from nuno_bench.stability.sweep import Mapped, Row, Sweep
from nuno_bench.validation.laws.base import Case, Found, Outcome
from nuno_bench.validation.suite import Part

pytest.importorskip("rerun", reason="needs nuno[view]")


def mapped() -> Mapped:
    """Two settings of one solver, four steps each, of which the limit lies between the second and the third."""
    outcomes = ("diverged", "drifting", "exact", "left out")
    points = [Point("stiffness", 1.0, "rk4", 10.0**-i, outcome, 0.1, 0.1, 0.1) for i, outcome in enumerate(outcomes)]
    rows = [Row("stiffness", value, "rk4", 0.1, 0.03, points) for value in (1.0, 10.0)]
    h = np.array([0.1, 1.0, 3.0])
    mode = Amplification("rk4", h, np.array([1.0, 0.9, np.nan]), np.array([1.0, 0.99, np.nan]), 0.0)
    drift = Drift("rk4", np.array([0.0, 1000.0, 2000.0]), np.array([0.0, -0.01, -0.1]), "")
    return Mapped("small", Sweep(rows), [Modes(mode, drift)])


def test_maps_hold_every_point_in_its_class_and_the_limit(tmp_path: Path) -> None:
    from nuno_bench.stability import rerun as stability_rerun

    path = stability_rerun.write(tmp_path / "maps.rrd", [mapped()])
    assert not list(tmp_path.glob("*.part"))
    place = ("small", "stiffness", "rk4")
    dots = columns(path, "Points2D:positions")
    drawn = {name: dots[entity(*place, "classes", name)][0] for name in ("diverged", "drifting", "exact", "left out")}
    assert {name: [round(-y) for _, y in points] for name, points in drawn.items()} == {
        "diverged": [0, 0], "drifting": [-1, -1], "exact": [-2, -2], "left out": [-3, -3],
    }  # fmt: skip
    assert [round(x) for x, _ in drawn["exact"]] == [0, 1]
    (strips,) = columns(path, "LineStrips2D:strips")[entity(*place, "stated limit")]
    assert [end[1] for strip in strips for end in strip] == pytest.approx([-math.log10(0.03)] * 4)


def test_modes_and_the_energy_over_many_steps_are_curves(tmp_path: Path) -> None:
    from nuno_bench.stability import rerun as stability_rerun

    path = stability_rerun.write(tmp_path / "maps.rrd", [mapped()])
    energy = columns(path, "Scalars:scalars")[entity("small", "drift", "rk4")]
    assert [row[0] for row in energy] == pytest.approx([-2.0, -1.0])
    growth = np.array(columns(path, "Points2D:positions")[entity("small", "mode", "growth", "rk4")][0])
    assert growth == pytest.approx(np.array([[-2.0, 0.0], [0.0, -math.log10(0.9)]]), abs=1e-6)


def test_laws_stand_in_rows_and_failures_right_of_what_is_allowed(tmp_path: Path) -> None:
    from nuno_bench.validation import rerun as validation_rerun

    cases = [Case(name, "law", "source", lambda plugin: Found(0, 0, 0, 0)) for name in ("order, net", "momentum")]
    series = {"dt": (0.1, 0.01), "error": (1e-2, 1e-4)}
    found = [
        Outcome("order, net", "rk4", "passed", "", Found(2.0, 2.0, 1e-3, 0.1, series)),
        Outcome("order, net", "euler", "failed", "", Found(1.0, 2.0, 1.0, 0.1, series)),
        Outcome("momentum", "rk4", "passed", "", Found(0.0, 0.0, 0.0, 1e-10)),
        Outcome("momentum", "euler", "unsupported", "no"),
    ]
    path = validation_rerun.write(tmp_path / "laws.rrd", [Part("cloth", tuple(cases), ("rk4", "euler"))], found)
    dots = columns(path, "Points2D:positions")
    wide, (rk4,), (euler,) = 3.0, dots[entity("laws", "cloth", "rk4")], dots[entity("laws", "cloth", "euler", "failed")]
    assert [x / wide for x, _ in rk4] == pytest.approx([-2.0, validation_rerun.SHORTEST], abs=1e-5)
    assert [round(-y) for _, y in rk4] == [1, 0]
    assert [x / wide for x, _ in euler] == pytest.approx([1.0], abs=1e-5)
    (line,) = dots[entity("order, net", "rk4")]
    assert np.array(line) == pytest.approx(np.array([[-2.0, 2.0], [-4.0, 4.0]]), abs=1e-5)
