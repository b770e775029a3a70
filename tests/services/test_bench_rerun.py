"""Sweeps as rerun files: every point stands where its figures say, in the colour of its class."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rrd import columns

from nuno.viewer.layout import entity
from nuno_bench.report.plots import Curve, Panel
from nuno_bench.stability import MapPoint, StabilityMap, panels_by_tab


def drawn(path: Path, tab: str, panel: Panel) -> dict[str, np.ndarray]:
    """(m, 2) values of each curve's points, read back from where they stand in the file."""
    from nuno_bench.report import rerun

    rerun.write(path, "test", {tab: [panel]})
    assert not list(path.parent.glob("*.part"))
    dots, found = columns(path, "Points2D:positions"), {}
    for curve in panel.curves:
        points = np.array(dots[entity(tab, panel.title, "curves", curve.name)][0]).reshape(-1, 2)
        sides = []
        for axis, places in zip(rerun.axes_of(panel), (points[:, 0], -points[:, 1]), strict=True):
            values = axis.low + places / axis.length * (axis.high - axis.low)
            sides.append(10.0**values if axis.log else values)
        found[curve.name] = np.stack(sides, axis=1)
    return found


def mapped() -> StabilityMap:
    """Two settings of one solver, four steps each, of which the limit lies between the second and the third."""
    outcomes = ("diverged", "drifting", "exact", "left out")
    points = [
        MapPoint("stiffness", value, 0.1, "rk4", 0.03, 10.0**-i, outcome)
        for value in (1.0, 10.0)
        for i, outcome in enumerate(outcomes)
    ]
    return StabilityMap("small", points, [])


def test_maps_hold_every_point_in_its_class_and_the_limit(tmp_path: Path) -> None:
    (panel,) = panels_by_tab(mapped())["small, stiffness"]
    found = drawn(tmp_path / "maps.rrd", "small, stiffness", panel)
    for i, name in enumerate(("diverged", "drifting", "exact", "left out")):
        assert found[name] == pytest.approx(np.array([[1.0, 10.0**-i], [10.0, 10.0**-i]]), rel=1e-4)
    assert len(found["accurate"]) == 0
    assert found["stated limit"] == pytest.approx(np.array([[1.0, 0.03], [10.0, 0.03]]), rel=1e-4)


def test_what_has_no_place_on_an_axis_stands_above_it_and_what_is_no_number_nowhere(tmp_path: Path) -> None:
    x, y = np.array([1.0, 2.0, 3.0]), np.array([0.5, np.inf, np.nan])
    panel = Panel("p", [Curve("a", x, y, 0), Curve("b", x, x, 1)], "x")
    found = drawn(tmp_path / "p.rrd", "t", panel)
    assert found["a"][0] == pytest.approx([1.0, 0.5], rel=1e-4)
    assert len(found["a"]) == 2 and found["a"][1, 1] > found["b"][:, 1].max()
    assert drawn(tmp_path / "empty.rrd", "t", Panel("p", [], "x", log="xy")) == {}
